"""Extension of water to its shore and under bridges, and removal of its narrow parts and islands."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.grid.coarse import Bools, Float64, box_around, opened, within
from tiler.grid.water_cells import WaterCells

LEVEL_M = 0.15
"""Water extends over ground that is at most this high above the water, in metres."""
BELOW_M = 0.4
"""Water does not extend over ground that is deeper than this below the water, in metres.

Such ground is the foot of a dam, or other water.
"""
DEEP_CELLS = 5
"""Ground counts as deeper than `BELOW_M` only in squares of this side, in cells. Smaller pits
come from low returns."""
LEVEL_CELLS = 5
"""The level of water is the mean height in a square of this side, in cells."""
LEVEL_STEP_M = 0.001
"""Heights are rounded to multiples of this before they are added up, in metres."""
OUTER_CELLS = 2
"""The outermost cells of water may be bank: a border of this width, in cells."""
NEAR_CELLS = 10
"""Outermost cells do not contribute to the level if there are inner cells within this distance,
in cells."""
BRIDGE_M = 14.0
"""Water extends under bridges up to this width, in metres."""
UNDER_BRIDGE_M = 0.5
"""Terrain under a bridge is at most this high above the shores next to it, in metres."""
TIDE_M = 0.7
"""Land at the border of the survey may be water if it is at most this high above the water, in
metres."""
SPREAD_M = 0.2
"""Land at the border of the survey may be water if the standard deviation of its heights is at
most this, in metres."""
SPECK_CELLS = 4
"""A speck has at most this many cells."""


def smoothed(ground: Float64) -> Float64:
    """Remove pits and peaks of one or two cells: take the median of three cells along rows and columns, twice."""
    known = ~np.isnan(ground)
    box = box_around(known, 0)
    part = ground[box]
    for axis in (0, 1, 0, 1):
        before, after = np.roll(part, 1, axis), np.roll(part, -1, axis)
        part = np.fmax(np.fmin(before, after), np.fmin(np.fmax(before, after), part))
    smooth_ground = np.full_like(ground, np.nan)
    smooth_ground[box] = part
    smooth_ground[~known] = np.nan
    return smooth_ground


def water_heights(cells: WaterCells, wet: Bools) -> Float64 | None:
    """Return the water level near each cell in metres, or None if the water has no returns.

    The level comes from the nearest cells of water with returns. The outermost cells of the
    water may be bank, so they count only if there are no inner cells near. Cells without
    returns do not count, as their heights come from the banks.
    """
    ground = np.rint(cells.ground / LEVEL_STEP_M)  # Sums of whole numbers are exact.
    known = wet & (cells.returns > 0) & ~np.isnan(ground)
    if not known.any():
        return None
    inner = known & scipy.ndimage.binary_erosion(wet, iterations=OUTER_CELLS, border_value=1)
    known &= inner | ~within(inner, NEAR_CELLS)
    number = scipy.ndimage.uniform_filter(known.astype(np.float64), LEVEL_CELLS)
    total = scipy.ndimage.uniform_filter(np.where(known, ground, 0.0), LEVEL_CELLS)
    nearest = scipy.ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    levels: Float64 = (total / np.where(known, number, 1.0))[tuple(nearest)] * LEVEL_STEP_M
    return levels


def extended_to_shore(
    cells: WaterCells, water: Bools, level: Float64 | None, max_steps: int
) -> Bools:
    """Extend water by up to ``max_steps`` cells over connected low cells of the domain.

    Cells are low if they have no height, or if they are at most `LEVEL_M` above the water and
    not in a deep square (`DEEP_CELLS`). Low parts narrower than three cells are left out.
    ``level`` is the level near each cell. If it is None, water is not extended.
    """
    extended_water = water.copy()
    if level is None:
        return extended_water
    box = box_around(water, max_steps)
    near, wet = cells.cut(box), water[box]
    above = near.ground - level[box]
    deep = scipy.ndimage.binary_opening(
        above < -BELOW_M, np.ones((DEEP_CELLS, DEEP_CELLS), np.bool_)
    )
    low = near.domain & ~deep & ((above <= LEVEL_M) | np.isnan(above))
    low = opened(low | wet, math.sqrt(2)) | wet
    extended_water[box] = scipy.ndimage.binary_dilation(wet, iterations=max_steps, mask=low)
    return extended_water


def close_bridge_gaps(
    ground: Float64, water: Bools, size_m: float, longest_island: int, below_deck: Bools
) -> Bools:
    """Close gaps in water under bridges: below known decks, and where the terrain is about as low as the shores.

    Land that water encloses is not a bridge, because bridges are connected with the bank. Such
    land is an island and stays, if it has at most ``longest_island`` rows and columns. Longer
    land may extend beyond the window of another block, where it would not look enclosed. Blocks
    have to agree, so no block treats longer land as an island.
    """
    pad = math.ceil(BRIDGE_M / size_m)
    padded = np.pad(water, pad)
    radius = BRIDGE_M / 2 / size_m
    closed = ~within(~within(padded, radius), radius)[pad:-pad, pad:-pad]
    shore = scipy.ndimage.binary_dilation(water, np.ones((3, 3), np.bool_)) & ~np.isnan(ground)
    around = 2 * pad + 1
    low = scipy.ndimage.minimum_filter(np.where(shore, ground, np.inf), around)
    with np.errstate(invalid="ignore"):
        gaps = closed & (below_deck | (ground - low <= UNDER_BRIDGE_M))
    labels, _, enclosed = _land(water)
    is_short = [False]
    for rows, cols in scipy.ndimage.find_objects(labels):
        is_short.append(max(rows.stop - rows.start, cols.stop - cols.start) <= longest_island)
    island = enclosed & np.array(is_short)
    return np.asarray(water | (gaps & ~island[labels]))


def remove_narrow_parts(water: Bools, width: float, beyond: Bools) -> Bools:
    """Remove the parts of water narrower than ``width`` cells. The other parts keep their shore.

    Cells ``beyond`` the survey count as water, because water may continue there.
    """
    radius = max(width / 2 - 0.5, 1.0)
    # Water at exactly this radius from land is wide enough.
    inner = ~within(~np.pad(water | beyond, 1), math.nextafter(radius, 0.0))[1:-1, 1:-1]
    return water & within(inner, width / 2 + 1)


def without_islands(water: Bools, min_cells: float) -> Bools:
    """Fill enclosed land of fewer than ``min_cells`` cells. Land that touches the border of the array stays."""
    labels, sizes, enclosed = _land(water)
    return np.asarray(water | (enclosed & (sizes < min_cells))[labels])


def without_border_islands(
    cells: WaterCells, water: Bools, level: Float64, min_cells: float
) -> Bools:
    """Fill flat land of fewer than ``min_cells`` cells between water and the border of the survey.

    Flat land is at most `TIDE_M` above the water, and its heights differ little (`SPREAD_M`).
    It is filled if it is a speck, or if at least as many sides of its cells face the water as
    face the border. Such land is mostly water with returns, for example from a flight at a
    higher tide. Land that touches the border of the array stays.
    """
    labels, _, inside = _land(water | ~cells.domain)

    def total(weights: npt.NDArray[Any], mask: Any = ...) -> npt.NDArray[Any]:
        """Return the sum of weights for each piece of land."""
        return np.bincount(labels[mask].ravel(), weights[mask].ravel(), len(inside))

    sizes = total(labels > 0)
    to_water = total(_sides(water))
    to_border = total(_sides(~cells.domain & ~water))
    above = np.rint((cells.ground - level) / LEVEL_STEP_M)
    known = ~np.isnan(above)
    number = np.maximum(np.bincount(labels[known], minlength=len(inside)), 1)
    mean = total(above, known) / number
    spread = np.sqrt(total(above**2, known) / number - mean**2)
    highest = np.zeros(len(inside))
    np.maximum.at(highest, labels[known], above[known])
    flat = (spread * LEVEL_STEP_M <= SPREAD_M) & (highest * LEVEL_STEP_M <= TIDE_M)
    lies_in_water = (to_water >= to_border) | (sizes <= SPECK_CELLS)
    filled: Bools = inside & flat & (sizes < min_cells) & (to_border > 0) & lies_in_water
    return np.asarray(water | filled[labels])


def _sides(cells: Bools) -> npt.NDArray[np.float64]:
    """Return for each cell how many of its four neighbours are in the mask ``cells``."""
    padded = np.pad(cells, 1).astype(np.float64)
    return padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]


def _land(water: Bools) -> tuple[npt.NDArray[Any], npt.NDArray[Any], Bools]:
    """Label the pieces of land.

    Return the label of each cell, and for each label its number of cells and whether water
    encloses it.
    """
    labels, number = scipy.ndimage.label(~water)
    sizes = np.bincount(labels.ravel(), minlength=number + 1)
    enclosed: Bools = np.ones(number + 1, np.bool_)
    for side in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        enclosed[side] = False
    enclosed[0] = False
    return labels, sizes, enclosed
