"""Points sorted by cell and height, for a fast search of the lowest point that passes a test."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptd.cells import CellIndex, CellTable, Int32, Int64, is_lower, slot_of
from ptd.frame import CellLattice
from ptd.kernel import as_int64, kernel

SMALL_STACK = 24
"""Largest stack for which insertion sort alone is faster."""


@kernel
def _sort_stacks(x: Int32, y: Int32, z: Int32, starts: Int64, order: Int64) -> None:
    for k in range(starts.size - 1):
        first, end = starts[k], starts[k + 1]
        if end - first > SMALL_STACK:  # sort by height first; insertion then only settles ties
            part = order[first:end].copy()
            order[first:end] = part[np.argsort(z[part])]
        for j in range(first + 1, end):
            moving = order[j]
            position = j
            while position > first and is_lower(x, y, z, moving, order[position - 1]):
                order[position] = order[position - 1]
                position -= 1
            order[position] = moving


class StackIndex(NamedTuple):
    """Stacks of points by cell, for kernels (`ptd.cells.CellIndex`, `ptd.frame.CellLattice`)."""

    table: CellTable
    col0: int
    row0: int
    p: int
    q: int
    origin_x: int
    origin_y: int


class Stacks:
    """Points sorted by the cells of a lattice in row-major order, and within a cell by (z, x, y).

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, at least one point.
    cells : CellLattice

    Attributes
    ----------
    x, y, z : int32 [n]
        Sorted coordinates.
    starts : int64 [m + 1]
        Stack k holds the points ``starts[k]`` to ``starts[k + 1] - 1``; no stack is empty.
    raster : StackIndex
    """

    def __init__(self, x: Int32, y: Int32, z: Int32, cells: CellLattice) -> None:
        index = CellIndex(x, y, cells)
        table = index.table
        _sort_stacks(x, y, z, table.starts, table.order)
        self.x, self.y, self.z = x[table.order], y[table.order], z[table.order]
        self.starts = table.starts
        self.raster = StackIndex(
            table, index.col0, index.row0, cells.p, cells.q, cells.origin_x, cells.origin_y
        )


@kernel
def lowest_within(
    x: Int32, y: Int32, z: Int32, raster: StackIndex, x3: int, y3: int, radius: float
) -> int:
    """The lowest point within a radius of the position (x3 / 3, y3 / 3), or -1.

    Among equal heights the lexicographically smallest (x, y) is taken. Distances are compared
    exactly.

    Parameters
    ----------
    x, y, z : int32 [n]
        Arrays of `Stacks`.
    raster : StackIndex
    x3, y3 : int64
        Three times the position in local counts, such as the sum of a facet's corners.
    radius : float
        Counts.
    """
    half_width = int(radius) + 2
    x0, y0 = x3 // 3 - half_width + raster.origin_x, y3 // 3 - half_width + raster.origin_y
    limit2 = 9.0 * radius * radius
    best = -1
    for row in range(
        y0 * raster.q // raster.p, (y0 + 2 * half_width) * raster.q // raster.p + 1
    ):
        for column in range(
            x0 * raster.q // raster.p, (x0 + 2 * half_width) * raster.q // raster.p + 1
        ):
            slot = slot_of(raster.table, column - raster.col0, row - raster.row0)
            if slot < 0:
                continue
            for i in range(raster.table.starts[slot], raster.table.starts[slot + 1]):
                dx, dy = np.int64(3) * x[i] - x3, np.int64(3) * y[i] - y3
                if dx * dx + dy * dy <= limit2:
                    if best < 0 or is_lower(x, y, z, i, best):
                        best = i
                    break  # later points of the stack are not lower
    return best


@kernel
def indices_in_stacks(
    of_x: Int32, of_y: Int32, of_z: Int32, x: Int32, y: Int32, z: Int32, raster: StackIndex
) -> Int32:
    """Index of each point within `Stacks`, -1 for points that are not in it: int32 [n].

    Parameters
    ----------
    of_x, of_y, of_z : int32 [n]
        Local counts, in any order. For points at one position any of their indices may result.
    x, y, z : int32
        Arrays of `Stacks`.
    raster : StackIndex
    """
    indices = np.full(of_x.size, -1, np.int32)
    for k in range(of_x.size):
        column = (as_int64(of_x[k]) + raster.origin_x) * raster.q // raster.p - raster.col0
        row = (as_int64(of_y[k]) + raster.origin_y) * raster.q // raster.p - raster.row0
        slot = slot_of(raster.table, column, row)
        if slot < 0:
            continue
        for i in range(raster.table.starts[slot], raster.table.starts[slot + 1]):
            if z[i] > of_z[k]:
                break
            if z[i] == of_z[k] and x[i] == of_x[k] and y[i] == of_y[k]:
                indices[k] = i
                break
    return indices
