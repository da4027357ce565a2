"""Cells of 0.4 m with points near a TIN, and planes through the lowest ones: the surface of `ptd.ground.fine_surface`.

Cells are stored by blocks of 5 x 5 cells, only for blocks with points to decide and their
neighbours. So memory grows with the points, not with the area. A point is stored as its index,
the number of its block and the number of its cell in the block (13 bytes), not as its position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Float32, Float64, Int32, Int64, UInt8
from ptd.cells import Xyz, occupied, quotient
from ptd.frame import CellLattice, Scale
from ptd.ground.labelling import FAR, NEAR
from ptd.ground.morphology import EMPTY
from ptd.kernel import as_int64, inlined, kernel

CELL_M = 0.4
"""Size of the fine cells."""
BLOCK_SIZE = 5
"""Number of cells along a side of a block."""
CELLS = BLOCK_SIZE * BLOCK_SIZE


class LocatedPoints(NamedTuple):
    """Points that are near a TIN or uncertified, with their blocks and cells.

    Attributes
    ----------
    point : int32 [m]
        Index among all points.
    block : int64 [m]
        Number of the point's block among the occupied ones.
    cell : uint8 [m]
        Number of the point's cell in its block, row by row.
    """

    point: Int32
    block: Int64
    cell: UInt8


class Blocks(NamedTuple):
    """Blocks with located points, by rows.

    Attributes
    ----------
    around : int32 [n, 9]
        Numbers of the 3 x 3 blocks around each block, with the block itself, row by row; -1 for those not occupied.
    points, near : int32 [n]
        Number of points in the block, and number of those that are `NEAR` or `ON`.
    settled, has_uncertified : bool [n]
        Whether no point has the closeness `NEAR`, so that nothing is left to decide, and whether any point is
        uncertified.
    """

    around: Int32
    points: Int32
    near: Int32
    settled: Bool
    has_uncertified: Bool


def located_points(
    points: Xyz, close: UInt8, uncertified: Bool, scale: Scale
) -> tuple[LocatedPoints, Blocks]:
    """Find the blocks and cells of all points that are uncertified or not `FAR`.

    Parameters
    ----------
    points : Xyz
    close : uint8 [n]
        Closeness of each point to the TIN (`ptd.ground.labelling.Closeness`).
    uncertified : bool [n]
        Mask of the uncertified points.
    scale : Scale
    """
    index = _chosen(close, uncertified)
    if index.size == 0:
        none = np.zeros(0, np.int32)
        nothing = np.zeros(0, np.bool_)
        where = LocatedPoints(index, none.astype(np.int64), none.astype(np.uint8))
        return where, Blocks(np.zeros((0, 9), np.int32), none, none, nothing, nothing)
    lattice = CellLattice.of(CELL_M, scale)
    keys, cell, width, height = _keys(
        points, index, lattice.p, lattice.q, lattice.origin_x, lattice.origin_y
    )
    blocks, block = occupied(keys, width * height)
    where = LocatedPoints(index, block, cell)
    around = neighbours_of_blocks(blocks, width)
    return where, Blocks(around, *_counted(where, close, uncertified, blocks.size))


@kernel
def _chosen(close: UInt8, uncertified: Bool) -> Int32:
    index, n = np.empty(close.size, np.int32), 0
    for i in range(close.size):
        index[n] = i
        n += (close[i] != FAR) | uncertified[i]
    return index[:n].copy()


@kernel
def _keys(
    points: Xyz, index: Int32, p: int, q: int, ox: int, oy: int
) -> tuple[Int64, UInt8, int, int]:
    """Return the key of each point's block, its cell, and the width and height of the raster of blocks.

    The raster has an empty column on both sides.
    """
    x, y, _ = points
    west = east = as_int64(x[index[0]])
    south = north = as_int64(y[index[0]])
    for i in index:
        west, east = min(west, as_int64(x[i])), max(east, as_int64(x[i]))
        south, north = min(south, as_int64(y[i])), max(north, as_int64(y[i]))
    inverse = 1.0 / p
    column = quotient((west + ox) * q, p, inverse) // BLOCK_SIZE - 1
    row = quotient((south + oy) * q, p, inverse) // BLOCK_SIZE
    width = quotient((east + ox) * q, p, inverse) // BLOCK_SIZE - column + 2
    height = quotient((north + oy) * q, p, inverse) // BLOCK_SIZE - row + 1
    keys, cell = np.empty(index.size, np.int64), np.empty(index.size, np.uint8)
    for k in range(index.size):
        i = index[k]
        across = quotient((as_int64(x[i]) + ox) * q, p, inverse) - column * BLOCK_SIZE
        up = quotient((as_int64(y[i]) + oy) * q, p, inverse) - row * BLOCK_SIZE
        keys[k] = up // BLOCK_SIZE * width + across // BLOCK_SIZE
        cell[k] = up % BLOCK_SIZE * BLOCK_SIZE + across % BLOCK_SIZE
    return keys, cell, width, height


@kernel
def neighbours_of_blocks(keys: Int64, width: int) -> Int32:
    """Return the indices of the 3 x 3 blocks around each block, row by row: int32 [m, 9].

    The index is -1 for blocks that are not occupied. ``keys`` are sorted. Rasters have an empty
    column on both sides, so the last block of a row and the first of the next never have
    adjacent keys.
    """
    neighbours = np.full((keys.size, 9), -1, np.int32)
    for row in range(3):
        j = 0
        for k in range(keys.size):
            first = keys[k] + (row - 1) * width - 1
            while j < keys.size and keys[j] < first:
                j += 1
            i = j
            while i < keys.size and keys[i] <= first + 2:
                neighbours[k, 3 * row + keys[i] - first] = i
                i += 1
    return neighbours


@kernel
def _counted(
    where: LocatedPoints, close: UInt8, uncertified: Bool, n_blocks: int
) -> tuple[Int32, Int32, Bool, Bool]:
    """Return the fields ``points``, ``near``, ``settled`` and ``has_uncertified`` of `Blocks`."""
    index, block, _ = where
    points, near = np.zeros(n_blocks, np.int32), np.zeros(n_blocks, np.int32)
    settled, has_uncertified = np.ones(n_blocks, np.bool_), np.zeros(n_blocks, np.bool_)
    for k in range(index.size):
        b, how = block[k], close[index[k]]
        points[b] += 1
        near[b] += how >= NEAR
        settled[b] &= how != NEAR
        has_uncertified[b] |= uncertified[index[k]]
    return points, near, settled, has_uncertified


@kernel
def pages_of_blocks(wanted: Bool, neighbours: Int32) -> tuple[Int32, int]:
    """Assign page numbers to the chosen blocks and their neighbours.

    Returns each block's page (its index in `ptd.ground.fine_planes.Planes`) or -1, int32 [m],
    and the number of pages.
    """
    pages, n = np.full(wanted.size, -1, np.int32), 0
    for k in range(wanted.size):
        for i in neighbours[k]:
            if i >= 0 and wanted[i]:
                pages[k] = n
                n += 1
                break
    return pages, n


FILLED = 9
"""A block is dense if at least this many of its 25 cells have a point near the TIN: about 3
points/m2."""
ENOUGH, ENOUGH_WIDE = 6, 9
"""A plane of 3 x 3 cells needs at least the first number of them. If there are fewer, 5 x 5
cells need the second."""
AROUND = 2
"""Number of cells that the wider planes extend to each side. At most `BLOCK_SIZE`, so the
blocks around suffice."""
SPIKE_M = 0.07
"""A cell more than this high above its plane, in metres, is left out of the planes around
it."""
ROUGH_M = 0.1
"""If cells scatter by more than this about their plane, in metres, the TIN decides, as at a
step or a wall."""
THIN = 0.05
"""Cells lie on a line, so that there is no plane, if the determinant is at most this share of
its largest possible value."""


class PlaneLimits(NamedTuple):
    """`SPIKE_M` and `ROUGH_M` in vertical counts."""

    spike: float
    rough: float


class Planes(NamedTuple):
    """The fine surface by cells. The cells of a page (a stored block) follow each other, row by row.

    Attributes
    ----------
    x, y, z : int32 [pages * 25]
        Local counts of the point that represents each cell; z is `EMPTY` if there is none.
    east, north, height : float32 [pages * 25]
        Rise of the plane to the east and to the north in vertical counts per horizontal count, and its height above the
        point in vertical counts. `height` is NaN if there is no plane.
    """

    x: Int32
    y: Int32
    z: Int32
    east: Float32
    north: Float32
    height: Float32

    @classmethod
    def none(cls, n_pages: int) -> Planes:
        """Return cells without points and planes."""
        n = n_pages * CELLS
        east, north, height = (np.full(n, np.nan, np.float32) for _ in range(3))
        x, y = np.zeros((2, n), np.int32)
        return cls(x, y, np.full(n, EMPTY, np.int32), east, north, height)


@kernel
def elect(
    points: Xyz, where: LocatedPoints, close: UInt8, pages: Int32, planes: Planes
) -> None:
    """Choose the lowest point near the TIN to represent each cell of a block with a page.

    Of equally low points the first in (x, y) is chosen.
    """
    x, y, z = points
    cell_x, cell_y, cell_z = planes.x, planes.y, planes.z
    index, block, cell = where
    for k in range(index.size):
        i, page = index[k], pages[block[k]]
        if page < 0 or close[i] < NEAR:
            continue
        plane_index = page * CELLS + cell[k]
        lower = z[i] < cell_z[plane_index]
        if z[i] == cell_z[plane_index]:
            lower = (x[i], y[i]) < (cell_x[plane_index], cell_y[plane_index])
        if lower:
            cell_x[plane_index], cell_y[plane_index], cell_z[plane_index] = x[i], y[i], z[i]


PATCH = BLOCK_SIZE + 2 * AROUND
"""Number of cells along a side of a patch: a block and the cells around it that its planes
read."""
MOMENTS = 10
"""Number of moments of a cell: n, x, y, z, xx, xy, yy, xz, yz, zz."""
PATCH_ROW, BLOCK_ROW = PATCH * MOMENTS, BLOCK_SIZE * MOMENTS
"""Number of moments in a row of cells of a patch and of a block."""


class _Sums(NamedTuple):
    """Moments of cells in flat arrays, row by row, so that sums of rows are loops over one array.

    All moments and their sums are whole numbers, so they are exact, and neither order nor frame
    changes them.

    Attributes
    ----------
    patch : float64 [PATCH * PATCH * MOMENTS]
        Moments of each cell of a block and around it.
    three_rows, five_rows : float64 [PATCH * MOMENTS]
        Sums of the moments of 3 and of 5 successive cells of a column.
    three, five : float64 [BLOCK_SIZE * BLOCK_SIZE * MOMENTS]
        Sums of the moments of the 3 x 3 and of the 5 x 5 cells around each cell of the block.
    """

    patch: Float64
    three_rows: Float64
    five_rows: Float64
    three: Float64
    five: Float64


@kernel
def _no_sums() -> _Sums:
    return _Sums(
        np.zeros(PATCH * PATCH_ROW), np.zeros(PATCH_ROW), np.zeros(PATCH_ROW), np.zeros(BLOCK_SIZE * BLOCK_ROW),
        np.zeros(BLOCK_SIZE * BLOCK_ROW),
    )  # fmt: skip


@inlined
def _fill_patch(
    planes: Planes, around: Int32, k: int, pages: Int32, kept: Bool, origin: int, patch: Float64
) -> None:
    """Compute the moments of the points of the cells of block k and around it, relative to the point of ``origin``."""
    x, y, z = planes.x, planes.y, planes.z
    x0, y0, z0 = as_int64(x[origin]), as_int64(y[origin]), as_int64(z[origin])
    for n in range(9):
        south, west = (n // 3 - 1) * BLOCK_SIZE + AROUND, (n % 3 - 1) * BLOCK_SIZE + AROUND
        first_column, end_column = max(-west, 0), min(PATCH - west, BLOCK_SIZE)
        page = as_int64(pages[around[k, n]]) if around[k, n] >= 0 else -1
        for row in range(max(-south, 0), min(PATCH - south, BLOCK_SIZE)):
            m = (south + row) * PATCH_ROW + (west + first_column) * MOMENTS
            if page < 0:
                patch[m : m + (end_column - first_column) * MOMENTS] = 0.0
                continue
            first = page * CELLS + row * BLOCK_SIZE
            for plane_index in range(first + first_column, first + end_column):
                # A product instead of a branch, which the processor could predict wrongly.
                n_points = float(np.int64(kept[plane_index]))
                dx, dy = (
                    n_points * float(x[plane_index] - x0),
                    n_points * float(y[plane_index] - y0),
                )
                dz = n_points * float(z[plane_index] - z0)
                patch[m], patch[m + 1], patch[m + 2], patch[m + 3] = n_points, dx, dy, dz
                patch[m + 4], patch[m + 5], patch[m + 6] = dx * dx, dx * dy, dy * dy
                patch[m + 7], patch[m + 8], patch[m + 9] = dx * dz, dy * dz, dz * dz
                m += MOMENTS


@inlined
def _add_up(sums: _Sums) -> None:
    """Add up the moments around each cell of the block, first along columns and then along rows."""
    patch, three_rows, five_rows, three, five = sums
    for row in range(BLOCK_SIZE):
        south = row * PATCH_ROW
        for i in range(PATCH_ROW):
            s = south + i
            inner = patch[s + PATCH_ROW] + patch[s + 2 * PATCH_ROW] + patch[s + 3 * PATCH_ROW]
            three_rows[i] = inner
            five_rows[i] = inner + patch[s] + patch[s + 4 * PATCH_ROW]
        first = row * BLOCK_ROW
        for i in range(BLOCK_ROW):
            three[first + i] = (
                three_rows[i + MOMENTS]
                + three_rows[i + 2 * MOMENTS]
                + three_rows[i + 3 * MOMENTS]
            )
        for i in range(BLOCK_ROW):
            five[first + i] = (
                five_rows[i] + five_rows[i + MOMENTS] + five_rows[i + 2 * MOMENTS]
                + five_rows[i + 3 * MOMENTS] + five_rows[i + 4 * MOMENTS]
            )  # fmt: skip


@inlined
def _plane(
    s: Float64, m: int, enough: int, x: int, y: int, z: int
) -> tuple[float, float, float, float]:
    """Fit the plane of the cells whose sums begin at m.

    Returns its rise to the east and to the north, its height above (x, y, z), and the scatter
    of the cells about it. The scatter is -1 if the cells are too few or lie on a line.
    """
    n = s[m]
    if n < enough:
        return 0.0, 0.0, 0.0, -1.0
    sx, sy, sz = s[m + 1], s[m + 2], s[m + 3]
    xx, xy, yy = n * s[m + 4] - sx * sx, n * s[m + 5] - sx * sy, n * s[m + 6] - sy * sy
    det = xx * yy - xy * xy
    if det <= THIN * xx * yy:
        return 0.0, 0.0, 0.0, -1.0
    xz, yz, zz = n * s[m + 7] - sx * sz, n * s[m + 8] - sy * sz, n * s[m + 9] - sz * sz
    east, north = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    scatter = math.sqrt(max(zz - east * xz - north * yz, 0.0) / (n * (n - 3.0)))
    height = (sz - n * z - east * (sx - n * x) - north * (sy - n * y)) / n
    return east, north, height, scatter


@inlined
def _fit_block(
    planes: Planes, first: int, sums: _Sums, origin: int, limits: PlaneLimits, kept: Bool
) -> bool:
    """Fit the planes of the cells of a block, remove spikes from ``kept``, and return whether there are any."""
    x, y, z, east, north, height = planes
    x0, y0, z0 = as_int64(x[origin]), as_int64(y[origin]), as_int64(z[origin])
    spikes = False
    for cell in range(CELLS):
        plane_index, m = first + cell, cell * MOMENTS
        if z[plane_index] == EMPTY:
            continue
        dx, dy, dz = x[plane_index] - x0, y[plane_index] - y0, z[plane_index] - z0
        a, b, c, scatter = _plane(sums.three, m, ENOUGH, dx, dy, dz)
        if scatter < 0.0:
            a, b, c, scatter = _plane(sums.five, m, ENOUGH_WIDE, dx, dy, dz)
        if scatter >= 0.0 and -c > limits.spike:
            kept[plane_index], spikes = False, True
        if not 0.0 <= scatter <= limits.rough:
            c = np.nan
        east[plane_index], north[plane_index], height[plane_index] = a, b, c
    return spikes


@kernel
def _touched(
    around: Int32, k: int, first: int, kept: Bool, planes: Planes, touched: Bool
) -> None:
    """Add the blocks whose planes read the spikes of block k to ``touched``."""
    for cell in range(CELLS):
        if kept[first + cell] or planes.z[first + cell] == EMPTY:
            continue
        row, column = cell // BLOCK_SIZE, cell % BLOCK_SIZE
        for n in range(9):
            south, west = n // 3 * BLOCK_SIZE - BLOCK_SIZE, n % 3 * BLOCK_SIZE - BLOCK_SIZE
            reached = _apart(row, south) <= AROUND and _apart(column, west) <= AROUND
            if around[k, n] >= 0 and reached:
                touched[around[k, n]] = True


@kernel
def _apart(index: int, first: int) -> int:
    """Return the distance from row or column ``index`` to the block whose first row or column is ``first``."""
    return max(first - index, index - first - BLOCK_SIZE + 1, 0)


@kernel
def fit(around: Int32, pages: Int32, wanted: Bool, planes: Planes, limits: PlaneLimits) -> None:
    """Fit the planes of the cells of chosen blocks, and again without spikes where there are any."""
    kept, changed, sums = planes.z != EMPTY, wanted.copy(), _no_sums()
    for _ in range(2):
        left, touched = kept.copy(), np.zeros(pages.size, np.bool_)
        for k in range(pages.size):
            if not (wanted[k] and changed[k]):
                continue
            first, filled, origin = pages[k] * CELLS, 0, 0
            for plane_index in range(first, first + CELLS):
                if planes.z[plane_index] != EMPTY:
                    filled, origin = filled + 1, plane_index
            if filled < FILLED:
                continue
            _fill_patch(planes, around, k, pages, kept, origin, sums.patch)
            _add_up(sums)
            if _fit_block(planes, first, sums, origin, limits, left):
                _touched(around, k, first, left, planes, touched)
        kept, changed = left, touched
