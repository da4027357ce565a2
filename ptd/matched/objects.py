"""Large objects of photogrammetric clouds, and islands: cells of a roof that the ground surface wrongly includes.

Large objects are surfaces whose edges fall; each is classified as a whole. A surface consists
of connected cells whose heights differ little from one to the next. At the rim of a roof or a
crown the height falls. At the rim of ground it rises (walls, trunks), or ground continues. So a
surface is classified by its rim and by the share of it that lies on a stiff hull
(`ptd.matched.hull`): a hall's roof does not, a terrace does. A surface wider than a limit is
terrain, so cells beyond a fixed distance do not change the result.

Pits in a roof, for example clumps of blunders, light wells or gaps between parts of the roof,
do not belong to a large object. So the ground surface passes through them, and the terrain
model has facets there at the height of the roof. A connected surface of ground cells is such an
island under these conditions:

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

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.frame import Scale
from ptd.ground.morphology import connected_surfaces
from ptd.ground.plateaus import Plateaus, plateaus
from ptd.kernel import kernel
from ptd.matched.cells import CELL_M, EMPTY
from ptd.matched.ground_model import band
from ptd.matched.hull import ROOFS_TILT_BLOCKS, block_cells, tilts
from ptd.matched.surface import Surface

STEP_M, STEP_SIGMAS = 0.5, 3.0
"""Limits of the height difference of neighbours on a surface, in metres and in multiples of the
noise. The larger limit counts."""
DIAGONAL = 1.4
"""Factor of that limit for neighbours across corners."""
NEAR_M, NEAR_SHARE = 1.0, 0.2
"""Height above the stiff hull below which a cell is near it, and share of such cells below
which a surface may be an object."""
FALL_M, FALL_CELLS, FALL_SHARE = 1.2, 2, 0.6
"""Limits of an object's rim: more than `FALL_SHARE` of its cells have another surface at least `FALL_M` lower within
`FALL_CELLS` cells."""
ALL_FALLS, FALL_LEAST = 0.9, 0.4
"""The rim falls nearly everywhere if the falling cells exceed both `ALL_FALLS` of the rim cells
that are not close to objects found before, and `FALL_LEAST` of all rim cells. Such a surface
may be an object even if it lies near the hull, because the hull climbs onto wide halls."""
CUT_NEAR = 0.5
"""A surface whose rim falls nearly everywhere, but which partly ends at the border of the data,
is not an object if at least this share of its cells lies near the hull: the fall may be a quay
or a bank."""
AREA_M2 = 40.0
"""Area of the smallest object that is classified as a whole; less stiff hulls pass below
smaller ones."""
MAX_WIDTH_M = 200.0
"""Width above which a surface is terrain."""
TERRAIN_M, TERRAIN_FALLS, TERRAIN_RIM = 100.0, 0.35, 0.2
"""Limits of wide terrain, for example ridges and crests, even if the hull touches little of it. It is wider than
`TERRAIN_M`, and at most `TERRAIN_FALLS` of its rim falls. At most `TERRAIN_RIM` of its cells may be rim, because the
top of a wood is full of gaps."""
ON_HULL_M, ON_HULL_SHARE = 70.0, 0.5
"""Limits of the ground of a small survey: it is wider than this in both directions, this share
of it is near the hull, and its rim falls as little as that of wide terrain. In a strip or a
garden, plants next to the border are near the hull and would contribute too much."""
INSIDE_SHARE, INSIDE_M2, YARD_M2 = 0.5, 1000.0, 10.0
"""Limits of enclosed surfaces, for example equipment on a roof, which are classified even if they are small.

More than `INSIDE_SHARE` of the rim lies next to objects found before. Surfaces of `INSIDE_M2`
or more are not enclosed: they may be terraces among houses. From `YARD_M2` on, objects that
rise from the surface do not count: it may be a courtyard, or ground that is visible between
crowns. Smaller surfaces are parts of walls.
"""


@kernel
def _rims(
    heights: Int32, surface: Int32, n: int, hull: Int32, removed: Bool, near: int, fall: int
) -> tuple[Int64, Int64]:
    """Return counts of cells and the box (first and last row, first and last column) of each surface.

    The counts, int64 [n, 7], are in this order:

    0. area: all cells;
    1. near: cells near the hull;
    2. rim: cells at the rim;
    3. falls: rim cells with another surface far below;
    4. inside: rim cells close to objects found before;
    5. cut: cells next to empty ones or the border;
    6. level: rim cells close to objects found before that do not rise far above them.
    """
    rows, columns = heights.shape
    counts, box = np.zeros((n, 7), np.int64), np.zeros((n, 4), np.int64)
    for row in range(rows):
        for column in range(columns):
            number = surface[row, column]
            if number < 0:
                continue
            height = np.int64(heights[row, column])
            if counts[number, 0] == 0:
                box[number, 0], box[number, 1], box[number, 2], box[number, 3] = (
                    row,
                    row,
                    column,
                    column,
                )
            box[number, 1] = row
            box[number, 2], box[number, 3] = (
                min(box[number, 2], column),
                max(box[number, 3], column),
            )
            counts[number, 0] += 1
            counts[number, 1] += height - hull[row, column] < near
            edge, cut = False, False
            for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                r, c = row + dr, column + dc
                if 0 <= r < rows and 0 <= c < columns:
                    edge |= removed[r, c] or (surface[r, c] >= 0 and surface[r, c] != number)
                    cut |= surface[r, c] < 0 and not removed[r, c]
                else:
                    cut = True
            counts[number, 5] += cut
            if not edge:
                continue
            counts[number, 2] += 1
            falls, inside, level = False, False, False
            for r in range(max(row - FALL_CELLS, 0), min(row + FALL_CELLS + 1, rows)):
                for c in range(
                    max(column - FALL_CELLS, 0), min(column + FALL_CELLS + 1, columns)
                ):
                    inside |= removed[r, c]
                    level |= removed[r, c] and heights[r, c] < height + fall
                    falls |= (
                        surface[r, c] >= 0
                        and surface[r, c] != number
                        and heights[r, c] < height - fall
                    )
            counts[number, 3] += falls
            counts[number, 4] += inside
            counts[number, 6] += level
    return counts, box


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells beyond which heights do not change the result of `judged`, for a given hull."""
    return round(MAX_WIDTH_M / cell_m) + FALL_CELLS + 1


def judged(
    heights: Int32,
    hull: Int32,
    removed: Bool,
    sigma_m: float | Float64,
    scale: Scale,
    cell_m: float = CELL_M,
) -> tuple[Bool, Bool]:
    """Find the cells of large objects and the cells of surfaces that are terrain.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights of all cells in vertical counts; `EMPTY` elsewhere.
    hull : int32 [rows, columns]
        Stiff hull of all cells in vertical counts.
    removed : bool [rows, columns]
        Cells of objects found before.
    sigma_m : float or float64 [rows, columns]
        Noise of the place in metres.
    scale : Scale
    cell_m : float
        Size of the cells in metres.

    Returns
    -------
    objects, terrain : bool [rows, columns]
        Masks of the cells of large objects and of terrain.
    """
    block = block_cells(cell_m)
    noise = np.broadcast_to(sigma_m, heights.shape)[::block, ::block]
    step = scale.counts_z(1.0) * np.maximum(STEP_M, STEP_SIGMAS * noise)
    left = np.where(removed, EMPTY, heights).astype(np.int32)
    sloped = tilts(left, ROOFS_TILT_BLOCKS, block)
    surface, n = connected_surfaces(left, step, DIAGONAL * step, tilts=sloped, block=block)
    near_counts, fall_counts = round(scale.counts_z(NEAR_M)), round(scale.counts_z(FALL_M))
    counts, box = _rims(heights, surface, n, hull, removed, near_counts, fall_counts)
    area, near, rim, falls, inside, cut, level = counts.T
    sizes_m = np.stack([box[:, 1] - box[:, 0] + 1, box[:, 3] - box[:, 2] + 1]) * cell_m
    width_m = sizes_m.max(axis=0)
    within = np.where(area * cell_m**2 < YARD_M2, inside, level)
    enclosed = (within > INSIDE_SHARE * rim) & (area * cell_m**2 < INSIDE_M2)
    large = (area * cell_m**2 >= AREA_M2) | enclosed
    fallen = np.where(enclosed, within + falls, falls) / np.maximum(rim, 1)
    around = falls > np.maximum(ALL_FALLS * (rim - inside), FALL_LEAST * rim)
    around &= (cut <= (1.0 - ALL_FALLS) * rim) | (near < CUT_NEAR * area)
    stands = (near < NEAR_SHARE * area) & (fallen > FALL_SHARE) | around
    objects = large & stands & (width_m <= MAX_WIDTH_M)
    wide = (width_m > TERRAIN_M) | (sizes_m.min(axis=0) > ON_HULL_M) & (
        near >= ON_HULL_SHARE * area
    )
    terrain = wide & (fallen <= TERRAIN_FALLS) & (rim <= TERRAIN_RIM * area) & ~objects | (
        width_m > MAX_WIDTH_M
    )
    return np.append(objects, False)[surface], np.append(terrain, False)[surface]


MAX_ISLAND_WIDTH_M = 50.0
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
    return max(round(AROUND_M / cell_m), 1)


def _roof_rule(scale: Scale, cell_m: float) -> Plateaus:
    roof_rule = Plateaus.of(scale, MAX_ISLAND_WIDTH_M, cell_m=cell_m)
    view, slope = round(VIEW_M / cell_m), scale.counts_z(SLOPE * cell_m)
    return replace(roof_rule, view=view, slope=slope, unseen=UNSEEN_SHARE)


def island_reach_cells(cell_m: float) -> int:
    """Return the distance in cells beyond which cells do not change the result of `without_islands`.

    Rays begin at the last cell of an island and may end at the first cell of another surface. A
    surface that continues beyond this distance is too wide for an island, because the part
    within the distance is wider than `MAX_ISLAND_WIDTH_M`.
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
    return np.append(is_on_level_objects & (width <= roof_rule.widest), False)[surface]


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
    return on_level_objects & plateaus(
        levels, roof_rule, data=heights != EMPTY, passed=on_level_objects
    )


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
