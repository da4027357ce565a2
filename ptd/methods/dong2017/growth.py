"""Ground that grows by tests against TINs of one density, each of other picks of the ground found so far.

Source: Dong 2017 (004), section 3.2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptd.cells import Int32
from ptd.frame import Cells, Scale, Window
from ptd.ground.certificates import Doubt, UInt8
from ptd.ground.distance_angle import Bool, Int64, Threshold, Trial
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.ground.random_choice import picked_per_cell
from ptd.ground.seeds import box_with_ring, cells_of
from ptd.methods.dong2017.virtual_border import REACH, rim
from ptd.passes import Model, Points
from ptd.tin.mesh import Tin

WIDEST_CELLS = 1.5
"""Largest circumradius of a facet that tests points, in cells. Circles within the rim have at most sqrt(2)."""


class Stage(NamedTuple):
    """TINs of one density.

    Attributes
    ----------
    cell_m : float
        One vertex in each cell of this side that holds ground.
    widest_m : float
        Largest circumradius of a facet that tests points.
    tins : int
        How many, one after the other.
    rim : bool
        With virtual points around the ground, so that it grows outward too. Without, cells hold one ground point.
    """

    cell_m: float
    widest_m: float
    tins: int
    rim: bool

    @classmethod
    def of_ground(cls, cell_m: float, tins: int) -> Stage:
        """TINs that grow."""
        return cls(cell_m, WIDEST_CELLS * cell_m, tins, True)

    @property
    def reach_m(self) -> float:
        """Metres around a window's core with which its ground seldom is in doubt; for one TIN without a rim, never.

        A facet's circle; cut cells and the rim's; for each further TIN three cells and a half, as measured.
        """
        rim = (1 + REACH) * self.cell_m if self.rim else 0.0
        return 2 * self.widest_m + rim + 3.5 * (self.tins - 1) * self.cell_m


class Growth(Model):
    """Ground of a window, and TINs that give more.

    Each TIN holds a random point of every cell that holds ground, another one each time. A point that passes is ground
    for the next. What points outside the window could change is tracked as in `ptd.ground.densify`: a cell that holds
    a doubtful point may have another pick, or none, and the empty cells around it another rim.

    Parameters
    ----------
    stage : Stage
    threshold : Threshold
    points : Points
        All of the window, with labels: `GROUND`, `UNCLASSIFIED`, and others, which are never tested.
    window : Window
    scale : Scale
    """

    def __init__(
        self, stage: Stage, threshold: Threshold, points: Points, window: Window, scale: Scale
    ) -> None:
        self.stage, self.threshold, self.scale = stage, threshold, scale
        cells = Cells.of(stage.cell_m, scale)
        known = window.inside(cells, REACH) if stage.rim else window
        x, y, z = points.columns()
        box = box_with_ring(x, y, cells) if x.size else (0, 0, 1, 1)
        self._doubt = Doubt(known, known, box, scale)
        labels = points.known_labels()
        ground = labels == GROUND
        self._trials = [self._trial(points, ground, cells, 0)]
        for salt in range(1, stage.tins):
            todo = (labels == UNCLASSIFIED) & ~ground
            passed, doubtful = self._trials[-1].test(x, y, z, todo, threshold, self._doubt)
            ground |= passed
            _doubt_cells(self._doubt, cells, x, y, ground, doubtful)
            self._trials.append(self._trial(points, ground, cells, salt))
        self.stats = {"tins": stage.tins, "vertices": self._trials[-1].tin.n_vertices}

    def _trial(self, points: Points, ground: Bool, cells: Cells, salt: int) -> Trial:
        vertices = points.xyz[:, picks(points, ground, cells, salt)]
        if self.stage.rim:
            x, y, z = vertices
            vertices = np.concatenate([vertices, rim(x, y, z, cells).T], axis=1)
        return Trial(Tin.build(*vertices), self.scale, self.stage.widest_m, self._doubt)

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """What passes in one of the TINs is ground; all other labels stay."""
        x, y, z = points.columns()
        labels = points.known_labels().copy()
        todo, marked = labels == UNCLASSIFIED, np.zeros(x.size, np.bool_)
        for trial in self._trials:
            passed, doubtful = trial.test(x, y, z, todo, self.threshold, self._doubt)
            labels[passed] = GROUND
            marked |= doubtful
            sure = passed & ~doubtful
            marked[sure] = False
            todo &= ~sure
        return labels, marked


def picks(points: Points, ground: Bool, cells: Cells, salt: int) -> Int64:
    """Indices of one random point of each cell that holds ground."""
    index = np.flatnonzero(ground)
    x, y, z = points.take(index).columns()
    return index[picked_per_cell(x, y, z, cells, salt)]


def _doubt_cells(doubt: Doubt, cells: Cells, x: Int32, y: Int32, ground: Bool, doubtful: Bool) -> None:
    """Put in doubt the cells of doubtful points, and around them those that are empty."""
    if not doubt.active or not doubtful.any():
        return

    sure = ground & ~doubtful
    own, filled = set(cells_of(x[doubtful], y[doubtful], cells)), set(cells_of(x[sure], y[sure], cells))
    span = range(-REACH, REACH + 1)
    around = {(c + i, r + j) for c, r in own for j in span for i in span} - filled
    for c, r in own | around:
        doubt.add_box(cells.west(c), cells.south(r), cells.west(c + 1), cells.south(r + 1))
