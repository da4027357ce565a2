"""Shared parts of the passes of photogrammetric clouds: condition, figures, codes and sizes of cells.

Where cells of 1 m and 2 m meet, each pass works on the cells of each size separately
(`of_each_size`). A point is labelled with the cells of the size that its place (a square of 256
m, `ptd.places`) uses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ptd.arrays import Bool, Float64, Int32, UInt8
from ptd.frame import CellLattice, Scale, Window
from ptd.matched.cells import CELL_M, SPARSE_CELL_M, CellHeights
from ptd.matched.survey import (
    BOTH,
    CELL_SIGMA,
    CELL_SIZE,
    CELL_SIZES_M,
    MIN_CELL_SIGMA_M,
    cell_sizes,
    known,
)
from ptd.passes import Model, Pass, Points, State
from ptd.places import PLACES, Field, field, near, of_places

LEFT, TERRAIN, OBJECT = 1, 2, 3
"""Codes of cells between passes: undecided, terrain, and large object."""
CODE, CROWN, COVERED = 3, 4, 8
"""Mask of these codes, bit of cells that a surface over crowns would use, and bit of cells where a
canopy hides the ground."""


def is_matched(state: State) -> bool:
    """Return whether the survey classified the run as image matching."""
    return bool(state["survey"]["kind"] == "dim")


def noise_m(state: State, scale: Scale) -> Field:
    """Return the noise in metres, by place, from which the rules for cells start."""
    return field(state[PLACES], CELL_SIGMA, scale, MIN_CELL_SIGMA_M)


def cell_m(state: State) -> float:
    """Return the size in metres of the cells of a run, for methods whose cells have one size."""
    return float(state["survey"]["cell_m"])


@dataclass(frozen=True)
class MatchedPass(Pass):
    """A pass that only photogrammetric clouds need."""

    kind = "dim"
    by_place = True

    def applies(self, state: State) -> bool:
        """Return whether the survey is done and found image matching."""
        return "survey" in state and is_matched(state)


@dataclass(frozen=True)
class OneSizePass(MatchedPass):
    """A pass of a method that uses one cell size for the whole run."""

    def local(self, state: State, window: Window, scale: Scale) -> State:
        """Return the state that `fit` needs, with the size of the cells."""
        local_state = super().local(state, window, scale)
        return {**local_state, "survey": {**local_state["survey"], "cell_m": cell_m(state)}}


@dataclass(frozen=True)
class OnCellsPass(MatchedPass):
    """A pass on the elected cells and their labels."""

    columns = ("labels",)
    elected = True
    raster_cell_m = CELL_M


class Codes(Model):
    """Model with the code of each cell."""

    def __init__(self, raster: CellHeights | None, codes: UInt8, cells: CellLattice) -> None:
        self._raster, self._cells = raster, cells
        self.stats = {"cells": int(codes.size), "objects": int((codes == OBJECT).sum())}
        if raster is not None:
            self._codes = raster.spread(codes).reshape(-1)

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Return the codes of cells. All are certified, because the pass has a fixed radius."""
        uncertified = np.zeros(len(points), np.bool_)
        if self._raster is None or len(points) == 0:
            return np.zeros(len(points), np.uint8), uncertified
        columns, rows = self._cells.cell_indices(points.xyz[0], points.xyz[1])
        width = self._raster.heights.shape[1]
        return self._codes[
            (rows - self._raster.row) * width + columns - self._raster.column
        ], uncertified


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
    return _ModelOfCells(models, scale) if cells else _ModelOfPoints(models, scale, state)


class _ModelOfCells(Model):
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


class _ModelOfPoints(_ModelOfCells):
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
