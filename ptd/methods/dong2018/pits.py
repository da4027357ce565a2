"""Find narrow pits in the surface of lowest points: blunders of image matching below the ground."""

from __future__ import annotations

import numpy as np

from ptd.cells import Int32, Int64, cell_keys, lowest_per_cell
from ptd.frame import CellLattice, Scale
from ptd.ground.outliers import LowNoise
from ptd.kernel import kernel

CELL_M = 1.0
REACH_CELLS = 2
"""Number of whole cells around a point that decide whether it lies in a pit."""

_ROW = 1 << 32
_BLOCK = (-1, 0, 1)
_NO_HEIGHT = -(2**62)


@kernel
def _around(keys: Int64, heights: Int64, wanted: Int64, sign: int, out: Int64) -> None:
    """The highest (sign 1) or lowest (-1) filled cell among the 3 x 3 cells around each chosen cell."""
    for i in range(wanted.size):
        best = np.int64(_NO_HEIGHT)
        for row in range(-1, 2):
            first = wanted[i] + row * _ROW - 1
            k = np.searchsorted(keys, first)
            while k < keys.size and keys[k] <= first + 2:
                best = max(best, sign * heights[k])
                k += 1
        out[i] = sign * best


def pits(x: Int32, y: Int32, z: Int32, depth_m: float, scale: Scale) -> LowNoise:
    """Heights below which points lie in pits, by cell.

    The surface of the lowest points per cell is closed with a square of 3 x 3 cells, which
    fills hollows that are narrower than the square. A slope stays unchanged at any inclination,
    so a depth of a few times the noise suffices. Squares may lie partly outside the data;
    otherwise the lower border of the data would count as a pit.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, in any order.
    depth_m : float
        Points farther below the closed surface are in a pit.
    scale : Scale

    Returns
    -------
    LowNoise
        Limits of all cells with points.
    """
    cells = CellLattice.of(CELL_M, scale)
    lowest = lowest_per_cell(x, y, z, cells)
    x, y, heights = x[lowest], y[lowest], z[lowest].astype(np.int64)
    keys = cell_keys(x, y, cells, cells.column(0), cells.row(0), _ROW)
    order = np.argsort(keys)
    keys, heights = keys[order], heights[order]
    around = []
    for row in _BLOCK:
        for column in _BLOCK:
            around.append(keys + row * _ROW + column)
    centres = np.unique(np.concatenate(around))
    highest, closed = np.empty(centres.size, np.int64), np.empty(keys.size, np.int64)
    _around(keys, heights, centres, 1, highest)
    _around(centres, highest, keys, -1, closed)
    limit = closed - int(np.ceil(scale.counts_z(depth_m)))
    return LowNoise(
        x[order], y[order], np.maximum(limit, np.iinfo(np.int32).min).astype(np.int32), cells
    )
