"""Rasters of lowest heights with empty cells: openings with disks, connected surfaces, division into blocks.

An empty cell has no height, so it neither lowers nor raises its neighbours. All results are
integers, or follow from integers by the same few operations in each cell. The result of a cell
depends only on its surroundings, not on where the raster starts or ends. So rasters of one
lattice agree wherever both contain all data within the search distance. Blocks keep rasters
from growing with the extent of a window.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ptd.arrays import Bool, Float32, Float64, Int32, Int64
from ptd.cells import cell_keys
from ptd.frame import CellLattice
from ptd.kernel import kernel

EMPTY = 2**31 - 1
"""Height of a cell without points."""

OVERHANG = 1
"""Largest distance in cells between the centre of a disk and a filled cell. With disks centred
only on filled cells, too few disks would lie between sparse points, and openings would cut fine
ridges. With disks centred anywhere outside the data, a disk could reach just onto a roof at the
border, and the opening would keep the roof."""


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
        col0, row0, width, height = cells.extent(x, y)
        self.shape = (height, width)
        self.keys = cell_keys(x, y, cells, col0, row0, width)

    def lowest(self, z: Int32, which: Bool) -> Int32:
        """Return the height of the lowest chosen point in each cell, or `EMPTY` if there is none: int32, of `shape`."""
        heights = np.full(self.shape[0] * self.shape[1], EMPTY, np.int32)
        _lower_cells(heights, self.keys, z, which)
        return heights.reshape(self.shape)

    def occupied(self, which: Bool | slice = np.s_[:]) -> Bool:
        """Return a mask of the cells with chosen points, by default with any points: bool, of `shape`."""
        occupied = np.zeros(self.shape, np.bool_)
        occupied.reshape(-1)[self.keys[which]] = True
        return occupied


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


BLOCK_CELLS = 2048
"""Side of a block in cells, without the margin around it."""


def blocks(
    x: Int32, y: Int32, cells: CellLattice, reach: int, size: int | None = None
) -> Iterator[tuple[Int64, Bool]]:
    """Divide points into square blocks of cells, each with all points within ``reach`` cells of the block.

    No raster is larger than a block with its margin, however far apart the points are. A result
    that depends only on points within the margin is the same for any blocks.

    Parameters
    ----------
    x, y : int32 [n]
        Local counts, by rows of cells (as `ptd.cells.lowest_per_cell` gives them).
    cells : CellLattice
    reach : int
        Margin around a block in cells.
    size : int, optional
        Number of cells along a side of a block; `BLOCK_CELLS` by default.

    Yields
    ------
    index : int64 [m]
        Indices of the points of a block and its margin.
    inner : bool [m]
        Mask of the points that belong to the block. Each point belongs to one block.
    """
    if x.size == 0:
        return
    size = BLOCK_CELLS if size is None else size
    columns, rows = cells.cell_indices(x, y)
    columns -= columns.min()
    rows -= rows[0]
    if columns.max() < size + 2 * reach and rows[-1] < size + 2 * reach:
        yield np.arange(x.size), np.ones(x.size, np.bool_)
        return
    for south in range(0, int(rows[-1]) + 1, size):
        first, last = np.searchsorted(rows, (south - reach, south + size + reach))
        band, own_rows = columns[first:last], rows[first:last] // size == south // size
        for west in np.unique(band[own_rows] // size) * size:
            index = np.flatnonzero((band >= west - reach) & (band < west + size + reach))
            yield index + first, own_rows[index] & (band[index] // size == west // size)
