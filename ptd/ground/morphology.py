"""Grey-scale openings with disks on minimum rasters, in which any cell may be empty.

An empty cell has no height, so it neither lowers nor raises its neighbours. All results are
integers, or follow from integers by the same few operations in each cell. The result of a cell
depends only on its surroundings, not on where the raster starts or ends. So rasters of one
lattice agree wherever both contain all data within the search distance.
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
"""Largest distance in cells between the centre of a disk and a filled cell. With disks centred
only on filled cells, too few disks would lie between sparse points, and openings would cut fine
ridges. With disks centred anywhere outside the data, a disk could reach just onto a roof at the
border, and the opening would keep the roof."""

Bool = npt.NDArray[np.bool_]
Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


class CellRaster:
    """The cells of a lattice around points.

    Parameters
    ----------
    x, y : int32 [n]
        Local counts of at least one point.
    cells : CellLattice

    Attributes
    ----------
    shape : (int, int)
        Number of rows, the southern one first, and of columns.
    keys : int64 [n]
        Index of each point's cell in the flattened raster.
    """

    def __init__(self, x: Int32, y: Int32, cells: CellLattice) -> None:
        col0, row0 = cells.column(int(x.min())), cells.row(int(y.min()))
        width = cells.column(int(x.max())) - col0 + 1
        self.shape = (cells.row(int(y.max())) - row0 + 1, width)
        self.keys = cell_keys(x, y, cells, col0, row0, width)

    def lowest(self, z: Int32, which: Bool) -> Int32:
        """Return the height of the lowest chosen point in each cell, or `EMPTY` if there is none: int32, of `shape`."""
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
    """Compute the minima of runs of cells in a row with `radius` empty cells at both ends.

    ``runs[k, i]`` gets the minimum of the 2**k cells from i on. Returns the first filled column and the one after the
    last, or (width, 0) for an empty row.
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
    """Compute the minimum over a disk around each cell from runs of 2**level cells (Urbach and Wilkinson 2008).

    Two runs cover each chord of the disk. The first chord is the widest. The runs of the rows
    that the disk touches are kept in a ring buffer that stays in the cache. With sparse points
    most rows are empty, and others are filled over a few columns, so all other cells are
    skipped.
    """
    height, width = heights.shape
    radius = half_widths.size - 1
    span = 2 * radius + 1
    buffer = np.full((span, levels[0] + 1, width + 2 * radius), EMPTY, np.int32)
    # filled columns of the rows in the buffer
    first, end = np.full(span, width), np.zeros(span, np.int64)
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
            south, north, half, k = (
                (row - dy) % span,
                (row + dy) % span,
                half_widths[dy],
                levels[dy],
            )
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
    """Return the lowest height of the filled cells whose centres lie within `radius` cells of each cell.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights in counts, above -2**31; `EMPTY` where there is none.
    radius : float
        Radius of the disk in cells, not negative.

    Returns
    -------
    int32 [rows, columns]
        Lowest heights in counts; `EMPTY` where no cell of the disk is filled.
    """
    limit = math.floor(radius * radius)
    half_widths = [math.isqrt(limit - dy * dy) for dy in range(math.isqrt(limit) + 1)]
    levels = [(2 * w + 1).bit_length() - 1 for w in half_widths]
    out = np.empty(heights.shape, np.int32)
    _disk_minimum(
        np.ascontiguousarray(heights),
        np.array(half_widths, np.int64),
        np.array(levels, np.int64),
        out,
    )
    return out


@kernel
def _flip(heights: Int32, keep: Bool) -> None:
    """Negate heights in place, so that minima become maxima, and empty the cells that are not in ``keep``."""
    flat, kept = heights.reshape(-1), keep.reshape(-1)
    for i in range(flat.size):
        flat[i] = -flat[i] if kept[i] else EMPTY


_INNER = np.s_[OVERHANG:-OVERHANG, OVERHANG:-OVERHANG]


def _framed(heights: Int32) -> tuple[Int32, Bool, Bool]:
    """Return the raster with a frame for disks centred outside it, its filled cells, and the centres of disks."""
    framed = np.ascontiguousarray(np.pad(heights, OVERHANG, constant_values=EMPTY))
    return framed, framed != EMPTY, disk_minimum(framed, OVERHANG) != EMPTY


def _open(heights: Int32, radius: float, filled: Bool, centres: Bool) -> Int32:
    """Open a raster: each filled cell gets the highest of the minima of the disks that contain it.

    So every feature that is higher than its surroundings and narrower than a disk is cut.
    """
    lowest = disk_minimum(heights, radius)
    _flip(lowest, centres)
    opened = disk_minimum(lowest, radius)
    _flip(opened, filled)
    return opened


@kernel
def _keep_steepest(
    before: Int32, after: Int32, allowance: float, radius: float, steepest: Float32
) -> None:
    b, a, s = before.reshape(-1), after.reshape(-1), steepest.reshape(-1)
    for i in range(b.size):
        s[i] = max(s[i], np.float32((float(b[i]) - float(a[i]) - allowance) / radius))


def steepest_drops(
    heights: Int32, radii: Sequence[float], allowance: float
) -> tuple[Float32, Int32]:
    """Open a raster with larger and larger disks and find the steepest drop of each cell from one opening to the next.

    Each disk opens the original raster, not the last opening. So heights farther than twice the
    last radius do not change a cell's result. Discrete disks are not unions of smaller ones, so
    repeated openings of the result would erode a slope step by step.

    A cell drops by more than ``allowance + s * radius`` with some disk if its steepest drop is
    above s. So thresholds that grow with the disk can be chosen after the openings, and can
    differ from cell to cell.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights in counts, above -2**31; `EMPTY` where there is none.
    radii : sequence of float
        Radii of the disks in cells, above 0 and growing.
    allowance : float
        Drop in counts that is allowed with any disk.

    Returns
    -------
    steepest : float32 [rows, columns]
        Largest (drop - allowance) / radius in counts per cell; meaningless in empty cells.
    opened : int32 [rows, columns]
        Heights after the last opening.
    """
    framed, filled, centres = _framed(heights)
    steepest, opened = np.full(framed.shape, -np.inf, np.float32), framed
    for radius in radii:
        previous, opened = opened, _open(framed, radius, filled, centres)
        _keep_steepest(previous, opened, float(allowance), float(radius), steepest)
    return steepest[_INNER], opened[_INNER]
