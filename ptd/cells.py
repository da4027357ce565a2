"""Points by the cells of a square lattice, and the lowest point of each cell."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.frame import CellLattice
from ptd.kernel import as_int64, inlined, kernel

Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]


class Xyz(NamedTuple):
    """Coordinates of points, as one argument of kernels: local counts, int32 [n] each, contiguous."""

    x: Int32
    y: Int32
    z: Int32


DENSE_CELLS_PER_POINT = 16
"""Most cells per point for which a raster of cells is made; sparser clouds are sorted instead."""


@kernel
def quotient(value: int, divisor: int, inverse: float) -> int:
    """Floor of an integer divided by another (above 0), given 1 / divisor. This is several times faster than dividing.

    It is exact for quotients below 2**50, as the first result is at most one off and is corrected.
    """
    found = math.floor(float(value) * inverse)
    rest = value - found * divisor
    if rest < 0:
        return found - 1
    return found + (rest >= divisor)


@kernel
def cell_keys(
    x: Int32, y: Int32, p: int, q: int, ox: int, oy: int, col0: int, row0: int, width: int
) -> Int64:
    """``row * width + column`` of each point, relative to (col0, row0): int64 [n]."""
    out, inverse = np.empty(x.size, np.int64), 1.0 / p
    for i in range(x.size):
        column = quotient((as_int64(x[i]) + ox) * q, p, inverse) - col0
        row = quotient((as_int64(y[i]) + oy) * q, p, inverse) - row0
        out[i] = row * width + column
    return out


def keys_in(x: Int32, y: Int32, cells: CellLattice, col0: int, row0: int, width: int) -> Int64:
    """`cell_keys` for cells of a lattice."""
    lattice = {"p": cells.p, "q": cells.q, "ox": cells.origin_x, "oy": cells.origin_y}
    return cell_keys(x, y, **lattice, col0=col0, row0=row0, width=width)


@kernel
def is_lower(x: Int32, y: Int32, z: Int32, i: int, j: int) -> bool:
    """Return whether point i is lower than j. Of equally high points, that with the smaller x, then y, is lower."""
    if z[i] != z[j]:
        return bool(z[i] < z[j])
    if x[i] != x[j]:
        return bool(x[i] < x[j])
    return bool(y[i] < y[j])


@kernel
def lowest_by_key(x: Int32, y: Int32, z: Int32, keys: Int64, n_cells: int) -> Int32:
    """Lowest point of each cell, -1 for empty cells: int32 [n_cells]."""
    lowest = np.full(n_cells, -1, np.int32)
    height = np.full(n_cells, 2**31 - 1, np.int32)
    for i in range(keys.size):
        height[keys[i]] = min(height[keys[i]], z[i])
    for i in range(keys.size):  # few points equal the lowest height
        if z[i] == height[keys[i]]:
            j = lowest[keys[i]]
            if j < 0 or is_lower(x, y, z, i, j):
                lowest[keys[i]] = i
    return lowest


@kernel
def _lowest_sorted(x: Int32, y: Int32, z: Int32, keys: Int64, order: Int64) -> Int32:
    """Lowest point of each occupied cell, given the order that sorts the keys."""
    out = np.empty(keys.size, np.int32)
    n = 0
    for k in range(order.size):
        i = order[k]
        if k == 0 or keys[i] != keys[order[k - 1]]:
            out[n] = i
            n += 1
        elif is_lower(x, y, z, i, out[n - 1]):
            out[n - 1] = i
    return out[:n].copy()


def lowest_per_cell(x: Int32, y: Int32, z: Int32, cells: CellLattice) -> Int32:
    """The lowest point of each occupied cell, in row-major order of the cells.

    Among equal heights the lexicographically smallest (x, y) is taken, so the order of the points has no effect.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts.
    cells : CellLattice

    Returns
    -------
    int32 [m]
        Indices into the arrays.
    """
    if x.size == 0:
        return np.zeros(0, np.int32)
    col0, row0 = cells.column(int(x.min())), cells.row(int(y.min()))
    width = cells.column(int(x.max())) - col0 + 1
    n_cells = width * (cells.row(int(y.max())) - row0 + 1)
    keys = keys_in(x, y, cells, col0, row0, width)
    if np.all(keys[1:] > keys[:-1]):  # already one point per cell in order, from an earlier call
        return np.arange(x.size, dtype=np.int32)
    if n_cells <= DENSE_CELLS_PER_POINT * x.size + 1024:
        lowest = lowest_by_key(x, y, z, keys, n_cells)
        return lowest[lowest >= 0]
    return _lowest_sorted(x, y, z, keys, np.argsort(keys, kind="stable"))


def occupied(keys: Int64, n_cells: int) -> tuple[Int64, Int64]:
    """Sorted keys of the occupied cells, and the index among them of each point's cell.

    Parameters
    ----------
    keys : int64 [n]
        Keys of the points' cells, at least 0.
    n_cells : int
        Number of cells of a raster; more than the largest key.

    Returns
    -------
    found : int64 [m]
    slot : int64 [n]
    """
    if n_cells > DENSE_CELLS_PER_POINT * keys.size + 1024:
        found, slot = np.unique(keys, return_inverse=True)
        return found, slot
    return _occupied_raster(keys, n_cells)


@kernel
def _occupied_raster(keys: Int64, n_cells: int) -> tuple[Int64, Int64]:
    """`occupied` with the help of a raster."""
    slots = np.full(n_cells, -1, np.int32)
    for key in keys:
        slots[key] = 0
    n = 0
    for k in range(n_cells):
        if slots[k] == 0:
            slots[k] = n
            n += 1
    found, slot = np.empty(n, np.int64), np.empty(keys.size, np.int64)
    for k in range(n_cells):
        if slots[k] >= 0:
            found[slots[k]] = k
    for i in range(keys.size):
        slot[i] = slots[keys[i]]
    return found, slot


class CellTable(NamedTuple):
    """Points listed by cell, for kernels.

    Attributes
    ----------
    slots : int32 [height * width] or int32 [0]
        Index into `keys` of each cell (-1: empty). It has no entries if the raster would be too large.
    keys : int64 [m]
        Sorted keys of the occupied cells, ``row * width + column``.
    starts : int64 [m + 1]
        Points of cell k are ``order[starts[k]:starts[k + 1]]``.
    order : int64 [n]
    width, height : int
        Number of columns and rows that contain all points.
    """

    slots: Int32
    keys: Int64
    starts: Int64
    order: Int64
    width: int
    height: int


class CellIndex:
    """Points listed by cell, for searches among neighbours. Memory grows with the points, not with the extent.

    Attributes
    ----------
    cells : CellLattice
    col0, row0 : int
        First column and row of the table within the lattice.
    table : CellTable
    """

    def __init__(self, x: Int32, y: Int32, cells: CellLattice) -> None:
        self.cells = cells
        self.col0, self.row0 = cells.column(int(x.min())), cells.row(int(y.min()))
        width = cells.column(int(x.max())) - self.col0 + 1
        height = cells.row(int(y.max())) - self.row0 + 1
        point_keys = keys_in(x, y, cells, self.col0, self.row0, width)
        ordered = bool((point_keys[1:] >= point_keys[:-1]).all())
        order = np.arange(x.size)
        if not ordered:
            order = np.argsort(point_keys, kind="stable")
            point_keys = point_keys[order]
        first = np.flatnonzero(np.append(True, point_keys[1:] != point_keys[:-1]))
        keys = point_keys[first]
        slots = np.zeros(0, np.int32)
        if width * height <= DENSE_CELLS_PER_POINT * x.size + 1024:
            slots = np.full(width * height, -1, np.int32)
            slots[keys] = np.arange(keys.size, dtype=np.int32)
        self.table = CellTable(slots, keys, np.append(first, x.size).astype(np.int64), order, width, height)

    def places(self, x: Int32, y: Int32) -> tuple[Int64, Int64]:
        """Columns and rows of positions within the table: int64 [n] each."""
        columns, rows = self.cells.places(x, y)
        return columns - self.col0, rows - self.row0

    def find(self, x: Int32, y: Int32) -> Int32:
        """Index into the table's `keys` of the cell of each position, -1 for empty cells: int32 [n]."""
        c = self.cells
        return _find(x, y, c.p, c.q, c.origin_x, c.origin_y, self.col0, self.row0, self.table)


@kernel
def find_slot(slots: Int32, keys: Int64, width: int, height: int, column: int, row: int) -> int:
    """`slot_of` for inner loops, with the table unpacked beforehand."""
    if column < 0 or row < 0 or column >= width or row >= height:
        return -1
    key = row * width + column
    if slots.size > 0:
        return int(slots[key])
    k = np.searchsorted(keys, key)
    return int(k) if k < keys.size and keys[k] == key else -1


@inlined
def slot_of(table: CellTable, column: int, row: int) -> int:
    """Return the index of a cell among the table's occupied ones, or -1 if it is empty or outside."""
    return find_slot(table.slots, table.keys, table.width, table.height, column, row)


@kernel
def _find(
    x: Int32, y: Int32, p: int, q: int, ox: int, oy: int, col0: int, row0: int, table: CellTable
) -> Int32:
    slots, keys, _starts, _order, width, height = table
    out, inverse = np.empty(x.size, np.int32), 1.0 / p
    for i in range(x.size):
        column = quotient((as_int64(x[i]) + ox) * q, p, inverse) - col0
        row = quotient((as_int64(y[i]) + oy) * q, p, inverse) - row0
        out[i] = find_slot(slots, keys, width, height, column, row)
    return out


def positions(x: Int32, y: Int32) -> Int64:
    """Return a number for each position, which differs for different positions: int64 [n]."""
    return (x.astype(np.int64) << 32) + y
