"""Connected surfaces of a raster: cells whose heights differ little from one to the next."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64
from ptd.ground.morphology import EMPTY
from ptd.kernel import kernel

Float64 = npt.NDArray[np.float64]

EAST = (1, 0, -1, 0, 1, -1, -1, 1)
NORTH = (0, 1, 0, -1, 1, 1, -1, -1)
"""Steps to the eight neighbours of a cell, straight ones first."""


def connected_surfaces(
    heights: Int32,
    straight: float | Float64,
    diagonal: float | Float64,
    gap: int = 1,
    tilts: tuple[Int64, Int64] | None = None,
    block: int = 1,
) -> tuple[Int32, int]:
    """Number the connected surfaces of a raster.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights in counts; `EMPTY` where there is none.
    straight, diagonal : float or float64 [block rows, block columns]
        Height difference below which neighbours along a row or column, and across corners, belong to one surface. If
        two neighbours lie in different blocks (`block`), the larger limit applies.
    gap : int
        Largest distance of neighbours in cells, with empty cells between them.
    tilts : (int64, int64), optional
        Large-scale slopes of the terrain, to the north and to the east, in counts per cell, for each block of cells.
        Neighbours also belong to one surface if their height difference minus this slope is below the limit.
    block : int
        Size of those blocks in cells.

    Returns
    -------
    surface : int32 [rows, columns]
        Number of each cell's surface, in the order of their first cells; -1 for empty cells.
    n : int
        Number of surfaces.
    """
    if tilts is None:
        block = max(*heights.shape, 1)
        tilts = np.zeros((1, 1), np.int64), np.zeros((1, 1), np.int64)
    limits = np.stack(
        [np.broadcast_to(np.float64(limit), tilts[0].shape) for limit in (straight, diagonal)]
    )
    return _fill(np.ascontiguousarray(heights), limits, gap, tilts[0], tilts[1], block)


@kernel
def _fill(
    heights: Int32, limits: Float64, gap: int, north: Int64, east: Int64, block: int
) -> tuple[Int32, int]:
    rows, columns = heights.shape
    surface = np.full((rows, columns), -1, np.int32)
    waiting = np.empty(rows * columns, np.int64)
    n = 0
    for start in range(rows * columns):
        if (
            surface[start // columns, start % columns] >= 0
            or heights[start // columns, start % columns] == EMPTY
        ):
            continue
        surface[start // columns, start % columns] = n
        waiting[0], left = start, 1
        while left:
            left -= 1
            row, column = waiting[left] // columns, waiting[left] % columns
            for way in range(8):
                for steps in range(1, gap + 1):
                    r, c = row + steps * NORTH[way], column + steps * EAST[way]
                    if r < 0 or c < 0 or r >= rows or c >= columns:
                        break
                    if heights[r, c] == EMPTY:
                        continue
                    if surface[r, c] < 0:
                        # In 64 bits: heights of opposite ends of int32 differ by more than it
                        # holds.
                        rise = np.int64(heights[r, c]) - np.int64(heights[row, column])
                        tilt = NORTH[way] * (
                            north[r // block, c // block] + north[row // block, column // block]
                        )
                        tilt += EAST[way] * (
                            east[r // block, c // block] + east[row // block, column // block]
                        )
                        limit = max(
                            limits[way // 4, r // block, c // block],
                            limits[way // 4, row // block, column // block],
                        )
                        if abs(rise) < limit or abs(rise - steps * tilt / 2) < limit:
                            surface[r, c] = n
                            waiting[left] = r * columns + c
                            left += 1
                    break
        n += 1
    return surface, n
