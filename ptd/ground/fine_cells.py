"""Points near a TIN by cells of 0.4 m and blocks of 5 x 5 of them, for `ptd.ground.fine_surface`.

A point is kept as its index, the number of its block and that of its cell in the block: nine bytes, not its position.
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
"""Side of the fine cells."""
SIDE = 5
"""Cells along a side of a block."""
CELLS = SIDE * SIDE

Bool = npt.NDArray[np.bool_]
UInt8 = npt.NDArray[np.uint8]


class Placed(NamedTuple):
    """Points that are near a TIN or in doubt, and where they lie.

    Attributes
    ----------
    point : int32 [m]
        Among all points.
    block : int64 [m]
        Number of the block among the occupied ones.
    cell : uint8 [m]
        Number of the cell in its block, row by row.
    """

    point: Int32
    block: Int64
    cell: UInt8


class Blocks(NamedTuple):
    """Blocks that hold placed points, by rows.

    Attributes
    ----------
    around : int32 [n, 9]
        Number of the block itself and of those around it, row by row, -1 where they are not occupied.
    points, near : int32 [n]
        How many points it holds, and how many of them are `NEAR` or `ON`.
    settled, doubtful : bool [n]
        No point is just `NEAR`, so there is nothing to decide; some point is in doubt.
    """

    around: Int32
    points: Int32
    near: Int32
    settled: Bool
    doubtful: Bool


def placed(points: Xyz, close: UInt8, marked: Bool, scale: Scale) -> tuple[Placed, Blocks]:
    """Find the blocks and cells of the points that are not `FAR`, or marked; none of them may be there.

    Parameters
    ----------
    points : Xyz
    close : uint8 [n]
        See `ptd.ground.labelling.Closeness`.
    marked : bool [n]
    scale : Scale
    """
    index = _chosen(close, marked)
    if index.size == 0:
        none = np.zeros(0, np.int32)
        nothing = np.zeros(0, np.bool_)
        where = Placed(index, none.astype(np.int64), none.astype(np.uint8))
        return where, Blocks(np.zeros((0, 9), np.int32), none, none, nothing, nothing)
    lattice = CellLattice.of(CELL_M, scale)
    keys, cell, width, height = _keys(points, index, lattice.p, lattice.q, lattice.origin_x, lattice.origin_y)
    blocks, block = occupied(keys, width * height)
    where = Placed(index, block, cell)
    around = neighbours_of_blocks(blocks, width)
    return where, Blocks(around, *_counted(where, close, marked, blocks.size))


@kernel
def _chosen(close: UInt8, marked: Bool) -> Int32:
    index, n = np.empty(close.size, np.int32), 0
    for i in range(close.size):
        index[n] = i
        n += (close[i] != FAR) | marked[i]
    return index[:n].copy()


@kernel
def _keys(points: Xyz, index: Int32, p: int, q: int, ox: int, oy: int) -> tuple[Int64, UInt8, int, int]:
    """Key of each point's block in a raster with an empty column at both sides, its cell, and the raster's size."""
    x, y, _ = points
    west = east = as_int64(x[index[0]])
    south = north = as_int64(y[index[0]])
    for i in index:
        west, east = min(west, as_int64(x[i])), max(east, as_int64(x[i]))
        south, north = min(south, as_int64(y[i])), max(north, as_int64(y[i]))
    inverse = 1.0 / p
    column = quotient((west + ox) * q, p, inverse) // SIDE - 1
    row = quotient((south + oy) * q, p, inverse) // SIDE
    width = quotient((east + ox) * q, p, inverse) // SIDE - column + 2
    height = quotient((north + oy) * q, p, inverse) // SIDE - row + 1
    keys, cell = np.empty(index.size, np.int64), np.empty(index.size, np.uint8)
    for k in range(index.size):
        i = index[k]
        across = quotient((as_int64(x[i]) + ox) * q, p, inverse) - column * SIDE
        up = quotient((as_int64(y[i]) + oy) * q, p, inverse) - row * SIDE
        keys[k] = up // SIDE * width + across // SIDE
        cell[k] = up % SIDE * SIDE + across % SIDE
    return keys, cell, width, height


@kernel
def neighbours_of_blocks(keys: Int64, width: int) -> Int32:
    """Index of the block itself and of those around it, row by row, -1 where they are not occupied: int32 [m, 9].

    ``keys`` are sorted; rasters have an empty column at both sides, so no key has a neighbour in another row.
    """
    found = np.full((keys.size, 9), -1, np.int32)
    for row in range(3):
        j = 0
        for k in range(keys.size):
            first = keys[k] + (row - 1) * width - 1
            while j < keys.size and keys[j] < first:
                j += 1
            i = j
            while i < keys.size and keys[i] <= first + 2:
                found[k, 3 * row + keys[i] - first] = i
                i += 1
    return found


@kernel
def _counted(where: Placed, close: UInt8, marked: Bool, n_blocks: int) -> tuple[Int32, Int32, Bool, Bool]:
    """What `Blocks` holds of each block besides those around it."""
    index, block, _ = where
    points, near = np.zeros(n_blocks, np.int32), np.zeros(n_blocks, np.int32)
    settled, doubtful = np.ones(n_blocks, np.bool_), np.zeros(n_blocks, np.bool_)
    for k in range(index.size):
        b, how = block[k], close[index[k]]
        points[b] += 1
        near[b] += how >= NEAR
        settled[b] &= how != NEAR
        doubtful[b] |= marked[index[k]]
    return points, near, settled, doubtful


@kernel
def pages_of_blocks(wanted: Bool, neighbours: Int32) -> tuple[Int32, int]:
    """Page of each block that is wanted or beside one that is, else -1: int32 [m]; and how many there are."""
    pages, n = np.full(wanted.size, -1, np.int32), 0
    for k in range(wanted.size):
        for i in neighbours[k]:
            if i >= 0 and wanted[i]:
                pages[k] = n
                n += 1
                break
    return pages, n
