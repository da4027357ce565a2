"""Grouping of points by the cells of a square lattice, and the lowest point of each cell."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64
from ptd.frame import CellGrid, CellLattice
from ptd.kernel import as_int64, inlined, kernel
from ptd.sorting import sort_pairs


class Xyz(NamedTuple):
    """Coordinates of points, as one argument of kernels: local counts, int32 [n] each, contiguous."""

    x: Int32
    y: Int32
    z: Int32


DENSE_CELLS_PER_POINT = 16
"""A raster of cells is made if it has at most this many cells per point. Otherwise the points
are sorted."""
SAMPLED_CELLS_PER_POINT = 4
"""The same for samples, where a cell takes three times the memory."""
POSITION_BITS = 63
"""Bits of an int64 that is not negative."""
MIX_X, MIX_Y, MIX_Z = (
    np.uint64(factor) for factor in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)
"""Odd factors of SplitMix64 (Steele, Lea and Flood 2014)."""


@kernel
def quotient(value: int, divisor: int, inverse: float) -> int:
    """Return the floor of ``value / divisor``, given ``inverse``, which is 1 / divisor. The divisor is above 0.

    This is several times faster than a division. The result is exact for quotients below 2**50:
    the product with the inverse is wrong by at most one, and is corrected.
    """
    floor = math.floor(float(value) * inverse)
    rest = value - floor * divisor
    if rest < 0:
        return floor - 1
    return floor + (rest >= divisor)


@kernel
def _keys(x: Int32, y: Int32, grid: CellGrid, width: int) -> Int64:
    p, q, ox, oy, col0, row0 = grid
    out, inverse = np.empty(x.size, np.int64), 1.0 / p
    for i in range(x.size):
        column = quotient((as_int64(x[i]) + ox) * q, p, inverse) - col0
        row = quotient((as_int64(y[i]) + oy) * q, p, inverse) - row0
        out[i] = row * width + column
    return out


def cell_keys(
    x: Int32, y: Int32, cells: CellLattice, col0: int, row0: int, width: int
) -> Int64:
    """Return the key of each point's cell, ``row * width + column`` relative to (col0, row0): int64 [n]."""
    return _keys(x, y, cells.grid(col0, row0), width)


@kernel
def is_lower(x: Int32, y: Int32, z: Int32, i: int, j: int) -> bool:
    """Return whether point i is lower than point j.

    Of equally high points, the point with the smaller x counts as lower. If x is equal as well,
    y decides.
    """
    if z[i] != z[j]:
        return bool(z[i] < z[j])
    if x[i] != x[j]:
        return bool(x[i] < x[j])
    return bool(y[i] < y[j])


@kernel
def lowest_by_key(x: Int32, y: Int32, z: Int32, keys: Int64, n_cells: int) -> Int32:
    """Return the index of the lowest point of each cell, -1 for empty cells: int32 [n_cells]."""
    lowest = np.full(n_cells, -1, np.int32)
    height = np.full(n_cells, 2**31 - 1, np.int32)
    for i in range(keys.size):
        height[keys[i]] = min(height[keys[i]], z[i])
    # Few points have the lowest height of their cell, so `is_lower` is seldom called.
    for i in range(keys.size):
        if z[i] == height[keys[i]]:
            j = lowest[keys[i]]
            if j < 0 or is_lower(x, y, z, i, j):
                lowest[keys[i]] = i
    return lowest


@kernel
def _lowest_sorted(x: Int32, y: Int32, z: Int32, keys: Int64, order: Int64) -> Int32:
    """Return the index of the lowest point of each occupied cell, given the order that sorts the keys."""
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


def _keys_in_extent(x: Int32, y: Int32, cells: CellLattice) -> tuple[Int64, int]:
    """Return the key of each point's cell and the number of cells in the rectangle around the points, at least one."""
    col0, row0, width, height = cells.extent(x, y)
    return cell_keys(x, y, cells, col0, row0, width), width * height


def lowest_per_cell(x: Int32, y: Int32, z: Int32, cells: CellLattice) -> Int32:
    """Find the lowest point of each occupied cell, in row-major order of the cells.

    If several points are equally low, x and y decide (see `is_lower`), so the order of the
    points has no effect.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts.
    cells : CellLattice

    Returns
    -------
    int32 [m]
        Indices of the points.
    """
    if x.size == 0:
        return np.zeros(0, np.int32)
    keys, n_cells = _keys_in_extent(x, y, cells)
    if np.all(
        keys[1:] > keys[:-1]
    ):  # The cells are in order and have one point each, as after an earlier call.
        return np.arange(x.size, dtype=np.int32)
    if n_cells <= DENSE_CELLS_PER_POINT * x.size + 1024:
        lowest = lowest_by_key(x, y, z, keys, n_cells)
        return lowest[lowest >= 0]
    return _lowest_sorted(x, y, z, keys, np.argsort(keys, kind="stable"))


def sample_per_cell(x: Int32, y: Int32, z: Int32, cells: CellLattice) -> Int32:
    """Choose one point of each occupied cell, in row-major order of the cells.

    The choice is as good as random, but depends only on the absolute positions. So the point of a cell with twice the
    side is that of one of its quarters. Of points at the same position, the first one is chosen.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts.
    cells : CellLattice

    Returns
    -------
    int32 [m]
        Indices of the points.
    """
    if x.size == 0:
        return np.zeros(0, np.int32)
    keys, n_cells = _keys_in_extent(x, y, cells)
    if n_cells > SAMPLED_CELLS_PER_POINT * x.size + 1024:
        occupied_cells, keys = np.unique(keys, return_inverse=True)
        n_cells = occupied_cells.size
    chosen = _sample_by_key(x, y, z, keys, n_cells, cells.grid(0, 0))
    return chosen[chosen >= 0]


@kernel
def _sample_by_key(
    x: Int32, y: Int32, z: Int32, keys: Int64, n_cells: int, grid: CellGrid
) -> Int32:
    """Return the index of the point of each cell whose mixed position is smallest, -1 for empty cells."""
    chosen = np.full(n_cells, -1, np.int32)
    smallest = np.zeros(n_cells, np.uint64)
    for i in range(keys.size):
        mixed = np.uint64(as_int64(x[i]) + grid.origin_x) * MIX_X
        mixed += np.uint64(as_int64(y[i]) + grid.origin_y) * MIX_Y
        mixed += np.uint64(as_int64(z[i])) * MIX_Z
        mixed = (mixed ^ (mixed >> np.uint64(32))) * MIX_Y
        mixed = (mixed ^ (mixed >> np.uint64(32))) * MIX_Z
        if chosen[keys[i]] < 0 or mixed < smallest[keys[i]]:
            smallest[keys[i]] = mixed
            chosen[keys[i]] = i
    return chosen


def sort_in_cells(
    x: Int32, y: Int32, z: Int32, cells: CellLattice
) -> tuple[Int64, Int64, Bool]:
    """Sort points by cell in row-major order, and within a cell by z, x, y.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, at least one.
    cells : CellLattice
        The rectangle of cells around the points must have less than 2**63 cells.

    Returns
    -------
    order : int64 [n]
        Indices of the sorted points. The order of points at the same position is arbitrary.
    keys : int64 [n]
        Key of each point's cell, which increases in row-major order of the cells.
    is_repeat : bool [n]
        Mask, in the order, of the points at the position of the point before them.
    """
    low = int(x.min()), int(y.min()), int(z.min())
    high = int(x.max()), int(y.max()), int(z.max())
    keys, n_cells = _keys_in_extent(x, y, cells)
    x_bits, y_bits, z_bits = ((b - a).bit_length() for a, b in zip(low, high, strict=True))
    dense = n_cells <= DENSE_CELLS_PER_POINT * x.size + 1024
    is_repeat = np.zeros(x.size, np.bool_)
    if dense and x_bits + y_bits + z_bits <= POSITION_BITS:
        positions = z.astype(np.int64) - low[2]
        for bits, values, lowest in ((x_bits, x, low[0]), (y_bits, y, low[1])):
            positions <<= bits
            positions += values
            positions -= lowest
        order, in_order = np.empty(x.size, np.int64), np.empty(x.size, np.int64)
        _sort_in_raster(keys, positions, np.zeros(n_cells + 1, np.int64), order, in_order)
        is_repeat[1:] = in_order[1:] == in_order[:-1]
    else:
        order = np.lexsort((y, x, z, keys))
        sorted_xyz = np.stack((x, y, z))[:, order]
        is_repeat[1:] = (sorted_xyz[:, 1:] == sorted_xyz[:, :-1]).all(axis=0)
    return order, keys, is_repeat


@kernel
def _sort_in_raster(
    keys: Int64, positions: Int64, ends: Int64, order: Int64, in_order: Int64
) -> None:
    """Sort points by cell with a counting sort, and by position within each cell.

    ``ends`` has one more entry than there are cells, all 0. ``order`` and ``in_order`` receive
    the sorted points and their positions.
    """
    for key in keys:
        ends[key + 1] += 1
    for cell in range(ends.size - 1):
        ends[cell + 1] += ends[cell]
    for i in range(keys.size):
        k = ends[keys[i]]
        ends[keys[i]] = k + 1
        order[k], in_order[k] = i, positions[i]
    first = 0
    for cell in range(ends.size - 1):
        sort_pairs(in_order, order, first, ends[cell])
        first = ends[cell]


def occupied(keys: Int64, n_cells: int) -> tuple[Int64, Int64]:
    """Find the occupied cells.

    Parameters
    ----------
    keys : int64 [n]
        Keys of the points' cells, at least 0.
    n_cells : int
        Number of cells of a raster; more than the largest key.

    Returns
    -------
    cells : int64 [m]
        Sorted keys of the occupied cells.
    slot : int64 [n]
        Index into `cells` of the cell of each point.
    """
    if n_cells > DENSE_CELLS_PER_POINT * keys.size + 1024:
        cells, slot = np.unique(keys, return_inverse=True)
        return cells, slot
    return _occupied_raster(keys, n_cells)


@kernel
def _occupied_raster(keys: Int64, n_cells: int) -> tuple[Int64, Int64]:
    """Find the occupied cells, like `occupied`, with a raster of all cells."""
    slots = np.full(n_cells, -1, np.int32)
    for key in keys:
        slots[key] = 0
    n = 0
    for k in range(n_cells):
        if slots[k] == 0:
            slots[k] = n
            n += 1
    cells = np.empty(n, np.int64)
    for k in range(n_cells):
        if slots[k] >= 0:
            cells[slots[k]] = k
    slot = np.empty(keys.size, np.int64)
    for i in range(keys.size):
        slot[i] = slots[keys[i]]
    return cells, slot


class CellTable(NamedTuple):
    """Points sorted by cell, as an argument of kernels.

    Attributes
    ----------
    slots : int32 [height * width] or int32 [0]
        Index of each cell into `keys`, -1 for empty cells. The array has no entries if it would be too large.
    keys : int64 [m]
        Sorted keys of the occupied cells, ``row * width + column``.
    starts : int64 [m + 1]
        The points of the cell with the index k are ``order[starts[k]:starts[k + 1]]``.
    order : int64 [n]
        Indices of the points, sorted by cell.
    width, height : int
        Number of columns and of rows between the outermost points.
    """

    slots: Int32
    keys: Int64
    starts: Int64
    order: Int64
    width: int
    height: int


class CellIndex:
    """Points sorted by cell, for searches in neighbouring cells. Memory grows with the points, not with the extent.

    Attributes
    ----------
    cells : CellLattice
    col0, row0 : int
        First column and row of the table within the lattice.
    table : CellTable
    """

    def __init__(self, x: Int32, y: Int32, cells: CellLattice) -> None:
        self.cells = cells
        self.col0, self.row0, width, height = cells.extent(x, y)
        point_keys = cell_keys(x, y, cells, self.col0, self.row0, width)
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
        self.table = CellTable(
            slots, keys, np.append(first, x.size).astype(np.int64), order, width, height
        )

    def cell_indices(self, x: Int32, y: Int32) -> tuple[Int64, Int64]:
        """Return columns and rows of positions within the table: int64 [n] each."""
        columns, rows = self.cells.cell_indices(x, y)
        return columns - self.col0, rows - self.row0

    def find(self, x: Int32, y: Int32) -> Int32:
        """Return for each position the index of its cell into `CellTable.keys`, -1 for empty cells: int32 [n]."""
        return _find(x, y, self.cells.grid(self.col0, self.row0), self.table)


@kernel
def find_slot(slots: Int32, keys: Int64, width: int, height: int, column: int, row: int) -> int:
    """Return the result of `slot_of`. It is faster in inner loops to pass the fields of the table than the table."""
    if column < 0 or row < 0 or column >= width or row >= height:
        return -1
    key = row * width + column
    if slots.size > 0:
        return int(slots[key])
    k = np.searchsorted(keys, key)
    return int(k) if k < keys.size and keys[k] == key else -1


@inlined
def slot_of(table: CellTable, column: int, row: int) -> int:
    """Return the index of a cell into `CellTable.keys`, or -1 if the cell is empty or outside."""
    return find_slot(table.slots, table.keys, table.width, table.height, column, row)


@kernel
def _find(x: Int32, y: Int32, grid: CellGrid, table: CellTable) -> Int32:
    p, q, ox, oy, col0, row0 = grid
    slots, keys, _starts, _order, width, height = table
    out, inverse = np.empty(x.size, np.int32), 1.0 / p
    for i in range(x.size):
        column = quotient((as_int64(x[i]) + ox) * q, p, inverse) - col0
        row = quotient((as_int64(y[i]) + oy) * q, p, inverse) - row0
        out[i] = find_slot(slots, keys, width, height, column, row)
    return out


def position_keys(x: Int32, y: Int32) -> Int64:
    """Return an integer for each position, different for different positions: int64 [n]."""
    return (x.astype(np.int64) << 32) + y
