"""Ground that grows by tests against TINs of one density, each from other choices of the ground found so far.

Source: Dong 2017 (004), section 3.2. Virtual points extend a TIN a little beyond its outermost
points, along its planes. They resemble the ring of seeds (`ptd.ground.densify`), but their
heights follow the slope of the ground. Where ground grows outward or along a hillside, a level
ring would be too high or too low within a few metres.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64, UInt8
from ptd.cells import CellTable, cell_keys, slot_of
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import RING, box_with_ring, cells_of
from ptd.ground.distance_angle import Threshold, Trial, random_per_cell
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.ground.slopes import MOMENTS, add_point, fit_plane
from ptd.kernel import kernel
from ptd.passes import Model, Points
from ptd.tin.mesh import Tin

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
    col0, row0, width, height = cells.extent(x, y, REACH)
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


MAX_WIDTH_CELLS = 1.5
"""Largest circumradius of a facet that tests points, in cells. Within the rim it is at most
sqrt(2)."""


class Stage(NamedTuple):
    """Properties of the TINs of one density.

    Attributes
    ----------
    cell_m : float
        Size of the cells in metres. Each cell with ground gives one vertex.
    widest_m : float
        Largest circumradius of a facet that tests points.
    tins : int
        Number of TINs, one after the other.
    rim : bool
        Whether virtual points surround the ground, so that it grows outward too. Without them, each cell must
        contain at most one ground point.
    """

    cell_m: float
    widest_m: float
    tins: int
    rim: bool

    @classmethod
    def of_ground(cls, cell_m: float, tins: int) -> Stage:
        """TINs from which ground grows."""
        return cls(cell_m, MAX_WIDTH_CELLS * cell_m, tins, True)

    @property
    def reach_m(self) -> float:
        """Margin in metres with which a core's ground is seldom uncertified, or never for one TIN without a rim.

        It is the sum of a facet's circle, the cells cut by the edge and those of the rim, and
        3.5 cells for each further TIN, as measured.
        """
        rim_m = (1 + REACH) * self.cell_m if self.rim else 0.0
        return 2 * self.widest_m + rim_m + 3.5 * (self.tins - 1) * self.cell_m


class Growth(Model):
    """Ground of a window, and the TINs that extend it.

    Each TIN holds a random point of every cell with ground, a new choice each time. A point
    that passes is ground for the next TIN. Effects of points outside the window are tracked as
    in `ptd.ground.densify`: a cell with an uncertified point may get another vertex or none,
    and the empty cells around it another rim.

    Parameters
    ----------
    stage : Stage
    threshold : Threshold
    points : Points
        All points of the window with labels: `GROUND`, `UNCLASSIFIED`, and others, which are never tested.
    window : Window
    scale : Scale
    """

    def __init__(
        self, stage: Stage, threshold: Threshold, points: Points, window: Window, scale: Scale
    ) -> None:
        self.stage, self.threshold, self.scale = stage, threshold, scale
        cells = CellLattice.of(stage.cell_m, scale)
        known = window.inside(cells, REACH) if stage.rim else window
        x, y, z = points.columns()
        box = box_with_ring(x, y, cells) if x.size else (0, 0, 1, 1)
        self._region = UncertifiedRegion(known, known, box, scale)
        labels = points.known_labels()
        ground = labels == GROUND
        self._trials = [self._trial(points, ground, cells, 0)]
        for salt in range(1, stage.tins):
            todo = (labels == UNCLASSIFIED) & ~ground
            passed, uncertified = self._trials[-1].test(x, y, z, todo, threshold, self._region)
            ground |= passed
            _add_uncertified_cells(self._region, cells, x, y, ground, uncertified)
            self._trials.append(self._trial(points, ground, cells, salt))
        self.stats = {"tins": stage.tins, "vertices": self._trials[-1].tin.n_vertices}

    def _trial(self, points: Points, ground: Bool, cells: CellLattice, salt: int) -> Trial:
        vertices = points.xyz[:, picks(points, ground, cells, salt)]
        if self.stage.rim:
            x, y, z = vertices
            vertices = np.concatenate([vertices, rim(x, y, z, cells).T], axis=1)
        return Trial(Tin.build(*vertices), self.scale, self.stage.widest_m, self._region)

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label points that pass in one of the TINs as ground, and keep all other labels."""
        x, y, z = points.columns()
        labels = points.known_labels().copy()
        todo, uncertified_labels = labels == UNCLASSIFIED, np.zeros(x.size, np.bool_)
        for trial in self._trials:
            passed, uncertified = trial.test(x, y, z, todo, self.threshold, self._region)
            labels[passed] = GROUND
            uncertified_labels |= uncertified
            sure = passed & ~uncertified
            uncertified_labels[sure] = False
            todo &= ~sure
        return labels, uncertified_labels


def picks(points: Points, ground: Bool, cells: CellLattice, salt: int) -> Int64:
    """Index of one random point of each cell that holds ground."""
    index = np.flatnonzero(ground)
    x, y, z = points.take(index).columns()
    return index[random_per_cell(x, y, z, cells, salt)]


def _add_uncertified_cells(
    region: UncertifiedRegion,
    cells: CellLattice,
    x: Int32,
    y: Int32,
    ground: Bool,
    uncertified: Bool,
) -> None:
    """Make the cells of uncertified points uncertified, and the empty cells around them."""
    if not region.active or not uncertified.any():
        return
    sure = ground & ~uncertified
    uncertified_cells = set(cells_of(x[uncertified], y[uncertified], cells))
    filled = set(cells_of(x[sure], y[sure], cells))
    around: set[tuple[int, int]] = set()
    for column, row in uncertified_cells:
        for r in range(row - REACH, row + REACH + 1):
            around.update((c, r) for c in range(column - REACH, column + REACH + 1))
    for c, r in uncertified_cells | (around - filled):
        region.add_box(cells.west(c), cells.south(r), cells.west(c + 1), cells.south(r + 1))
