"""Points of matched clouds against the ground's surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.frame import CellLattice, Scale
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED
from ptd.ground.morphology import Bool
from ptd.kernel import as_int64, kernel
from ptd.matched import last_look, surface, voting
from ptd.matched.cells import EMPTY, CellHeights
from ptd.matched.place_figures import DENSITY, known
from ptd.matched.step import noise_m
from ptd.matched.trees import last_look_trees
from ptd.passes import Int32, Model, Points, State, UInt8
from ptd.places import PLACES, Field, field

GROUND_M, GROUND_SIGMAS = 0.15, 2.0
"""After the vote, ground lies nearer to the surface than this and so many times the local noise."""
LOW_M, LOW_SIGMAS = 0.5, 4.0
"""What lies lower is low noise."""
CLEAR_M = 2.0
"""What lies higher or lower by more has no part in the vote."""

Float64 = npt.NDArray[np.float64]


def vote_radius_m(state: State, scale: Scale) -> Field:
    """Radius of the neighbourhood whose points vote, by the density of the place."""
    radii = {name: [voting.radius_m(known(figures, DENSITY))] for name, figures in state[PLACES].items()}
    return field(radii, 0, scale, voting.RADIUS_M[1])


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
    sigma_m, radius_m : Field
        Noise, and radius of the vote, of the place.
    around : Around or None
        What a last look at each point knows of the cells around it; None: no last look.
    """

    surface: surface.Surface
    place: Place
    scale: Scale
    sigma_m: Field
    radius_m: Field
    around: last_look.Around | None = None

    def classes(self, x: Int32, y: Int32, z: Int32) -> UInt8:
        """ASPRS classes: ground where a point and its neighbours lie about the surface."""
        metre = self.scale.counts_z(1.0)
        unit = voting.PARTS * metre
        height, sigma, narrowing = self.surface
        above, residual = _heights_above(x, y, z, height, self.place, metre, unit)
        asked = np.abs(above) < CLEAR_M  # False where there is no surface
        voted = voting.votes(x, y, residual, asked, self.radius_m, self.sigma_m, self.scale)
        labels = _classes(x, y, above, voted, sigma, narrowing, self.place, unit, GROUND_M)
        if self.around is None:
            return labels
        heights = last_look.Heights.of(x, y, above, np.where(asked, voted / unit, above), labels)
        cell = _cell_of(x, y, self.place, *height.shape)
        return last_look.looked_at(heights, cell, self.around, self.scale, last_look_trees())


class GroundModel(Model):
    """Points against the surface, if there is one."""

    def __init__(self, ground: Ground | None, stats: dict[str, Any]) -> None:
        self._ground, self.stats = ground, stats

    @classmethod
    def of(
        cls, found: surface.Surface, raster: CellHeights, cells: CellLattice, scale: Scale, state: State
    ) -> GroundModel:
        """A surface of the cells of a raster."""
        place = Place(cells.origin_x, cells.origin_y, cells.p / cells.q, raster.column, raster.row)
        ground = Ground(found, place, scale, noise_m(state, scale), vote_radius_m(state, scale))
        return cls(ground, {"cells": int(raster.keys.size)})

    def with_last_look(self, raster: CellHeights, cell_m: float) -> GroundModel:
        """The same ground, with a last look at each point."""
        if self._ground is None:
            return self
        ground, found = self._ground, self._ground.surface
        there = raster.heights != EMPTY
        band_m = band(found.sigma, np.where(np.isnan(found.narrowing), surface.NARROWEST, found.narrowing))
        around = last_look.around_cells(
            raster.heights / ground.scale.counts_z(1.0), there, found.height, found.sigma, band_m, cell_m
        )
        return GroundModel(replace(ground, around=around), self.stats)

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


def band(sigma: Float64, narrowing: Float64) -> Float64:
    """How far ground lies from the surface, in metres."""
    found: Float64 = (GROUND_M + GROUND_SIGMAS * sigma) * narrowing
    return found


@kernel
def _cell_of(x: Int32, y: Int32, place: Place, rows: int, columns: int) -> Int32:
    """The place of each point in a raster taken row by row; that of the nearest cell beyond it."""
    found = np.empty(x.size, np.int32)
    for k in range(x.size):
        column = int(np.floor((as_int64(x[k]) + place.origin_x) / place.side)) - place.column
        row = int(np.floor((as_int64(y[k]) + place.origin_y) / place.side)) - place.row
        found[k] = min(max(row, 0), rows - 1) * columns + min(max(column, 0), columns - 1)
    return found


@kernel
def _heights_above(
    x: Int32, y: Int32, z: Int32, surface: Float64, place: Place, metre: float, unit: float
) -> tuple[Float64, Int32]:
    """Height of each point above the surface in metres (NaN: there is none), and in whole units (0 far from it)."""
    above, residual = np.empty(x.size, np.float64), np.zeros(x.size, np.int32)
    for k in range(x.size):
        above[k] = z[k] / metre - _between(surface, as_int64(x[k]), as_int64(y[k]), place)
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
        noise = _between(sigma, as_int64(x[k]), as_int64(y[k]), place)
        if height < -(LOW_M + LOW_SIGMAS * noise):
            classes[k] = LOW_NOISE
        elif near:
            band = (ground_m + GROUND_SIGMAS * noise) * _between(
                narrowing, as_int64(x[k]), as_int64(y[k]), place
            )
            if abs(height) < band:
                classes[k] = GROUND
    return classes
