"""Islands of ground on objects: a few cells of a roof that the ground surface wrongly includes.

Pits in a roof, for example clumps of blunders, light wells or gaps between parts of the roof,
do not belong to a large object (`ptd.matched.objects`). So the ground surface passes through
them, and the terrain model has facets there at the height of the roof. A connected surface of
ground cells is such an island under these conditions:

- The surface is narrow, and it is a plateau (`ptd.ground.plateaus`): nearly all other ground
  that rays from it meet beyond objects is lower. Most rays need not meet other ground, because
  the roof may be wide.
- Most cells around the surface are objects. Around terraces, tops of walls and rocks, most
  cells are ground.
- Most of these objects have the height of the surface, like the rest of a roof. Crowns around a
  spot of ground are higher.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import scipy

from ptd.cells import Int32, Int64
from ptd.frame import Scale
from ptd.ground.connected import connected_surfaces
from ptd.ground.morphology import EMPTY, Bool
from ptd.ground.plateaus import Plateaus, plateaus
from ptd.kernel import kernel
from ptd.matched.ground_model import band
from ptd.matched.surface import Surface

MAX_WIDTH_M = 50.0
"""Width above which a surface is not an island."""
VIEW_M, SLOPE, UNSEEN_SHARE = 40.0, 0.1, 0.9
"""Length of the rays that search for other ground, slope down to it above which it counts as
lower, and largest share of rays that do not meet ground. The slope is less than for whole
roofs, because the objects around an island already distinguish it from the top of a hill."""
AROUND_M, GROUND_SHARE = 3.0, 0.5
"""Distance (along rows and along columns) of the cells around an island's cells, and the share
of ground among them below which they are mostly objects."""
LEVEL_ABOVE_M, LEVEL_BELOW_M, LEVEL_SHARE = 3.0, 1.5, 0.5
"""Heights above and below a cell between which an object counts as equally high, and least
share of such objects. The upper limit is larger, because pits lie below the roof."""


def _around_cells(cell_m: float) -> int:
    """Return the distance of the cells around an island's cells, in cells."""
    return max(round(AROUND_M / cell_m), 1)


def _roof_rule(scale: Scale, cell_m: float) -> Plateaus:
    """Return the rule by which the surface of an island is a plateau."""
    roof_rule = Plateaus.of(scale, MAX_WIDTH_M, cell_m=cell_m)
    view, slope = round(VIEW_M / cell_m), scale.counts_z(SLOPE * cell_m)
    return replace(roof_rule, view=view, slope=slope, unseen=UNSEEN_SHARE)


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells beyond which cells do not change the result of `without_islands`.

    Rays begin at the last cell of an island and may end at the first cell of another surface. A
    surface that continues beyond this distance is too wide for an island, because the part
    within the distance is wider than `MAX_WIDTH_M`.
    """
    roof_rule, around = _roof_rule(Scale(), cell_m), _around_cells(cell_m)
    return 2 * roof_rule.widest + roof_rule.view + max(roof_rule.gap, around) + around + 1


@kernel
def _surroundings(
    heights: Int32, ground: Bool, surface: Int32, n: int, distance: int, above: int, below: int
) -> tuple[Int64, Int64]:
    """Count the cells around the cells of each surface (int64 [n, 3]), and find its bounding box (int64 [n, 4]).

    The counts are all cells, ground, and objects of the same height. A cell near several cells
    of a surface is counted several times. The box is the first and last row, and the first and
    last column.
    """
    rows, columns = heights.shape
    counts = np.zeros((n, 3), np.int64)
    box = np.zeros((n, 4), np.int64)
    for row in range(rows):
        for column in range(columns):
            number = surface[row, column]
            if number < 0:
                continue
            if counts[number, 0] == 0:
                box[number, 0], box[number, 2], box[number, 3] = row, column, column
            box[number, 1] = row
            box[number, 2], box[number, 3] = (
                min(box[number, 2], column),
                max(box[number, 3], column),
            )
            for r in range(max(row - distance, 0), min(row + distance + 1, rows)):
                for c in range(max(column - distance, 0), min(column + distance + 1, columns)):
                    if heights[r, c] == EMPTY:
                        continue
                    rise = np.int64(heights[r, c]) - np.int64(heights[row, column])
                    counts[number, 0] += 1
                    counts[number, 1] += ground[r, c]
                    counts[number, 2] += not ground[r, c] and -below <= rise <= above
    return counts, box


def _on_level_objects(
    heights: Int32,
    ground: Bool,
    levels: Int32,
    roof_rule: Plateaus,
    scale: Scale,
    cell_m: float,
) -> Bool:
    """Find the cells of narrow surfaces of ground between objects of the same height: bool [rows, columns]."""
    # The next whole number, because heights are whole numbers.
    limit = math.floor(roof_rule.step) + 1
    surface, n = connected_surfaces(levels, limit, limit, roof_rule.gap)
    above = round(scale.counts_z(LEVEL_ABOVE_M))
    below = round(scale.counts_z(LEVEL_BELOW_M))
    counts, box = _surroundings(
        heights, ground, surface, n, _around_cells(cell_m), above, below
    )
    n_cells, n_ground, n_level = counts.T
    width = np.maximum(box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]) + 1
    is_on_level_objects = (n_ground < GROUND_SHARE * n_cells) & (
        n_level >= LEVEL_SHARE * (n_cells - n_ground)
    )
    # Cells without a surface have the number -1, which selects the appended value.
    on_level_objects: Bool = np.append(
        is_on_level_objects & (width <= roof_rule.widest), False
    )[surface]
    return on_level_objects


def islands(heights: Int32, ground: Bool, scale: Scale, cell_m: float) -> Bool:
    """Find the cells of islands: bool [rows, columns].

    Other islands of the same roof do not count as ground: rays continue beyond narrow surfaces
    between objects of the same height.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights of all cells in vertical counts; `EMPTY` where there is none.
    ground : bool [rows, columns]
        Cells of ground.
    scale : Scale
    cell_m : float
        Size of the cells in metres.
    """
    roof_rule = _roof_rule(scale, cell_m)
    levels = np.where(ground, heights, EMPTY).astype(np.int32)
    on_level_objects = _on_level_objects(heights, ground, levels, roof_rule, scale, cell_m)
    is_island: Bool = on_level_objects & plateaus(
        levels, roof_rule, data=heights != EMPTY, passed=on_level_objects
    )
    return is_island


def without_islands(
    surface: Surface, fitted: Int32, heights: Int32, scale: Scale, cell_m: float
) -> Surface:
    """Return the surface without ground at islands on objects.

    Cells around islands that are not ground are left out as well, because the surface was
    continued there from the islands.

    Parameters
    ----------
    surface : Surface
    fitted, heights : int32 [rows, columns]
        Heights of the cells to which the surface was fitted, and of all cells, in vertical counts; `EMPTY` elsewhere.
    scale : Scale
    cell_m : float
        Size of the cells in metres.
    """
    near = np.abs(fitted / scale.counts_z(1.0) - surface.height) < band(
        surface.sigma, surface.narrowing
    )
    ground = (fitted != EMPTY) & near  # Without a surface, the comparison with NaN gives False.
    on_object = islands(heights, ground, scale, cell_m)
    if not on_object.any():
        return surface
    around = scipy.ndimage.maximum_filter(
        on_object, 2 * _around_cells(cell_m) + 1, mode="constant"
    )
    left_out = on_object | (around & ~ground)
    return surface._replace(narrowing=np.where(left_out, np.nan, surface.narrowing))
