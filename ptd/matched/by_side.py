"""Passes of photogrammetric clouds where cells of 1 m and 2 m meet.

Each pass works on the cells of each side separately. A point is labelled with the cells of the side of its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.morphology import Bool
from ptd.matched.cells import SPARSE_CELL_M
from ptd.matched.place_figures import BOTH, SIDE, SIDES_M, known, sides
from ptd.passes import Model, Points, State, UInt8
from ptd.places import PLACES, near, of_places

Float64 = npt.NDArray[np.float64]
OfSide = Callable[[Points, Scale, State, float], Model]
"""Function of a pass that fits the cells of one side, from elected points, scale, state and side in metres."""


def needed(xyz: Int32, side_m: float, state: State, scale: Scale) -> Bool:
    """Return a mask of the cells of a side that lie in places that need this side: bool [n]."""
    place_sides, both = (of_places(state[PLACES], figure, xyz[0], xyz[1], scale) for figure in (SIDE, BOTH))
    is_needed: Bool = (place_sides == side_m) | (both > 0)
    return is_needed


def side_of_cells(points: Points, scale: Scale) -> Float64:
    """Return the sides in metres of the cells with the given middles: float64 [n].

    Middles of cells of 2 m are corners of cells of 1 m, so a middle shows the side of its cell.
    """
    x, y = points.xyz[0], points.xyz[1]
    cells = CellLattice.of(SPARSE_CELL_M, scale)
    columns, rows = cells.cell_indices(x, y)
    west, south = cells.corners(columns, rows)
    east, north = cells.corners(columns + 1, rows + 1)
    middle = (x == (west + east) // 2) & (y == (south + north) // 2)
    return np.where(middle, SIDES_M[1], SIDES_M[0])


def of_each_side(
    of_side: OfSide, points: Points, core: Window, scale: Scale, state: State, cells: bool
) -> Model:
    """Fit the cells of each side in a window and return one model of them.

    The model labels cells of the core if ``cells`` is true, else points by the side of their place.
    """
    present = sides(state[PLACES]) or SIDES_M[:1]
    if len(present) == 1:
        return of_side(points, scale, state, present[0])
    cell_sides = side_of_cells(points, scale)
    asked = near(state[PLACES], core, scale)
    sides_asked = sides(asked) if cells else {known(figures, SIDE) for figures in asked.values()}
    models = {side: of_side(points.take(cell_sides == side), scale, state, side) for side in sides_asked}
    return ModelOfCells(models, scale) if cells else ModelOfPoints(models, scale, state)


class ModelOfCells(Model):
    """Model that labels each cell with the model of its side."""

    def __init__(self, models: Mapping[float, Model], scale: Scale) -> None:
        self._models, self._scale = models, scale
        names = {name: 0 for model in models.values() for name in model.stats}
        self.stats = {name: sum(model.stats[name] for model in models.values()) for name in names}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label each cell with the model of its side."""
        labels, marks = np.zeros(len(points), np.uint8), np.zeros(len(points), np.bool_)
        cell_sides = side_of_cells(points, self._scale)
        for side, model in self._models.items():
            of_side = cell_sides == side
            labels[of_side], marks[of_side] = model.label(points.take(of_side))
        return labels, marks


class ModelOfPoints(ModelOfCells):
    """Model that labels each point with the model of the side of its place."""

    def __init__(self, models: Mapping[float, Model], scale: Scale, state: State) -> None:
        super().__init__(models, scale)
        self._state = state

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label each point with the model of its place, which also reads the points of other places around it."""
        labels, marks = np.zeros(len(points), np.uint8), np.zeros(len(points), np.bool_)
        place_sides = of_places(self._state[PLACES], SIDE, points.xyz[0], points.xyz[1], self._scale)
        for side, model in self._models.items():
            of_side = place_sides == side
            if of_side.any():
                model_labels, doubtful = model.label(points)
                labels[of_side], marks[of_side] = model_labels[of_side], doubtful[of_side]
        return labels, marks
