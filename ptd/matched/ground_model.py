"""Classification of the points of photogrammetric clouds by their height above the ground surface."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.frame import CellLattice, Scale
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED
from ptd.ground.morphology import Bool
from ptd.kernel import as_int64, kernel
from ptd.matched import cell_features, last_look, surface, voting
from ptd.matched.cells import EMPTY, CellHeights
from ptd.matched.decision_trees import last_look_trees
from ptd.matched.place_figures import DENSITY, known
from ptd.matched.step import noise_m
from ptd.passes import Int32, Model, Points, State, Stats, UInt8
from ptd.places import PLACES, Field, field

GROUND_M, GROUND_SIGMAS = 0.15, 2.0
"""Largest distance of ground from the surface after the vote: metres, plus this multiple of the
local noise."""
LOW_M, LOW_SIGMAS = 0.5, 4.0
"""Depth below the surface beyond which a point is low noise: metres, plus this multiple of the
local noise."""
CLEAR_M = 2.0
"""Points at least this far above or below the surface do not vote."""

Float64 = npt.NDArray[np.float64]


def vote_radius_m(state: State, scale: Scale) -> Field:
    """Return the radius in metres of the neighbourhood that votes, which follows from the density of the place."""
    radii = {
        name: [voting.radius_m(known(figures, DENSITY))]
        for name, figures in state[PLACES].items()
    }
    return field(radii, 0, scale, voting.RADIUS_M[1])


class RasterPosition(NamedTuple):
    """Position of a raster: origin of the local counts, size of a cell in counts, and first column and row."""

    origin_x: int
    origin_y: int
    cell: float
    column: int
    row: int


class _Limits(NamedTuple):
    """Fields of the `Surface` and the value of `GROUND_M` that limit the distance of ground from the surface."""

    sigma: Float64
    narrowing: Float64
    ground_m: float


@dataclass(frozen=True)
class Ground:
    """The ground surface of a window, and the settings of the comparison with points.

    Attributes
    ----------
    surface : Surface
    position : RasterPosition
        Position of the surface's raster.
    scale : Scale
    sigma_m, radius_m : Field
        Noise and radius of the vote in metres, by place.
    hidden : bool [rows, columns] or None
        Cells without ground, because a canopy hides it.
    around : Around or None
        Features of the cells around each point for the last look; None: there is no last look.
    """

    surface: surface.Surface
    position: RasterPosition
    scale: Scale
    sigma_m: Field
    radius_m: Field
    hidden: Bool | None = None
    around: cell_features.Around | None = None

    def classes(self, x: Int32, y: Int32, z: Int32) -> UInt8:
        """Classify points: ground if a point and its neighbours lie near the surface. Returns ASPRS classes."""
        counts_per_metre = self.scale.counts_z(1.0)
        parts_per_metre = voting.PARTS * counts_per_metre
        height, sigma, narrowing = self.surface
        above, residual = _heights_above(
            x, y, z, height, self.position, counts_per_metre, parts_per_metre
        )
        asked = np.abs(above) < CLEAR_M  # NaN, where there is no surface, gives False.
        voted = voting.votes(x, y, residual, asked, self.radius_m, self.sigma_m, self.scale)
        limits = _Limits(sigma, narrowing, GROUND_M)
        labels = _classes(x, y, above, voted, limits, self.position, parts_per_metre)
        cell = _cell_of(x, y, self.position, *height.shape)
        if self.around is not None:
            heights = last_look.Heights.of(
                x, y, above, np.where(asked, voted / parts_per_metre, above), labels
            )
            labels = last_look.relabelled(
                heights, cell, self.around, self.scale, last_look_trees()
            )
        if self.hidden is not None:
            labels[(labels == GROUND) & self.hidden.reshape(-1)[cell]] = UNCLASSIFIED
        return labels


class GroundModel(Model):
    """Model that compares points with the ground surface, if there is one."""

    def __init__(self, ground: Ground | None, stats: Stats) -> None:
        self._ground, self.stats = ground, stats

    @classmethod
    def of(
        cls,
        found: surface.Surface,
        raster: CellHeights,
        cells: CellLattice,
        scale: Scale,
        state: State,
        hidden: Bool | None = None,
    ) -> GroundModel:
        """Return the model of a surface on the cells of a raster, without ground in hidden cells."""
        position = RasterPosition(
            cells.origin_x, cells.origin_y, cells.p / cells.q, raster.column, raster.row
        )
        ground = Ground(
            found, position, scale, noise_m(state, scale), vote_radius_m(state, scale), hidden
        )
        return cls(ground, {"cells": int(raster.keys.size)})

    def with_last_look(self, raster: CellHeights, cell_m: float) -> GroundModel:
        """Return the same model with a last look at each point."""
        if self._ground is None:
            return self
        ground, fitted_surface = self._ground, self._ground.surface
        there = raster.heights != EMPTY
        band_m = band(
            fitted_surface.sigma,
            np.where(
                np.isnan(fitted_surface.narrowing), surface.NARROWEST, fitted_surface.narrowing
            ),
        )
        around = cell_features.around_cells(
            raster.heights / ground.scale.counts_z(1.0),
            there,
            fitted_surface.height,
            fitted_surface.sigma,
            band_m,
            cell_m,
        )
        return GroundModel(replace(ground, around=around), self.stats)

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Return ASPRS classes. All are certified, because the pass has a fixed radius."""
        uncertified = np.zeros(len(points), np.bool_)
        if self._ground is None or len(points) == 0:
            return np.full(len(points), UNCLASSIFIED, np.uint8), uncertified
        return self._ground.classes(*points.columns()), uncertified


@kernel
def _between(values: Float64, x: int, y: int, position: RasterPosition) -> float:
    """Interpolate a raster bilinearly at a point.

    The result is NaN outside the raster and next to cells without a value.
    """
    column = (x + position.origin_x) / position.cell - position.column - 0.5
    row = (y + position.origin_y) / position.cell - position.row - 0.5
    i, j = int(np.floor(row)), int(np.floor(column))
    if not (0 <= i < values.shape[0] - 1 and 0 <= j < values.shape[1] - 1):
        return np.nan
    v, u = row - i, column - j
    lower = values[i, j] * (1.0 - u) + values[i, j + 1] * u
    upper = values[i + 1, j] * (1.0 - u) + values[i + 1, j + 1] * u
    return float(lower * (1.0 - v) + upper * v)


def band(sigma: Float64, narrowing: Float64) -> Float64:
    """Return the largest distance of ground from the surface in metres."""
    band_m: Float64 = (GROUND_M + GROUND_SIGMAS * sigma) * narrowing
    return band_m


@kernel
def _cell_of(x: Int32, y: Int32, position: RasterPosition, rows: int, columns: int) -> Int32:
    """Return the index of each point's cell in the flattened raster, or of the nearest cell for points outside."""
    cell_indices = np.empty(x.size, np.int32)
    for k in range(x.size):
        column = (
            int(np.floor((as_int64(x[k]) + position.origin_x) / position.cell))
            - position.column
        )
        row = int(np.floor((as_int64(y[k]) + position.origin_y) / position.cell)) - position.row
        cell_indices[k] = min(max(row, 0), rows - 1) * columns + min(
            max(column, 0), columns - 1
        )
    return cell_indices


@kernel
def _heights_above(
    x: Int32,
    y: Int32,
    z: Int32,
    surface: Float64,
    position: RasterPosition,
    counts_per_metre: float,
    parts_per_metre: float,
) -> tuple[Float64, Int32]:
    """Return the height of each point above the surface in metres, and in whole parts of a vertical count.

    There are `voting.PARTS` parts in a count. The first is NaN where there is no surface, and the second is 0 at
    `CLEAR_M` or more from it.
    """
    above, residual = np.empty(x.size, np.float64), np.zeros(x.size, np.int32)
    for k in range(x.size):
        above[k] = z[k] / counts_per_metre - _between(
            surface, as_int64(x[k]), as_int64(y[k]), position
        )
        if abs(above[k]) < CLEAR_M:
            residual[k] = np.int32(np.rint(above[k] * parts_per_metre))
    return above, residual


@kernel
def _classes(
    x: Int32,
    y: Int32,
    above: Float64,
    voted: Int32,
    limits: _Limits,
    position: RasterPosition,
    parts_per_metre: float,
) -> UInt8:
    """Return ASPRS classes of points from their heights above the surface, or from the vote for points near it."""
    sigma, narrowing, ground_m = limits
    classes = np.full(x.size, UNCLASSIFIED, np.uint8)
    for k in range(x.size):
        near = abs(above[k]) < CLEAR_M
        height = voted[k] / parts_per_metre if near else above[k]
        if not (near or height < 0.0):
            continue
        noise = _between(sigma, as_int64(x[k]), as_int64(y[k]), position)
        if height < -(LOW_M + LOW_SIGMAS * noise):
            classes[k] = LOW_NOISE
        elif near:
            band = (ground_m + GROUND_SIGMAS * noise) * _between(
                narrowing, as_int64(x[k]), as_int64(y[k]), position
            )
            if abs(height) < band:
                classes[k] = GROUND
    return classes
