"""Grey-scale openings with disks on minimum rasters, in which any cell may be empty.

An empty cell has no height: it neither lowers nor raises its neighbours. All results are integers, or come from
integers by the same few operations in each cell, and a cell's result depends on its surroundings alone, not on where
the raster starts or ends: rasters of one lattice agree wherever both hold all data within reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, cell_keys
from ptd.frame import CellLattice
from ptd.kernel import kernel

EMPTY = 2**31 - 1
"""Height of a cell without points."""

OVERHANG = 1
"""Disks are centred on filled cells and so many cells around them. Without holes between sparse points the disks would
be fewer (fine ridges would be cut); anywhere outside the data they would reach in just far enough to spare a
roof at the border."""

Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


class CellRaster:
    """The cells of a lattice around points.

    Parameters
    ----------
    x, y : int32 [n]
        Local counts; at least one point.
    cells : CellLattice

    Attributes
    ----------
    shape : (int, int)
        Rows, the southern one first, and columns.
    keys : int64 [n]
        The cell of each point in a raster taken row by row.
    """

    def __init__(self, x: Int32, y: Int32, cells: CellLattice) -> None:
        col0, row0 = cells.column(int(x.min())), cells.row(int(y.min()))
        width = cells.column(int(x.max())) - col0 + 1
        self.shape = (cells.row(int(y.max())) - row0 + 1, width)
        self.keys = cell_keys(x, y, cells.p, cells.q, cells.origin_x, cells.origin_y, col0, row0, width)

    def lowest(self, z: Int32, which: Bool) -> Int32:
        """Height of the lowest of the chosen points in each cell, `EMPTY` where there is none: int32, of `shape`."""
        heights = np.full(self.shape[0] * self.shape[1], EMPTY, np.int32)
        _lower_cells(heights, self.keys, z, which)
        return heights.reshape(self.shape)


@kernel
def _lower_cells(heights: Int32, keys: Int64, z: Int32, which: Bool) -> None:
    for i in range(keys.size):
        if which[i]:
            heights[keys[i]] = min(heights[keys[i]], z[i])


@kernel
def _fill_runs(runs: Int32, row: Int32, radius: int) -> tuple[int, int]:
    """``runs[k, i]``: the minimum of the 2**k cells from i on of a row with `radius` empty cells at both ends.

    Returns the first filled column and the one behind the last; (width, 0) for an empty row.
    """
    width = row.size
    start, end = 0, width
    while start < width and row[start] == EMPTY:
        start += 1
    while end > start and row[end - 1] == EMPTY:
        end -= 1
    runs[:, :] = EMPTY
    if start == width:
        return width, 0
    for i in range(start, end):
        runs[0, radius + i] = row[i]
    for k in range(1, runs.shape[0]):
        half = 1 << (k - 1)
        n = runs.shape[1] - half
        first, second, out = runs[k - 1, :n], runs[k - 1, half:], runs[k, :n]
        for i in range(n):
            out[i] = min(first[i], second[i])
    return start, end


@kernel
def _disk_minimum(heights: Int32, half_widths: Int64, levels: Int64, out: Int32) -> None:
    """Each chord of the disk is covered by two runs of 2**level cells (Urbach and Wilkinson 2008).

    The first chord is the widest. Runs of the rows that the disk touches go round in a buffer that stays in the cache.
    Sparse points leave most rows empty, and the others filled over a few columns: the rest is not looked at.
    """
    height, width = heights.shape
    radius = half_widths.size - 1
    span = 2 * radius + 1
    buffer = np.full((span, levels[0] + 1, width + 2 * radius), EMPTY, np.int32)
    first, end = np.full(span, width), np.zeros(span, np.int64)  # filled columns of the rows in the buffer
    for row in range(-radius, height):
        slot = (row + radius) % span
        first[slot], end[slot] = width, 0
        if row + radius < height:
            first[slot], end[slot] = _fill_runs(buffer[slot], heights[row + radius], radius)
        else:
            buffer[slot] = EMPTY
        if row < 0:
            continue
        lowest = out[row]
        lowest[:] = EMPTY
        for dy in range(radius + 1):
            south, north, half, k = (row - dy) % span, (row + dy) % span, half_widths[dy], levels[dy]
            start = max(min(first[south], first[north]) - half, 0)
            n = min(max(end[south], end[north]) + half, width) - start
            if n <= 0:
                continue
            left, right = radius - half + start, radius + half + 1 - (1 << k) + start
            a, b = buffer[south, k, left : left + n], buffer[south, k, right : right + n]
            c, d = buffer[north, k, left : left + n], buffer[north, k, right : right + n]
            cells = lowest[start : start + n]
            for i in range(n):
                cells[i] = min(cells[i], min(min(a[i], b[i]), min(c[i], d[i])))


def disk_minimum(heights: Int32, radius: float) -> Int32:
    """The lowest of the filled cells whose centres lie within `radius` cells, everywhere.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Counts, above -2**31; `EMPTY` where there is none.
    radius : float
        Cells, not negative.

    Returns
    -------
    int32 [rows, columns]
        `EMPTY` where no cell of the disk is filled.
    """
    limit = math.floor(radius * radius)
    half_widths = [math.isqrt(limit - dy * dy) for dy in range(math.isqrt(limit) + 1)]
    levels = [(2 * w + 1).bit_length() - 1 for w in half_widths]
    out = np.empty(heights.shape, np.int32)
    _disk_minimum(
        np.ascontiguousarray(heights), np.array(half_widths, np.int64), np.array(levels, np.int64), out
    )
    return out


@kernel
def _flip(heights: Int32, keep: Bool) -> None:
    """Negate in place, so that minima become maxima; cells not to keep become empty."""
    flat, kept = heights.reshape(-1), keep.reshape(-1)
    for i in range(flat.size):
        flat[i] = -flat[i] if kept[i] else EMPTY


_INNER = np.s_[OVERHANG:-OVERHANG, OVERHANG:-OVERHANG]


def _framed(heights: Int32) -> tuple[Int32, Bool, Bool]:
    """The raster with room for disks centred outside it; which of its cells are filled; where disks are centred."""
    framed = np.ascontiguousarray(np.pad(heights, OVERHANG, constant_values=EMPTY))
    return framed, framed != EMPTY, disk_minimum(framed, OVERHANG) != EMPTY


def _open(heights: Int32, radius: float, filled: Bool, centres: Bool) -> Int32:
    """Opening: each filled cell takes the highest of the minima of the disks that hold it.

    So whatever is higher than its surroundings and narrower than a disk is cut.
    """
    lowest = disk_minimum(heights, radius)
    _flip(lowest, centres)
    opened = disk_minimum(lowest, radius)
    _flip(opened, filled)
    return opened


@kernel
def _keep_steepest(before: Int32, after: Int32, allowance: float, radius: float, steepest: Float32) -> None:
    b, a, s = before.reshape(-1), after.reshape(-1), steepest.reshape(-1)
    for i in range(b.size):
        s[i] = max(s[i], np.float32((float(b[i]) - float(a[i]) - allowance) / radius))


def steepest_drops(heights: Int32, radii: Sequence[float], allowance: float) -> tuple[Float32, Int32]:
    """Open with ever larger disks and watch how far each cell drops from one opening to the next.

    Each opens the raster as it is, not what the last one left: so a cell's result depends on nothing farther than twice
    the last radius, and discrete disks, which are no unions of smaller ones, cannot creep up a slope. A cell drops by
    more than ``allowance + s * radius`` with some disk if its steepest drop is above s: thresholds that grow with the
    disk can be chosen, and differ from cell to cell, after the openings.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Counts, above -2**31; `EMPTY` where there is none.
    radii : sequence of float
        Cells, above 0, growing.
    allowance : float
        Counts by which a cell may drop with any disk.

    Returns
    -------
    steepest : float32 [rows, columns]
        The largest of (drop - allowance) / radius, counts per cell; meaningless in empty cells.
    opened : int32 [rows, columns]
        After the last opening.
    """
    framed, filled, centres = _framed(heights)
    steepest, opened = np.full(framed.shape, -np.inf, np.float32), framed
    for radius in radii:
        before, opened = opened, _open(framed, radius, filled, centres)
        _keep_steepest(before, opened, float(allowance), float(radius), steepest)
    return steepest[_INNER], opened[_INNER]
