"""Large objects of matched clouds as wholes: connected surfaces that end in walls which fall.

Cells are of one surface where their heights differ little from one to the next. A roof or a crown is surrounded by
falls, ground by rises (walls, trunks) and by what goes on. So a surface is judged by its rim, and by how much of it
lies on a stiff hull (`ptd.matched.hull`): a hall's roof does not, a terrace does. A surface wider than a limit is
terrain, so nothing farther than a fixed reach has a part in the answer.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64
from ptd.frame import Scale
from ptd.ground.connected import connected_surfaces
from ptd.ground.morphology import Bool
from ptd.kernel import kernel
from ptd.matched.cells import CELL_M, EMPTY
from ptd.matched.hull import ROOFS_TILT_BLOCKS, block_cells, tilts

Float64 = npt.NDArray[np.float64]

STEP_M, STEP_SIGMAS = 0.5, 3.0
"""Neighbours on a surface differ by less than the larger of both (by half as much again across corners)."""
DIAGONAL = 1.4
NEAR_M, NEAR_SHARE = 1.0, 0.2
"""Least share of a surface that lies so near the stiff hull if the surface is terrain."""
FALL_M, FALL_CELLS, FALL_SHARE = 1.2, 2, 0.6
"""At an object's rim more than this share of the cells has another surface so far below within so many cells."""
ALL_FALLS, FALL_LEAST = 0.9, 0.4
"""At a rim that falls nearly everywhere it does not matter how near the hull is: halls may be too wide for that. Where
objects found before are not counted, it still falls at this share of the whole rim."""
CUT_NEAR = 0.5
"""Unless the border of the data cuts the surface: then the fall may be a quay or a bank, and no more than this share
may lie near the hull."""
AREA_M2 = 40.0
"""The smallest object that is judged as a whole; smaller ones are passed below by less stiff hulls."""
MAX_WIDTH_M = 200.0
"""What is wider than this is terrain."""
TERRAIN_M, TERRAIN_FALLS, TERRAIN_RIM = 100.0, 0.35, 0.2
"""So is what is wider than this and falls at no more than this share of its rim, however little of it the hull touches:
ridges and crests. But no more than this share of its cells may be rim: the top of a wood is full of gaps."""
ON_HULL_M, ON_HULL_SHARE = 70.0, 0.5
"""And what is wider than this both ways, falls as little, and lies near the hull by this share: the ground of a small
survey. In a strip or a garden plants that lean on it would have too large a part."""
INSIDE_SHARE, INSIDE_M2, YARD_M2 = 0.5, 1000.0, 10.0
"""A surface, however small, is judged if so much of its rim is that of objects found before: equipment on a roof. Not a
larger one than the second: it may be a terrace among houses. From the third on, objects that rise from it do not count:
it may be a courtyard, or a glimpse of the ground between crowns; smaller ones are parts of walls."""


@kernel
def _rims(
    heights: Int32, surface: Int32, n: int, hull: Int32, removed: Bool, near: int, fall: int
) -> tuple[Int64, Int64]:
    """Counts of each surface, and its box (first and last row, column).

    Counted are its cells (area), those near the hull, those at its rim, those of the rim with another surface far below
    and those beside objects found before (inside), cells beside empty ones or the border (cut), and those at the rim
    beside objects found before that do not rise far from it (level).
    """
    rows, columns = heights.shape
    counts, box = np.zeros((n, 7), np.int64), np.zeros((n, 4), np.int64)
    for row in range(rows):
        for column in range(columns):
            own = surface[row, column]
            if own < 0:
                continue
            height = np.int64(heights[row, column])
            if counts[own, 0] == 0:
                box[own, 0], box[own, 1], box[own, 2], box[own, 3] = row, row, column, column
            box[own, 1] = row
            box[own, 2], box[own, 3] = min(box[own, 2], column), max(box[own, 3], column)
            counts[own, 0] += 1
            counts[own, 1] += height - hull[row, column] < near
            edge, cut = False, False
            for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                r, c = row + dr, column + dc
                if 0 <= r < rows and 0 <= c < columns:
                    edge |= removed[r, c] or (surface[r, c] >= 0 and surface[r, c] != own)
                    cut |= surface[r, c] < 0 and not removed[r, c]
                else:
                    cut = True
            counts[own, 5] += cut
            if not edge:
                continue
            counts[own, 2] += 1
            falls, inside, level = False, False, False
            for r in range(max(row - FALL_CELLS, 0), min(row + FALL_CELLS + 1, rows)):
                for c in range(max(column - FALL_CELLS, 0), min(column + FALL_CELLS + 1, columns)):
                    inside |= removed[r, c]
                    level |= removed[r, c] and heights[r, c] < height + fall
                    falls |= surface[r, c] >= 0 and surface[r, c] != own and heights[r, c] < height - fall
            counts[own, 3] += falls
            counts[own, 4] += inside
            counts[own, 6] += level
    return counts, box


def reach_cells(cell_m: float) -> int:
    """Cells beyond which nothing has a part in what `judged` says, its hull apart."""
    return round(MAX_WIDTH_M / cell_m) + FALL_CELLS + 1


def judged(
    heights: Int32, hull: Int32, removed: Bool, sigma_m: float | Float64, scale: Scale, cell_m: float = CELL_M
) -> tuple[Bool, Bool]:
    """Cells of large objects, and cells of surfaces that are terrain.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Vertical counts of all cells; `EMPTY` elsewhere.
    hull : int32 [rows, columns]
        The stiff hull of all cells.
    removed : bool [rows, columns]
        Cells of objects found before.
    sigma_m : float or float64 [rows, columns]
        Noise of the place in metres.
    scale : Scale
    cell_m : float
        Side of the cells.

    Returns
    -------
    objects, terrain : bool [rows, columns]
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
    sides_m = np.stack([box[:, 1] - box[:, 0] + 1, box[:, 3] - box[:, 2] + 1]) * cell_m
    width_m = sides_m.max(axis=0)
    within = np.where(area * cell_m**2 < YARD_M2, inside, level)
    enclosed = (within > INSIDE_SHARE * rim) & (area * cell_m**2 < INSIDE_M2)
    large = (area * cell_m**2 >= AREA_M2) | enclosed
    fallen = np.where(enclosed, within + falls, falls) / np.maximum(rim, 1)
    around = falls > np.maximum(ALL_FALLS * (rim - inside), FALL_LEAST * rim)
    around &= (cut <= (1.0 - ALL_FALLS) * rim) | (near < CUT_NEAR * area)
    stands = (near < NEAR_SHARE * area) & (fallen > FALL_SHARE) | around
    objects = large & stands & (width_m <= MAX_WIDTH_M)
    wide = (width_m > TERRAIN_M) | (sides_m.min(axis=0) > ON_HULL_M) & (near >= ON_HULL_SHARE * area)
    terrain = wide & (fallen <= TERRAIN_FALLS) & (rim <= TERRAIN_RIM * area) & ~objects | (
        width_m > MAX_WIDTH_M
    )
    return np.append(objects, False)[surface], np.append(terrain, False)[surface]
