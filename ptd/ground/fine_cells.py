"""Points near a TIN, sorted into cells of 0.4 m and blocks of 5 x 5 cells, for `ptd.ground.fine_surface`.

A point is stored as its index, the number of its block and the number of its cell in the block
(13 bytes), not as its position.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, Xyz, occupied, quotient
from ptd.frame import CellLattice, Scale
from ptd.ground.labelling import FAR, NEAR
from ptd.kernel import as_int64, kernel

CELL_M = 0.4
"""Size of the fine cells."""
BLOCK_SIZE = 5
"""Number of cells along a side of a block."""
CELLS = BLOCK_SIZE * BLOCK_SIZE

Bool = npt.NDArray[np.bool_]
UInt8 = npt.NDArray[np.uint8]


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
