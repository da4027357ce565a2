"""Shared parts of the passes of photogrammetric clouds: their condition, figures of the run, codes of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptd.frame import CellLattice, Scale, Window
from ptd.ground.morphology import Bool
from ptd.matched.cells import CellHeights
from ptd.matched.place_figures import CELL_SIGMA
from ptd.matched.survey import MIN_CELL_SIGMA_M
from ptd.passes import Model, Pass, Points, State, UInt8
from ptd.places import PLACES, Field, field

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


class Codes(Model):
    """Model with the code of each cell."""

    def __init__(self, raster: CellHeights | None, codes: UInt8, cells: CellLattice) -> None:
        self._raster, self._cells = raster, cells
        self.stats = {"cells": int(codes.size), "objects": int((codes == OBJECT).sum())}
        if raster is not None:
            self._codes = np.zeros(raster.heights.size, np.uint8)
            self._codes[raster.keys] = codes

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
