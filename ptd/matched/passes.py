"""The passes of matched clouds: a height per cell, large objects, and points against the ground's surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.frame import Cells, Scale, Window
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED
from ptd.ground.morphology import Bool
from ptd.kernel import kernel, wide
from ptd.matched import objects, surface, voting
from ptd.matched.cells import (
    CELL_M,
    SPARSE_CELL_M,
    Raster,
    cell_heights,
    cell_side_m,
    raster_of,
)
from ptd.matched.hull import ROOFS_TILT_BLOCKS, hull_below
from ptd.passes import Int32, Model, Pass, Points, State, UInt8

LEFT, TERRAIN, OBJECT = 1, 2, 3
"""Codes of cells between passes: of a surface that may be either, of terrain, of a large object."""
GROUND_M, GROUND_SIGMAS = 0.15, 2.0
"""After the vote, ground lies nearer to the surface than this and so many times the local noise."""
LOW_M, LOW_SIGMAS = 0.5, 4.0
"""What lies lower is low noise."""
SIDES_M = (CELL_M, SPARSE_CELL_M)
"""Sides that cells have: the reach of a pass is that of either."""
CLEAR_M = 2.0
"""What lies higher or lower by more has no part in the vote."""

Float64 = npt.NDArray[np.float64]


def is_matched(state: State) -> bool:
    """Whether the survey took the run for image matching."""
    return bool(state["survey"]["kind"] == "dim")


def noise_m(state: State) -> float:
    """The noise of the run that the cells' rules start from."""
    return float(state["survey"]["cell_sigma_m"])


def cell_m(state: State) -> float:
    """Side of the cells of the run."""
    return cell_side_m(float(state["survey"]["density_m2"]))


@dataclass(frozen=True)
class MatchedPass(Pass):
    """A pass that only matched clouds need."""

    kind = "dim"

    def applies(self, state: State) -> bool:
        """Only where the survey says so; before it, nothing is known."""
        return "survey" in state and is_matched(state)


@dataclass(frozen=True)
class CellPass(MatchedPass):
    """A robust height for each cell: the points on which the next passes work."""

    name: str = "cells"
    title = "one height for each cell"
    every_point: bool = True
    gives_labels: bool = False
    elects: bool = True
    reach_m: float | None = 2 * SPARSE_CELL_M

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> CellModel:
        """Find them all."""
        around = _widened(core, scale)
        return CellModel(cell_heights(points.xyz, around, scale, noise_m(state), cell_m(state)))


def _widened(core: Window, scale: Scale) -> Window:
    """The core and a little more: bounds of buckets may be asked for that are rounded otherwise."""
    more = round(scale.counts(0.5))
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
    raster_cell_m: float = CELL_M
    reach_m: float | None = max(
        (objects.reach_cells(side) + replace(surface.STIFF, cell_m=side).reach + 1) * side for side in SIDES_M
    )

    @property
    def title(self) -> str:  # type: ignore[override]
        """Once for those that stand alone, once for those within them."""
        return "find large objects" if self.name == "objects" else "find objects within others"

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> Codes:
        """Judge the surfaces of the cells that are left."""
        side = cell_m(state)
        cells = Cells.of(side, scale)
        known = points.known_labels()
        codes = np.where(known == OBJECT, np.uint8(OBJECT), np.uint8(LEFT))
        if len(points) == 0:
            return Codes(None, codes, cells)
        raster = raster_of(points.xyz, cells)
        if (known > 0).all() and not (known == OBJECT).any():
            return Codes(raster, known, cells)  # nothing was found before, so nothing has changed
        before = np.zeros(raster.heights.size, np.bool_)
        before[raster.keys[codes == OBJECT]] = True
        removed = before.reshape(raster.heights.shape)
        rule = replace(surface.STIFF, cell_m=side)
        hull = hull_below(raster.heights, rule, scale, raster.row, raster.column, ROOFS_TILT_BLOCKS)
        large, terrain = objects.judged(raster.heights, hull, removed, noise_m(state), scale, side)
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
    title = "fit the surface, label all points"
    columns: tuple[str, ...] = ("labels",)
    elected: bool = True
    raster_cell_m: float = CELL_M
    reach_m: float | None = max((surface.reach_cells(side) + 3) * side for side in SIDES_M)
    label_margin_m: float = voting.REACH_M

    def fit(self, points: Points, window: Window, core: Window, scale: Scale, state: State) -> GroundModel:
        """Make the surface of the cells that are no large object's."""
        cells, codes = Cells.of(cell_m(state), scale), points.known_labels()
        left = codes != OBJECT
        if not left.any():
            return GroundModel(None, {"cells": 0})
        raster = raster_of(points.xyz[:, left], cells)
        flat = np.zeros(raster.heights.size, np.bool_)
        flat[raster.keys] = codes[left] == TERRAIN
        terrain = flat.reshape(raster.heights.shape)
        found = surface.ground_surface(
            raster.heights, terrain, noise_m(state), scale, raster.row, raster.column, cell_m(state)
        )
        return GroundModel.of(found, raster, cells, scale, state)


class Place(NamedTuple):
    """Where a raster lies: origin of the local counts, counts on a cell's side, and its first column and row."""

    origin_x: int
    origin_y: int
    side: float
    column: int
    row: int


@dataclass(frozen=True)
class Ground:
    """The surface of a window, and what points are compared with it by.

    Attributes
    ----------
    surface : Surface
    place : Place
    scale : Scale
    sigma_m, density_m2 : float
        Of the run.
    """

    surface: surface.Surface
    place: Place
    scale: Scale
    sigma_m: float
    density_m2: float

    def classes(self, x: Int32, y: Int32, z: Int32) -> UInt8:
        """ASPRS classes: ground where a point and its neighbours lie about the surface."""
        metre = self.scale.counts_z(1.0)
        unit = voting.PARTS * metre
        height, sigma, narrowing = self.surface
        above, residual = _heights_above(x, y, z, height, self.place, metre, unit)
        asked = np.abs(above) < CLEAR_M  # False where there is no surface
        voted = voting.votes(x, y, residual, asked, self.density_m2, self.sigma_m, self.scale)
        return _classes(x, y, above, voted, sigma, narrowing, self.place, unit, GROUND_M)


class GroundModel(Model):
    """Points against the surface, if there is one."""

    def __init__(self, ground: Ground | None, stats: dict[str, Any]) -> None:
        self._ground, self.stats = ground, stats

    @classmethod
    def of(
        cls, found: surface.Surface, raster: Raster, cells: Cells, scale: Scale, state: State
    ) -> GroundModel:
        """A surface of the cells of a raster."""
        place = Place(cells.origin_x, cells.origin_y, cells.p / cells.q, raster.column, raster.row)
        ground = Ground(found, place, scale, noise_m(state), float(state["survey"]["density_m2"]))
        return cls(ground, {"cells": int(raster.keys.size)})

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """ASPRS classes; nothing is ever in doubt, as the pass has a reach."""
        certain = np.zeros(len(points), np.bool_)
        if self._ground is None or len(points) == 0:
            return np.full(len(points), UNCLASSIFIED, np.uint8), certain
        return self._ground.classes(*points.columns()), certain


@kernel
def _between(values: Float64, x: int, y: int, place: Place) -> float:
    """A value of a raster at a point, bilinear; NaN outside of it, and beside cells without a value."""
    column = (x + place.origin_x) / place.side - place.column - 0.5
    row = (y + place.origin_y) / place.side - place.row - 0.5
    i, j = int(np.floor(row)), int(np.floor(column))
    if not (0 <= i < values.shape[0] - 1 and 0 <= j < values.shape[1] - 1):
        return np.nan
    v, u = row - i, column - j
    lower = values[i, j] * (1.0 - u) + values[i, j + 1] * u
    upper = values[i + 1, j] * (1.0 - u) + values[i + 1, j + 1] * u
    return float(lower * (1.0 - v) + upper * v)


@kernel
def _heights_above(
    x: Int32, y: Int32, z: Int32, surface: Float64, place: Place, metre: float, unit: float
) -> tuple[Float64, Int32]:
    """Height of each point above the surface in metres (NaN: there is none), and in whole units (0 far from it)."""
    above, residual = np.empty(x.size, np.float64), np.zeros(x.size, np.int32)
    for k in range(x.size):
        above[k] = z[k] / metre - _between(surface, wide(x[k]), wide(y[k]), place)
        if abs(above[k]) < CLEAR_M:
            residual[k] = np.int32(np.rint(above[k] * unit))
    return above, residual


@kernel
def _classes(
    x: Int32, y: Int32, above: Float64, voted: Int32, sigma: Float64, narrowing: Float64, place: Place, unit: float,
    ground_m: float,
) -> UInt8:  # fmt: skip
    """ASPRS classes of points from their heights above the surface, and from what their neighbours voted near it."""
    classes = np.full(x.size, UNCLASSIFIED, np.uint8)
    for k in range(x.size):
        near = abs(above[k]) < CLEAR_M
        height = voted[k] / unit if near else above[k]
        if not (near or height < 0.0):
            continue
        noise = _between(sigma, wide(x[k]), wide(y[k]), place)
        if height < -(LOW_M + LOW_SIGMAS * noise):
            classes[k] = LOW_NOISE
        elif near:
            band = (ground_m + GROUND_SIGMAS * noise) * _between(narrowing, wide(x[k]), wide(y[k]), place)
            if abs(height) < band:
                classes[k] = GROUND
    return classes


PASSES: tuple[Pass, ...] = (CellPass(), ObjectPass(), ObjectPass(name="inner-objects"), SurfacePass())
