"""What the passes of matched clouds share: when they apply, figures of the run, codes of cells between passes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ptd.frame import CellLattice, Scale, Window
from ptd.ground.morphology import Bool
from ptd.matched.cells import CellHeights
from ptd.matched.place_figures import CELL_SIGMA
from ptd.matched.survey import MIN_CELL_SIGMA_M
from ptd.passes import Model, Pass, Points, State, UInt8
from ptd.places import PLACES, Field, field

LEFT, TERRAIN, OBJECT = 1, 2, 3
"""Codes of cells between passes: of a surface that may be either, of terrain, of a large object."""
CODE, CROWN, COVERED = 3, 4, 8
"""The bits of these codes; the bit of crowns that were taken for ground, and that of places where a canopy hides it."""


def is_matched(state: State) -> bool:
    """Whether the survey took the run for image matching."""
    return bool(state["survey"]["kind"] == "dim")


def noise_m(state: State, scale: Scale) -> Field:
    """The noise of each place that the cells' rules start from."""
    return field(state[PLACES], CELL_SIGMA, scale, MIN_CELL_SIGMA_M)


def cell_m(state: State) -> float:
    """Side of the cells of the run, of methods that have one."""
    return float(state["survey"]["cell_m"])


@dataclass(frozen=True)
class MatchedPass(Pass):
    """A pass that only matched clouds need."""

    kind = "dim"

    def applies(self, state: State) -> bool:
        """Only where the survey says so; before it, nothing is known."""
        return "survey" in state and is_matched(state)


@dataclass(frozen=True)
class OneSidePass(MatchedPass):
    """A pass of a method whose cells have one side in a run."""

    def local(self, state: State, window: Window, scale: Scale) -> dict[str, Any]:
        """With that side."""
        found = super().local(state, window, scale)
        return {**found, "survey": {**found["survey"], "cell_m": cell_m(state)}}


class Codes(Model):
    """What each cell is."""

    def __init__(self, raster: CellHeights | None, codes: UInt8, cells: CellLattice) -> None:
        self._raster, self._cells = raster, cells
        self.stats = {"cells": int(codes.size), "objects": int((codes == OBJECT).sum())}
        if raster is not None:
            self._codes = np.zeros(raster.heights.size, np.uint8)
            self._codes[raster.keys] = codes

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Codes of cells; nothing is ever in doubt, as the pass has a reach."""
        certain = np.zeros(len(points), np.bool_)
        if self._raster is None or len(points) == 0:
            return np.zeros(len(points), np.uint8), certain
        columns, rows = self._cells.places(points.xyz[0], points.xyz[1])
        width = self._raster.heights.shape[1]
        return self._codes[(rows - self._raster.row) * width + columns - self._raster.column], certain
