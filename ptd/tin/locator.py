"""Start triangles for point location: a raster that holds a triangle near each position."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptd.cells import quotient
from ptd.kernel import as_int64, inlined, kernel
from ptd.tin.layout import N_VERTICES, Int32Array
from ptd.tin.mesh import Tin

GRID_CELLS_PER_VERTEX = 2


@kernel
def _fill(row: Int32Array) -> bool:
    """Give empty cells (-1) of a row the value of the nearest filled one, and return False if none is filled."""
    before, start = -1, 0
    for k in range(row.size + 1):
        if k < row.size and row[k] < 0:
            continue
        if k == row.size and before < 0:
            return False
        for empty in range(start, k):
            nearer = before < 0 or (k < row.size and k - empty < empty - before)
            row[empty] = row[k if nearer else before]
        before, start = k, k + 1
    return True


@kernel
def _start_grid(
    vertices: Int32Array, n: int, west: int, south: int, cell: int, height: int, width: int
) -> Int32Array:
    """A triangle near each cell of a raster: int32 [height * width], row by row from the south-west."""
    grid, inverse = np.full(height * width, -1, np.int32), 1.0 / cell
    for v in range(n):
        row = quotient(vertices[4 * v + 1] - south, cell, inverse)
        column = quotient(vertices[4 * v] - west, cell, inverse)
        grid[row * width + column] = max(vertices[4 * v + 3], 0)
    for row in range(height):
        if not _fill(grid[row * width : (row + 1) * width]):
            grid[row * width : (row + 1) * width] = grid[(row - 1) * width : row * width]
    return grid


class Locator(NamedTuple):
    """Raster of triangles from which a point location starts, so that points may come in any order.

    Attributes
    ----------
    grid : int32 [height * width]
        A triangle near each cell of a raster, row by row from the south-west.
    west, south : int
        South-west corner of the raster, local counts.
    cell : int
        Size of a cell, counts.
    inverse : float
        1 / cell.
    width, height : int
    """

    grid: Int32Array
    west: int
    south: int
    cell: int
    inverse: float
    width: int
    height: int

    @classmethod
    def of(cls, tin: Tin) -> Locator:
        """Raster of start triangles of a TIN in its present state."""
        n = int(tin.counters[N_VERTICES])
        xy = tin.vertex_array[: 4 * n].reshape(-1, 4)
        west, south = int(xy[:, 0].min()), int(xy[:, 1].min())
        across, high = int(xy[:, 0].max()) - west + 1, int(xy[:, 1].max()) - south + 1
        cell = max(
            int(np.sqrt(across * high / (GRID_CELLS_PER_VERTEX * n))),
            (across + high) // (8 * n + 64) + 1,
        )
        width, height = across // cell + 1, high // cell + 1
        grid = _start_grid(tin.vertex_array, n, west, south, cell, height, width)
        return cls(grid, west, south, cell, 1.0 / cell, width, height)


@inlined
def start_near(locator: Locator, x: int, y: int) -> int:
    """A triangle near (x, y), from which `ptd.tin.location.locate` walks."""
    column = quotient(as_int64(x) - locator.west, locator.cell, locator.inverse)
    row = quotient(as_int64(y) - locator.south, locator.cell, locator.inverse)
    column = min(max(column, 0), locator.width - 1)
    row = min(max(row, 0), locator.height - 1)
    return as_int64(locator.grid[row * locator.width + column])
