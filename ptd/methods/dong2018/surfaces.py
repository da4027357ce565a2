"""The surfaces that `dong2018` compares points with: one without pits, and even TINs.

Stage one finds narrow pits in the surface of the lowest points, which are blunders of image
matching below the ground. Stage two tests points against a TIN of one random ground point per
cell (Dong 2018, 2.5.3).
"""

from __future__ import annotations

import math

import numpy as np

from ptd.arrays import Bool, Int32, Int64
from ptd.cells import cell_keys, lowest_per_cell
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.distance_angle import Bins, Threshold, Trial, random_per_cell
from ptd.ground.outliers import LowNoise
from ptd.kernel import kernel
from ptd.tin.mesh import Tin

PIT_CELL_M = 1.0
PIT_REACH_CELLS = 2
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
    cells = CellLattice.of(PIT_CELL_M, scale)
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


MAX_WIDTH_M = 20.0
"""Largest circumradius of a facet that tests points; larger ones lie under objects or across
voids."""

# A fine bin compared with the noise of photogrammetric clouds, about 0.1 m.
DISTANCE_BIN_M = 0.02
ANGLE_BIN_DEG = 1.0
BINS = Bins(DISTANCE_BIN_M, 150, math.radians(ANGLE_BIN_DEG), 90)

_SALT = 2018


def reach_m(scale_m: float) -> float:
    """Metres around a point within which facets decide on it: the largest circle, and the cells cut by its edge."""
    return 2.0 * MAX_WIDTH_M + 2.0 * scale_m


class EvenTin:
    """The even TIN of a window, to which distances and angles of points are measured.

    Parameters
    ----------
    x, y, z : int32 [n]
        Points of the window, local counts, in any order.
    ground : bool [n]
    scale_m : float
        Size of the cells; each gives one ground point as a vertex.
    window : Window
    scale : Scale
    """

    def __init__(
        self,
        x: Int32,
        y: Int32,
        z: Int32,
        ground: Bool,
        scale_m: float,
        window: Window,
        scale: Scale,
    ) -> None:
        index = np.flatnonzero(ground)
        cells = CellLattice.of(scale_m, scale)
        picked = index[random_per_cell(x[index], y[index], z[index], cells, _SALT)]
        self.left_out = ground.copy()
        self.left_out[picked] = False
        tin = Tin.build(x[picked], y[picked], z[picked])
        known = window.inside(cells)
        box = (0, 0, 1, 1)
        if picked.size:
            px, py = x[picked], y[picked]
            box = int(px.min()), int(py.min()), int(px.max()) + 1, int(py.max()) + 1
        self._region = UncertifiedRegion(known, known, box, scale)
        self._trial = Trial(tin, scale, MAX_WIDTH_M, self._region, largest=True)
        self.vertices = int(picked.size)

    def histogram(self, x: Int32, y: Int32, z: Int32, which: Bool) -> Int64:
        """Distances and angles of the chosen points: int64 [distances, angles] of `BINS`."""
        return self._trial.count(x, y, z, which, BINS)

    def near(
        self, x: Int32, y: Int32, z: Int32, which: Bool, distance_m: float, angle_deg: float
    ) -> tuple[Bool, Bool]:
        """Return masks of the chosen points within distance and angle of their facet, and of uncertified results."""
        threshold = Threshold(distance_m, math.radians(angle_deg))
        return self._trial.test(x, y, z, which, threshold, self._region)
