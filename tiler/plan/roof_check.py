"""Roofs that were left in a terrain, told by their edges.

A roof, gabled or level, ends in a step: from its eaves the terrain falls steeply, and neither the roof nor the ground
beside it is nearly as steep. Ridges, embankments and quarries are steep beyond their edges or within them. Where
the filter removed a part of a roof a ramp is left, so not all of the outline need be steps.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

Float64 = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

WIDEST_M = 240.0
"""The widest roof that is looked for."""
WINDOWS_M = (40.0, 80.0, 160.0, WIDEST_M)
"""Sides of the squares that stand for buildings: a roof is told from the hill below by the narrowest that holds it."""
EAVES_M = 2.0
"""Least fall at the edge of a roof, and least height above what is around it."""
LONGEST = 1.5
"""Times the side of the square: an opening takes away what is narrower than that in one direction."""
STEPNESS = 2.0
"""A step falls by so many times what roof and ground rise or fall beside it."""
STEPS_SHARE = 0.6
"""Share of the outline that is steps. On eight simulated scenes (ridges, quarry, terraces, wood) and eight real sites
what is no roof has up to 0.54, roofs 0.62 and more, those half removed among them."""
EDGE = 2
"""Cells that the edge itself may take, to each side of the outline."""
BESIDE = 2
"""Cells over which roof and ground are looked at, beyond the edge."""
SEEN = 2 * (EDGE + BESIDE)
"""Cells around a piece that are looked at."""


def roofs(heights: Float64, cell_m: float, least_m: float = 0.0) -> list[tuple[float, float, float]]:
    """Pieces that stand on steps above what is around them.

    For each of `WINDOWS_M` the pieces that rise by `EAVES_M` above the opening of the terrain by a square of that side;
    a roof may be found with several.

    Parameters
    ----------
    heights : float64, shape (rows, columns)
        Metres, NaN where unknown.
    cell_m : float
    least_m : float
        Narrower pieces are not looked at.

    Returns
    -------
    list of (width, row, column)
        Diameter of the largest circle inside, metres, and the middle.
    """
    known = ~np.isnan(heights)
    if not known.any() or np.ptp(heights[known]) < EAVES_M:
        return []
    floor = np.where(known, heights, np.inf)
    found = []
    for window_m in WINDOWS_M:
        side = int(window_m / cell_m) | 1
        raised = known & (np.where(known, heights, 0.0) - _opened(floor, side) >= EAVES_M)
        if not raised.any():
            continue
        numbers, _ = ndimage.label(ndimage.binary_opening(raised, np.ones((3, 3), np.bool_)))
        for number, box in enumerate(ndimage.find_objects(numbers), start=1):
            sides = [s.stop - s.start for s in box]
            cut = any(s.start == 0 or s.stop == n for s, n in zip(box, heights.shape, strict=True))
            if cut or max(sides) > LONGEST * side or min(sides) * cell_m < max(least_m, 2 * EDGE * cell_m):
                continue
            view = tuple(slice(max(s.start - SEEN, 0), s.stop + SEEN) for s in box)
            width = _width(heights[view], numbers[view] == number, cell_m, least_m)
            if width is not None:
                found.append((width, (box[0].start + box[0].stop) / 2, (box[1].start + box[1].stop) / 2))
    return found


def _opened(floor: Float64, side: int) -> Float64:
    """The opening of heights by a square, whose unknown cells (inf) hold nothing up and nothing down."""
    low = ndimage.minimum_filter(floor, side, mode="constant", cval=np.inf)
    opened: Float64 = ndimage.maximum_filter(
        np.where(np.isinf(low), -np.inf, low), side, mode="constant", cval=-np.inf
    )
    return opened


def _width(heights: Float64, piece: Bools, cell_m: float, least_m: float) -> float | None:
    """Width of a raised piece of terrain if its outline is mostly steps."""
    depth = ndimage.distance_transform_edt(np.pad(piece, 1))[1:-1, 1:-1]
    deepest = float(depth.max())
    width = 2 * deepest * cell_m
    if deepest <= EDGE or width < least_m:
        return None
    away = ndimage.distance_transform_edt(~piece)
    ring = (away > EDGE) & (away <= EDGE + 1)

    def nearest(place: Bools) -> Float64:
        at = ndimage.distance_transform_edt(~place, return_distances=False, return_indices=True)
        found: Float64 = heights[tuple(at)]
        return found

    eaves, roof = nearest(depth >= EDGE), nearest(depth >= min(EDGE + BESIDE, deepest))
    fall = eaves - heights
    beside = np.abs(roof - eaves) + np.abs(heights - nearest(away >= EDGE + 1 + BESIDE))
    # An unknown height (NaN) makes no step.
    steps = ring & (fall >= EAVES_M) & (fall >= STEPNESS * beside)
    return width if np.count_nonzero(steps) >= STEPS_SHARE * np.count_nonzero(ring) else None
