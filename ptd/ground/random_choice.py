"""Random choices by hashes of coordinates, which are the same for any tile or order of points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, lowest_per_cell
from ptd.frame import CellLattice

UInt32 = npt.NDArray[np.uint32]
UInt64 = npt.NDArray[np.uint64]


def _mixed64(values: UInt64) -> UInt64:
    """Mix bits by SplitMix64 (Steele, Lea and Flood 2014): each bit of the input changes half of the bits."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: UInt64 = values ^ (values >> np.uint64(31))
    return mixed


def _mixed32(values: UInt32) -> UInt32:
    """Mix bits by the finaliser of MurmurHash3, which is one-to-one."""
    values = (values ^ (values >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    values = (values ^ (values >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    mixed: UInt32 = values ^ (values >> np.uint32(16))
    return mixed


def point_hashes(x: Int32, y: Int32, z: Int32, cells: CellLattice, salt: int) -> Int32:
    """Return a random number for each point from its absolute position and a salt: int32 [n].

    Points at one (x, y) with different heights have different numbers. So ties in
    `random_per_cell` are only between different positions in plan, or between equal points.
    """
    with np.errstate(over="ignore"):
        east = (x.astype(np.int64) + cells.origin_x).view(np.uint64)
        north = (y.astype(np.int64) + cells.origin_y).view(np.uint64)
        position_hashes = _mixed64(
            _mixed64(east + _mixed64(np.full(1, salt, np.uint64))) + north
        )
        return _mixed32(position_hashes.astype(np.uint32) ^ z.view(np.uint32)).view(np.int32)


def random_per_cell(x: Int32, y: Int32, z: Int32, cells: CellLattice, salt: int) -> Int32:
    """Pick one random point of each occupied cell, in row-major order of the cells.

    The pick depends only on the cell's own points and the salt, not on their order, the tile or
    the frame's offset.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts.
    cells : CellLattice
    salt : int
        Seed of the picks, at least 0.

    Returns
    -------
    int32 [m]
        Indices of the picked points.
    """
    if x.size == 0:
        return np.zeros(0, np.int32)
    return lowest_per_cell(
        x, y, point_hashes(x, y, np.ascontiguousarray(z), cells, salt), cells
    )
