"""The passes of matched clouds: a height per cell, large objects, and points against the ground's surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.frame import Cells, Scale, Window
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED
from ptd.ground.morphology import Bool
from ptd.kernel import kernel
from ptd.matched import objects, surface, voting
from ptd.matched.cells import CELL_M, EMPTY, Raster, cell_heights, raster_of
from ptd.matched.hull import hull_below
from ptd.passes import Int32, Model, Pass, Points, State, UInt8

LEFT, TERRAIN, OBJECT = 1, 2, 3
"""Codes of cells between passes: of a surface that may be either, of terrain, of a large object."""
GROUND_M, GROUND_SIGMAS = 0.2, 1.0
"""After the vote, ground lies so near the surface, and nearer by so many times the local noise more."""
LOW_M, LOW_SIGMAS = 0.5, 4.0
"""What lies lower is low noise."""
CLEAR_M = 2.0
"""What lies higher or lower by more has no part in the vote."""

Float64 = npt.NDArray[np.float64]


def is_matched(state: State) -> bool:
    """Whether the survey took the run for image matching."""
    return bool(state["survey"]["kind"] == "dim")


def noise_m(state: State) -> float:
    """The noise of the run that the cells' rules start from."""
    return float(state["survey"]["cell_sigma_m"])


@dataclass(frozen=True)
class MatchedPass(Pass):
    """A pass that only matched clouds need."""

    def applies(self, state: State) -> bool:
        """Only where the survey says so; before it, nothing is known."""
        return "survey" in state and is_matched(state)


@dataclass(frozen=True)
class CellPass(MatchedPass):
    """A robust height for each cell: the points on which the next passes work."""

    name: str = "cells"
    every_point: bool = True
    gives_labels: bool = False
    elects: bool = True
    reach_m: float | None = 4 * CELL_M

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> CellModel:
        """Find them all."""
        around = _widened(core, scale)
        return CellModel(cell_heights(points.xyz, around, scale, noise_m(state)))


def _widened(core: Window, scale: Scale) -> Window:
    """The core and a little more: bounds of buckets may be asked for that are rounded otherwise."""
    more = round(scale.counts(CELL_M))
    return Window(core.west - more, core.south - more, core.east + more, core.north + more)


class CellModel(Model):
    """Cells by rows."""

    def __init__(self, xyz: Int32) -> None:
        self._xyz, self.stats = xyz, {"cells": int(xyz.shape[1])}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Not called."""
        raise NotImplementedError("the pass gives no labels")

    def elect(self, bounds: Window) -> Int32:
        """The cells whose centres lie within bounds."""
        return np.ascontiguousarray(self._xyz[:, bounds.has(self._xyz[0], self._xyz[1])])


@dataclass(frozen=True)
class ObjectPass(MatchedPass):
    """Large objects as wholes; again for what stands within those that were found before."""

    name: str = "objects"
    columns: tuple[str, ...] = ("labels",)
    elected: bool = True
    reach_m: float | None = (objects.reach_cells() + surface.STIFF.reach + 1) * CELL_M

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Codes:
        """Judge the surfaces of the cells that are left."""
        cells = Cells.of(CELL_M, scale)
        codes = np.where(points.known_labels() == OBJECT, np.uint8(OBJECT), np.uint8(LEFT))
        if len(points) == 0:
            return Codes(None, codes, cells)
        raster = raster_of(points.xyz, cells)
        before = np.zeros(raster.heights.size, np.bool_)
        before[raster.keys[codes == OBJECT]] = True
        removed = before.reshape(raster.heights.shape)
        hull = hull_below(raster.heights, surface.STIFF, scale, raster.row, raster.column)
        left = np.where(removed, EMPTY, raster.heights).astype(np.int32)
        large, terrain = objects.judged(left, hull, removed, noise_m(state), scale)
        codes[large.reshape(-1)[raster.keys]] = OBJECT
        codes[terrain.reshape(-1)[raster.keys]] = TERRAIN
        return Codes(raster, codes, cells)


class Codes(Model):
    """What each cell is."""

    def __init__(self, raster: Raster | None, codes: UInt8, cells: Cells) -> None:
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


@dataclass(frozen=True)
class SurfacePass(MatchedPass):
    """The ground's surface, and every point against it."""

    name: str = "surface"
    columns: tuple[str, ...] = ("labels",)
    elected: bool = True
    reach_m: float | None = (surface.reach_cells() + 3) * CELL_M
    label_margin_m: float = voting.REACH_M

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> GroundModel:
        """Make the surface of the cells that are no large object's."""
        cells, codes = Cells.of(CELL_M, scale), points.known_labels()
        left = codes != OBJECT
        if not left.any():
            return GroundModel(None, None, cells, scale, state["survey"])
        raster = raster_of(points.xyz[:, left], cells)
        flat = np.zeros(raster.heights.size, np.bool_)
        flat[raster.keys] = codes[left] == TERRAIN
        terrain = flat.reshape(raster.heights.shape)
        found = surface.ground_surface(
            raster.heights, terrain, noise_m(state), scale, raster.row, raster.column
        )
        return GroundModel(raster, found, cells, scale, state["survey"])


class GroundModel(Model):
    """Points are ground where they and their neighbours lie about the surface."""

    def __init__(
        self,
        raster: Raster | None,
        found: surface.Surface | None,
        cells: Cells,
        scale: Scale,
        survey: Mapping[str, Any],
    ) -> None:
        self._raster, self._found, self._cells, self._scale, self._survey = (
            raster,
            found,
            cells,
            scale,
            survey,
        )
        self.stats = {"cells": 0 if raster is None else int(raster.keys.size)}

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """ASPRS classes; nothing is ever in doubt, as the pass has a reach."""
        certain = np.zeros(len(points), np.bool_)
        labels = np.full(len(points), UNCLASSIFIED, np.uint8)
        if self._raster is None or self._found is None or len(points) == 0:
            return labels, certain
        x, y, z = points.columns()
        place = self._places(x, y)
        above = z / self._scale.counts_z(1.0) - _between(self._found.height, *place)
        asked = np.abs(above) < CLEAR_M  # False where there is no surface
        unit = voting.PARTS * self._scale.counts_z(1.0)
        residual = np.where(asked, np.rint(np.nan_to_num(above) * unit), 0.0).astype(np.int64)
        sigma_m, density_m2 = float(self._survey["cell_sigma_m"]), float(self._survey["density_m2"])
        voted = voting.votes(x, y, residual, asked, density_m2, sigma_m, self._scale) / unit
        sigma, narrowing = _between(self._found.sigma, *place), _between(self._found.narrowing, *place)
        labels[asked & (np.abs(voted) < (GROUND_M + GROUND_SIGMAS * sigma) * narrowing)] = GROUND
        low = np.where(asked, voted, above) < -(LOW_M + LOW_SIGMAS * sigma)
        labels[low] = LOW_NOISE
        return labels, certain

    def _places(self, x: Int32, y: Int32) -> tuple[Float64, Float64]:
        """Rows and columns of the raster, in parts of a cell, from the centre of its first cell on."""
        assert self._raster is not None  # the caller looked
        side = self._cells.p / self._cells.q
        column = (x.astype(np.int64) + self._cells.origin_x) / side - self._raster.column - 0.5
        row = (y.astype(np.int64) + self._cells.origin_y) / side - self._raster.row - 0.5
        return row, column


@kernel
def _between(values: Float64, row: Float64, column: Float64) -> Float64:
    """Bilinear interpolation; NaN outside of the raster, and beside cells without a value."""
    rows, columns = values.shape
    found = np.full(row.size, np.nan)
    for k in range(row.size):
        i, j = int(np.floor(row[k])), int(np.floor(column[k]))
        if 0 <= i < rows - 1 and 0 <= j < columns - 1:
            v, u = row[k] - i, column[k] - j
            lower = values[i, j] * (1.0 - u) + values[i, j + 1] * u
            upper = values[i + 1, j] * (1.0 - u) + values[i + 1, j + 1] * u
            found[k] = lower * (1.0 - v) + upper * v
    return found


PASSES: tuple[Pass, ...] = (CellPass(), ObjectPass(), ObjectPass(name="inner-objects"), SurfacePass())
