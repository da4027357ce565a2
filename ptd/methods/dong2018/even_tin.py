"""A TIN of one random ground point per cell, against which all other points are tested (Dong 2018, 2.5.3)."""

from __future__ import annotations

import math

import numpy as np

from ptd.cells import Int32
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.distance_angle import Bins, Bool, Int64, Threshold, Trial
from ptd.ground.random_choice import random_per_cell
from ptd.tin.mesh import Tin

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
