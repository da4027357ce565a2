"""Virtual points that extend a TIN a little beyond its outermost points, along its planes.

They resemble the ring of seeds (`ptd.ground.seeds`), but their heights follow the slope of the
ground. Where ground grows outward or along a hillside, a level ring would be too high or too
low within a few metres.
"""

from __future__ import annotations

import math

import numpy as np

from ptd.cells import CellTable, Int32, Int64, cell_keys, slot_of
from ptd.frame import CellLattice
from ptd.ground.planes import MOMENTS, add_point, fit_plane
from ptd.ground.seeds import RING
from ptd.kernel import kernel

REACH = 3
"""Number of cells around a virtual point whose points give its height."""

MIN_CELLS = 4
"""Number of cells below which the mean height is taken instead of a plane."""


@kernel
def _heights(
    table: CellTable, x: Int64, y: Int64, z: Int64, empty: Int64, cx: Int64, cy: Int64
) -> Int64:
    """Heights of planes through the filled cells around empty ones."""
    out = np.empty(empty.size, np.int64)
    s = np.zeros(MOMENTS, np.int64)
    for k in range(empty.size):
        s[:] = 0
        row, column = empty[k] // table.width, empty[k] % table.width
        base = np.int64(0)
        for r in range(row - REACH, row + REACH + 1):
            for c in range(column - REACH, column + REACH + 1):
                slot = slot_of(table, c, r)
                if slot < 0:
                    continue
                i = table.order[slot]  # each cell holds one point
                if s[0] == 0:
                    base = z[i]
                add_point(s, x[i] - cx[k], y[i] - cy[k], z[i] - base)
        level = s[3] / s[0]
        if s[0] >= MIN_CELLS:
            _, _, at, squares = fit_plane(s, 1.0)
            if squares >= 0.0:
                level = at
        out[k] = base + np.int64(math.floor(level + 0.5))
    return out


def rim(x: Int32, y: Int32, z: Int32, cells: CellLattice) -> Int32:
    """Virtual points at the middle of each empty cell within `RING` cells of a filled one.

    Therefore an empty circle through a position in such a cell, or in a filled one, has at most
    a cell's diagonal as its radius (``docs/filters.md``: the ring bounds circles). A height is
    that of the plane through the points of the cells up to `REACH` away, in whole counts. Cells
    farther away have no effect.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, at most one point in each cell.
    cells : CellLattice

    Returns
    -------
    int32 [m, 3]
        x, y, z in local counts, in the order of the cells.
    """
    if x.size == 0:
        return np.zeros((0, 3), np.int32)
    col0, row0 = cells.column(int(x.min())) - REACH, cells.row(int(y.min())) - REACH
    width = cells.column(int(x.max())) + REACH + 1 - col0
    height = cells.row(int(y.max())) + REACH + 1 - row0
    keys = cell_keys(x, y, cells, col0, row0, width)
    order = np.argsort(keys)
    keys = keys[order]
    steps = np.arange(-RING, RING + 1, dtype=np.int64)
    around = np.unique((keys[:, None] + (steps[:, None] * width + steps).ravel()).ravel())
    empty = np.setdiff1d(around, keys, assume_unique=True)
    half = cells.p // (2 * cells.q)
    cx = half - (-(empty % width + col0) * cells.p) // cells.q - cells.origin_x
    cy = half - (-(empty // width + row0) * cells.p) // cells.q - cells.origin_y
    table = CellTable(
        np.zeros(0, np.int32), keys, np.arange(keys.size + 1), order, width, height
    )
    x64, y64, z64 = (column.astype(np.int64) for column in (x, y, z))
    heights = _heights(table, x64, y64, z64, empty, cx, cy)
    return np.stack([cx, cy, np.clip(heights, -(2**31) + 1, 2**31 - 1)], axis=1).astype(
        np.int32
    )
