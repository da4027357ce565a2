"""Robust heights of the cells of photogrammetric clouds.

The lowest point of a cell would be a blunder or lie in the tail of the noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ptd.arrays import AnyArray, Float64, Int32, Int64
from ptd.cells import cell_keys
from ptd.frame import CellLattice, Scale, Window
from ptd.kernel import kernel
from ptd.places import Field, on_cells

CELL_M = 1.0
"""Size of a cell, which limits the detail of the surface. The noise of tens of points averages
out in a cell, and a car fills several cells."""
SPARSE_M2 = 3.0
"""Density in points per square metre below which cells are wider: in most cells of 1 m no two
points would agree."""
SPARSE_CELL_M = 2.0
"""Size of the cells of clouds below that density."""
MODE_SIGMAS = 4.0
"""Height of the window that moves up from a cell's lowest point, in standard deviations of the
noise."""
STEEPEST = 2.0
"""Steepest slope between neighbouring cells that is subtracted before heights are compared."""
STEEPEST_AT_GAPS = 0.7
"""Steepest slope that is subtracted if one neighbour has no height, as at the edge of a wood:
the slope to the other neighbour may be that of a wall."""
UNKNOWN = 2**40
"""Rise that stands for an unknown one; no real rise is as large."""
MODE_SHARE, MODE_POINTS = 0.1, 2
"""Share and number of a cell's points that a window needs. The lowest such window is the
surface of the cell, as single blunders are fewer."""
FEW = 128
"""Largest number of points in a cell that are sorted by counting."""


@kernel
def by_cell(keys: Int64, n_cells: int) -> tuple[Int64, Int32]:
    """Sort points by cell (counting sort).

    Returns ``starts`` and ``order``: the points of cell ``k`` are ``order[starts[k]:starts[k +
    1]]``.
    """
    starts = np.zeros(n_cells + 1, np.int64)
    for key in keys:
        starts[key + 1] += 1
    for k in range(n_cells):
        starts[k + 1] += starts[k]
    filled = starts[:-1].copy()
    order = np.empty(keys.size, np.int32)
    for i in range(keys.size):
        order[filled[keys[i]]] = i
        filled[keys[i]] += 1
    return starts, order


@kernel
def _lowest_mode(values: Int32, width: int, share: float, least: int) -> tuple[int, int]:
    """Return the median and the number of values of the lowest window with enough of the sorted values.

    The number is 0 if there is no such window.
    """
    n = values.size
    need, last = max(math.ceil(share * n), least), 0
    for first in range(n - need + 1):
        while last < n and values[last] - values[first] <= width:
            last += 1
        if last - first >= need:
            return (
                values[(first + last - 1) // 2] + values[(first + last) // 2]
            ) // 2, last - first
    return 0, 0


@kernel
def _sort(values: Int32, room: Int32) -> None:
    """Sort a few values in place, each by the number of smaller values.

    This needs no branches, so it is faster than a sort that swaps pairs. More than `FEW` values
    are sorted by numpy.
    """
    n = values.size
    if n > FEW:
        values.sort()
        return
    for i in range(n):
        value, rank = values[i], np.int32(0)
        for k in range(i):
            rank += np.int32(values[k] <= value)
        for k in range(i + 1, n):
            rank += np.int32(values[k] < value)
        room[rank] = value
    for i in range(n):
        values[i] = room[i]


@kernel
def _level_heights(z: Int32, starts: Int64, order: Int32, window: Int64) -> tuple[Int64, Int64]:
    """Return the height of each cell and the number of points in its window, which is 0 if the cell has no height."""
    heights, counts = np.zeros(starts.size - 1, np.int64), np.zeros(starts.size - 1, np.int64)
    buffer, room = np.empty(np.diff(starts).max(), np.int32), np.empty(FEW, np.int32)
    for k in range(starts.size - 1):
        begin, n = starts[k], starts[k + 1] - starts[k]
        if n > 0:
            values = buffer[:n]
            for i in range(n):
                values[i] = z[order[begin + i]]
            _sort(values, room)
            heights[k], counts[k] = _lowest_mode(values, window[k], MODE_SHARE, MODE_POINTS)
    return heights, counts


class _ByCell(NamedTuple):
    """Points sorted by the cells of a raster, which are numbered row by row (`by_cell`)."""

    x: Int32
    y: Int32
    z: Int32
    starts: Int64
    order: Int32


@kernel
def _rise(level: Int64, counts: Int64, k: int, step: int, cell_counts_z: float) -> int:
    """Return the rise over two cells along an axis, or `UNKNOWN` if it is too steep or no neighbour has a height.

    If only one neighbour has a height, the rise to it counts twice. ``cell_counts_z`` is the
    size of a cell in vertical counts.
    """
    before, after = counts[k - step] > 0, counts[k + step] > 0
    if before and after:
        rise, steepest = level[k + step] - level[k - step], STEEPEST
    elif after:
        rise, steepest = 2 * (level[k + step] - level[k]), STEEPEST_AT_GAPS
    elif before:
        rise, steepest = 2 * (level[k] - level[k - step]), STEEPEST_AT_GAPS
    else:
        return UNKNOWN
    return rise if abs(rise) <= round(2 * steepest * cell_counts_z) else UNKNOWN


@kernel
def _tilted_heights(
    points: _ByCell,
    centre_x: Int64,
    centre_y: Int64,
    window: Int64,
    cell_counts_z: float,
    level: Int64,
    counts: Int64,
) -> Int64:
    """Return the heights of cells, with the slope of their neighbours subtracted if more points agree then."""
    x, y, z, starts, order = points
    heights, columns = level.copy(), centre_x.size
    buffer, room = np.empty(np.diff(starts).max(), np.int32), np.empty(FEW, np.int32)
    for k in range(columns + 1, starts.size - 1 - columns - 1):
        begin, n = starts[k], starts[k + 1] - starts[k]
        if counts[k] == 0 or counts[k] == n:
            continue
        eastward = _rise(level, counts, k, 1, cell_counts_z)
        northward = _rise(level, counts, k, columns, cell_counts_z)
        if eastward == UNKNOWN or northward == UNKNOWN:
            continue
        cx, cy = centre_x[k % columns], centre_y[k // columns]
        span_x = float(centre_x[k % columns + 1] - centre_x[k % columns - 1])
        span_y = float(centre_y[k // columns + 1] - centre_y[k // columns - 1])
        values = buffer[:n]
        # Whole numbers are divided as floats, which is faster, and exact below 2**52.
        for i in range(n):
            j = order[begin + i]
            rise = math.floor(eastward * (x[j] - cx) / span_x) + math.floor(
                northward * (y[j] - cy) / span_y
            )
            values[i] = z[j] - rise
        _sort(values, room)
        height, agree = _lowest_mode(values, window[k], MODE_SHARE, MODE_POINTS)
        if agree > counts[k]:
            heights[k] = height
    return heights


def cell_size_m(density_m2: float) -> float:
    """Return the size of the cells in metres for a density in points per square metre."""
    return SPARSE_CELL_M if density_m2 < SPARSE_M2 else CELL_M


def cell_heights(
    xyz: Int32, bounds: Window, scale: Scale, sigma_m: float | Field, cell_m: float = CELL_M
) -> Int32:
    """Return the surface of each cell whose centre lies within bounds, as a point at its centre.

    Parameters
    ----------
    xyz : int32 [3, n]
        Local counts of all points within two cells of the bounds, in any order.
    bounds : Window
    scale : Scale
    sigma_m : float or Field
        Noise of the place in metres.
    cell_m : float
        Size of the cells in metres.

    Returns
    -------
    int32 [3, m]
        Local counts of the points, by rows of cells.
    """
    cells = CellLattice.of(cell_m, scale)
    x, y, z = (np.ascontiguousarray(c) for c in xyz)
    if x.size == 0:
        return np.zeros((3, 0), np.int32)
    col0, row0, columns, rows = cells.extent(x, y, 1)
    keys = cell_keys(x, y, cells, col0, row0, columns)
    starts, order = by_cell(keys, columns * rows)
    noise = on_cells(sigma_m, cells, row0, col0, (rows, columns)).ravel()
    window = np.maximum(np.rint(scale.counts_z(1.0) * (MODE_SIGMAS * noise)), 1.0).astype(
        np.int64
    )
    level, counts = _level_heights(z, starts, order, window)
    centre_x = np.array(
        [(cells.west(col0 + i) + cells.west(col0 + i + 1)) // 2 for i in range(columns)],
        np.int64,
    )
    centre_y = np.array(
        [(cells.south(row0 + i) + cells.south(row0 + i + 1)) // 2 for i in range(rows)],
        np.int64,
    )
    points = _ByCell(x, y, z, starts, order)
    heights = _tilted_heights(
        points, centre_x, centre_y, window, scale.counts_z(cell_m), level, counts
    )
    filled_cells = np.flatnonzero(counts)
    cx, cy = centre_x[filled_cells % columns], centre_y[filled_cells // columns]
    is_within_bounds = (
        (cx >= bounds.west) & (cx < bounds.east) & (cy >= bounds.south) & (cy < bounds.north)
    )
    return np.stack(
        [cx[is_within_bounds], cy[is_within_bounds], heights[filled_cells[is_within_bounds]]]
    ).astype(np.int32)


@dataclass(frozen=True)
class CellHeights:
    """The cells of a window as a raster, with a margin of empty cells on all sides.

    Attributes
    ----------
    heights : int32 [rows, columns]
        Heights in vertical counts, southern row first; `EMPTY` where there is no cell.
    keys : int64 [n]
        Index of each cell in the flattened raster.
    column, row : int
        Column and row of the first cell of the raster on the lattice.
    """

    heights: Int32
    keys: Int64
    column: int
    row: int

    def spread(self, values: AnyArray, otherwise: float = 0) -> AnyArray:
        """Return the values of the cells as a raster, with another value where there is no cell."""
        raster = np.full(self.heights.shape, otherwise, values.dtype)
        raster.reshape(-1)[self.keys] = values
        return raster

    def at_cells(self, raster: AnyArray) -> AnyArray:
        """Return the values of a raster at the cells."""
        return raster.reshape(-1)[self.keys]

    def noise(self, noise_m: Field, cells: CellLattice) -> Float64:
        """Return the noise at all cells of the raster: float64 [rows, columns]."""
        return on_cells(noise_m, cells, self.row, self.column, self.heights.shape)


EMPTY = 2**31 - 1
"""Height of a cell without a surface."""
ALIGN = 8
"""Multiple of cells of the lattice at which rasters begin, so that all rasters have the same
blocks of cells."""
MARGIN = 4
"""Minimum number of empty cells on each side of a raster. Kernels that read neighbours of cells
stay inside it, and every raster ends in empty cells."""


def raster_of(xyz: Int32, cells: CellLattice) -> CellHeights:
    """Return the raster of elected cells, given as int32 [3, n] local counts of at least one cell."""
    x, y, z = (np.ascontiguousarray(c) for c in xyz)
    column, row = (
        (first - MARGIN) // ALIGN * ALIGN
        for first in (cells.column(int(x.min())), cells.row(int(y.min())))
    )
    width, height = (
        cells.column(int(x.max())) - column + 1 + MARGIN,
        cells.row(int(y.max())) - row + 1 + MARGIN,
    )
    keys = cell_keys(x, y, cells, column, row, width)
    heights = np.full(height * width, EMPTY, np.int32)
    heights[keys] = z
    return CellHeights(heights.reshape(height, width), keys, column, row)
