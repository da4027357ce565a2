"""Passes of photogrammetric clouds where cells of 1 m and 2 m meet.

Each pass works on the cells of each size separately. A point is labelled with the cells of the
size that its place (a square of 256 m, `ptd.places`) uses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.morphology import Bool
from ptd.matched.cells import SPARSE_CELL_M
from ptd.matched.place_figures import BOTH, CELL_SIZE, CELL_SIZES_M, cell_sizes, known
from ptd.passes import Model, Points, State, UInt8
from ptd.places import PLACES, near, of_places

Float64 = npt.NDArray[np.float64]
OfSize = Callable[[Points, Scale, State, float], Model]
"""Function of a pass that fits the cells of one size, from elected points, scale, state and
size in metres."""


def needed(xyz: Int32, size_m: float, state: State, scale: Scale) -> Bool:
    """Return a mask of the cells of a size that lie in places that need this size: bool [n]."""
    place_sizes, both = (
        of_places(state[PLACES], figure, xyz[0], xyz[1], scale) for figure in (CELL_SIZE, BOTH)
    )
    is_needed: Bool = (place_sizes == size_m) | (both > 0)
    return is_needed


def size_of_cells(points: Points, scale: Scale) -> Float64:
    """Return the sizes in metres of the cells with the given middles: float64 [n].

    Middles of cells of 2 m are corners of cells of 1 m, so a middle shows the size of its cell.
    """
    x, y = points.xyz[0], points.xyz[1]
    cells = CellLattice.of(SPARSE_CELL_M, scale)
    columns, rows = cells.cell_indices(x, y)
    west, south = cells.corners(columns, rows)
    east, north = cells.corners(columns + 1, rows + 1)
    middle = (x == (west + east) // 2) & (y == (south + north) // 2)
    return np.where(middle, CELL_SIZES_M[1], CELL_SIZES_M[0])


def of_each_size(
    of_size: OfSize, points: Points, core: Window, scale: Scale, state: State, cells: bool
) -> Model:
    """Fit the cells of each size in a window and return one model of them.

    If ``cells`` is true, the model labels cells, each with the model of its size. Otherwise it
    labels points, each with the model of the cell size of its place.
    """
    present = cell_sizes(state[PLACES]) or CELL_SIZES_M[:1]
    if len(present) == 1:
        return of_size(points, scale, state, present[0])
    sizes_m = size_of_cells(points, scale)
    near_places = near(state[PLACES], core, scale)
    requested_sizes = (
        cell_sizes(near_places)
        if cells
        else {known(figures, CELL_SIZE) for figures in near_places.values()}
    )
    models = {
        size_m: of_size(points.take(sizes_m == size_m), scale, state, size_m)
        for size_m in requested_sizes
    }
    return ModelOfCells(models, scale) if cells else ModelOfPoints(models, scale, state)


class ModelOfCells(Model):
    """Model that labels each cell with the model of its size."""

    def __init__(self, models: Mapping[float, Model], scale: Scale) -> None:
        self._models, self._scale = models, scale
        names = {name: 0 for model in models.values() for name in model.stats}
        self.stats = {
            name: sum(model.stats[name] for model in models.values()) for name in names
        }

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label each cell with the model of its size."""
        labels, uncertified = np.zeros(len(points), np.uint8), np.zeros(len(points), np.bool_)
        sizes_m = size_of_cells(points, self._scale)
        for size_m, model in self._models.items():
            of_size = sizes_m == size_m
            labels[of_size], uncertified[of_size] = model.label(points.take(of_size))
        return labels, uncertified


class ModelOfPoints(ModelOfCells):
    """Model that labels each point with the model of the cell size of its place."""

    def __init__(self, models: Mapping[float, Model], scale: Scale, state: State) -> None:
        super().__init__(models, scale)
        self._state = state

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Label each point with the model of its place's cell size.

        That model is passed all points, because points of other places around it vote as well.
        """
        labels, uncertified = np.zeros(len(points), np.uint8), np.zeros(len(points), np.bool_)
        place_sizes = of_places(
            self._state[PLACES], CELL_SIZE, points.xyz[0], points.xyz[1], self._scale
        )
        for size_m, model in self._models.items():
            of_size = place_sizes == size_m
            if of_size.any():
                model_labels, model_uncertified = model.label(points)
                labels[of_size], uncertified[of_size] = (
                    model_labels[of_size],
                    model_uncertified[of_size],
                )
        return labels, uncertified
