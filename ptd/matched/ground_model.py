"""Classification of the points of photogrammetric clouds by their height above the ground surface.

Neighbours vote on this height first (`votes`): noise moves a point, not its neighbourhood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Float64, Int32, Int64, UInt8
from ptd.cells import cell_keys
from ptd.frame import CellLattice, Scale
from ptd.ground.labelling import GROUND, LOW_NOISE, UNCLASSIFIED
from ptd.kernel import as_int64, kernel
from ptd.matched import last_look, surface
from ptd.matched.cells import EMPTY, CellHeights, by_cell
from ptd.matched.last_look import last_look_trees
from ptd.matched.step import noise_m
from ptd.matched.survey import DENSITY, known
from ptd.passes import Model, Points, State, Stats
from ptd.places import PLACES, Field, as_field, field, values_at

PARTS = 16
"""Residuals are whole numbers of 1 / `PARTS` of a vertical count, so sums do not depend on the
order of points."""

NEIGHBOURS = 10.0
"""Average number of points within the radius of the neighbourhood."""
RADIUS_M = (0.25, 1.0)
"""Limits of the radius of the neighbourhood."""
ROUNDS = 2
ALIKE_M, ALIKE_SIGMAS = 0.05, 4.0
"""Difference below which residuals of neighbours are averaged: metres, plus this multiple of
the noise."""
REACH_M = ROUNDS * RADIUS_M[1]
"""Distance beyond which points do not change a point's label."""

STEP = 32
"""Multiple to which the neighbours of a cell are filled up, so that the loop processes several
at a time."""
ROUNDED = 1e-9
"""Largest difference of two lengths that count as equal."""
FAR = 2**30
"""Residual that is not alike any other."""
FINEST = 2**13
"""Positions are rounded so that the largest radius has at most this many units. If counts are
coarser than these units, positions stay in counts."""


def radius_m(density_m2: float) -> float:
    """Return the radius of the neighbourhood in metres, with two decimals so that cell sizes have few digits."""
    return round(
        min(
            max(math.sqrt(NEIGHBOURS / (math.pi * max(density_m2, 1e-9))), RADIUS_M[0]),
            RADIUS_M[1],
        ),
        2,
    )


class _Voters(NamedTuple):
    """Points sorted by the cells of a raster (`ptd.matched.cells.by_cell`), and the limits of their neighbours.

    Attributes
    ----------
    x, y : int32 [n]
        Positions of the points.
    starts : int64 [cells + 1]
        Index of each cell's first point.
    square : int32 [n]
        Square of the distance below which a point is a neighbour.
    alike : int32 [n]
        Difference of residuals below which a neighbour is averaged.
    reach : int64 [cells]
        Distance in cells within which points of a cell may have neighbours; 0 for an empty cell.
    """

    x: Int32
    y: Int32
    starts: Int64
    square: Int32
    alike: Int32
    reach: Int64


@kernel
def _averaged(voters: _Voters, residual: Int32, width: int) -> Int32:
    """Return the mean residual, rounded down, of each point and its neighbours with similar residuals.

    The possible neighbours of the points of a cell are copied to successive memory and filled up with dummies to a
    multiple of `STEP`, so that several are processed at a time. The raster has a margin as wide as the largest
    ``reach``.
    """
    x, y, starts, square, alike, reach = voters
    means = np.empty_like(residual)
    room = 32 * STEP
    near_x, near_y, near_residual = (
        np.empty(room, np.int32),
        np.empty(room, np.int32),
        np.empty(room, np.int32),
    )
    for key in range(reach.size):
        begin, end, far = starts[key], starts[key + 1], reach[key]
        if begin == end:
            continue
        n = 0
        for up in range(-far, far + 1):
            row = key + up * width
            n += starts[row + far + 1] - starts[row - far]
        if n + STEP > room:
            room = 2 * n + STEP
            near_x, near_y, near_residual = (
                np.empty(room, np.int32),
                np.empty(room, np.int32),
                np.empty(room, np.int32),
            )
        n = 0
        for up in range(-far, far + 1):
            row = key + up * width
            for j in range(starts[row - far], starts[row + far + 1]):
                near_x[n], near_y[n], near_residual[n] = x[j], y[j], residual[j]
                n += 1
        filled = (n + STEP - 1) // STEP * STEP
        for j in range(n, filled):
            near_x[j], near_y[j], near_residual[j] = x[begin], y[begin], FAR
        for i in range(begin, end):
            own_x, own_y, own_residual = x[i], y[i], residual[i]
            limit, most = square[i], alike[i]
            low, high, count = np.int32(0), np.int32(0), np.int32(0)
            # Without branches and in 32 bits, so the sum has two parts.
            for j in range(filled):
                dx, dy = np.int32(near_x[j] - own_x), np.int32(near_y[j] - own_y)
                difference = np.int32(near_residual[j] - own_residual)
                near = np.int32(np.int32(dx * dx) + np.int32(dy * dy)) < limit
                one = np.int32(near & (np.int32(abs(difference)) < most))
                low += np.int32(one * np.int32(difference & 4095))
                high += np.int32(one * np.int32(difference >> 12))
                count += one
            means[i] = own_residual + np.int32(
                math.floor((as_int64(high) * 4096 + low) / count)
            )
    return means


@kernel
def _limits(
    radius: Float64,
    noise: Float64,
    starts: Int64,
    order: Int32,
    counts: tuple[float, float, float],
) -> tuple[Int32, Int32, Int64]:
    """Return ``square``, ``alike`` and ``reach`` of `_Voters`.

    ``counts`` are the units of positions per metre, the units of residuals (`PARTS` of a vertical count) per metre, and
    the size of the cells in metres.
    """
    per_radius, per_metre, cell_m = counts
    square, alike = np.empty(order.size, np.int32), np.empty(order.size, np.int32)
    reach = np.zeros(starts.size - 1, np.int64)
    last_radius, last_noise, far, near, most = -1.0, -1.0, np.int64(0), np.int32(0), np.int32(0)
    for key in range(reach.size):
        for i in range(starts[key], starts[key + 1]):
            own_radius = radius[order[i] if radius.size > 1 else 0]
            own_noise = noise[order[i] if noise.size > 1 else 0]
            if own_radius != last_radius:  # The radius is the same nearly everywhere.
                last_radius = own_radius
                near = np.int32(np.rint((per_radius * last_radius) ** 2))
                far = np.int64(math.ceil(last_radius / cell_m - ROUNDED))
            if own_noise != last_noise:
                last_noise = own_noise
                most = np.int32(np.rint(per_metre * (ALIKE_M + ALIKE_SIGMAS * last_noise)))
            square[i], alike[i] = near, most
            reach[key] = max(reach[key], far)
    return square, alike, reach


def votes(
    x: Int32,
    y: Int32,
    residual: Int32,
    asked: Bool,
    radius_m: float | Field,
    sigma_m: float | Field,
    scale: Scale,
) -> Int32:
    """Return the residuals after the neighbours' vote: int32 [n].

    Parameters
    ----------
    x, y : int32 [n]
        Local counts.
    residual : int32 [n]
        Heights above the surface in `PARTS` of a vertical count.
    asked : bool [n]
        Points that take part in the vote; all others keep their residuals.
    radius_m, sigma_m : float or Field
        Radius of the neighbourhood (`radius_m`) and noise of the place, in metres.
    scale : Scale
    """
    asking = np.flatnonzero(asked)
    if asking.size == 0:
        return residual
    px, py = x[asking], y[asking]
    radius, noise = (  # a single figure if it is the same everywhere
        figure.values[0, :1].copy() if figure.even else values_at(figure, px, py)
        for figure in map(as_field, (radius_m, sigma_m))
    )
    least, widest = float(radius.min()), float(radius.max())
    cell_m = math.ceil(100.0 * widest / round(widest / least) - ROUNDED) / 100.0
    cells, most = CellLattice.of(cell_m, scale), math.ceil(widest / cell_m - ROUNDED)
    column, row, width, height = cells.extent(px, py, most)
    keys = cell_keys(px, py, cells, column, row, width)
    starts, order = by_cell(keys, width * height)
    # Larger squares would overflow.
    finer = max(math.ceil(math.log2(scale.counts(RADIUS_M[1]) / FINEST)), 0)
    per_radius, per_metre = scale.counts(1.0) / 2**finer, PARTS * scale.counts_z(1.0)
    square, alike, reach = _limits(
        radius, noise, starts, order, (per_radius, per_metre, cell_m)
    )
    voters = _Voters(px[order] >> finer, py[order] >> finer, starts, square, alike, reach)
    asking = asking[order]
    votes = residual[asking]
    for _ in range(ROUNDS):
        votes = _averaged(voters, votes, width)
    voted = residual.copy()
    voted[asking] = votes
    return voted


GROUND_M, GROUND_SIGMAS = 0.15, 2.0
"""Largest distance of ground from the surface after the vote: metres, plus this multiple of the
local noise."""
LOW_M, LOW_SIGMAS = 0.5, 4.0
"""Depth below the surface beyond which a point is low noise: metres, plus this multiple of the
local noise."""
CLEAR_M = 2.0
"""Points at least this far above or below the surface do not vote."""


def _vote_radius_m(state: State, scale: Scale) -> Field:
    """Return the radius in metres of the neighbourhood that votes, which follows from the density of the place."""
    radii = {
        name: [radius_m(known(figures, DENSITY))] for name, figures in state[PLACES].items()
    }
    return field(radii, 0, scale, RADIUS_M[1])


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
    around: last_look.Around | None = None

    def classes(self, x: Int32, y: Int32, z: Int32) -> UInt8:
        """Classify points: ground if a point and its neighbours lie near the surface. Returns ASPRS classes."""
        counts_per_metre = self.scale.counts_z(1.0)
        parts_per_metre = PARTS * counts_per_metre
        height, sigma, narrowing = self.surface
        above, residual = _heights_above(
            x, y, z, height, self.position, counts_per_metre, parts_per_metre
        )
        asked = np.abs(above) < CLEAR_M  # NaN, where there is no surface, gives False.
        voted = votes(x, y, residual, asked, self.radius_m, self.sigma_m, self.scale)
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
            found, position, scale, noise_m(state, scale), _vote_radius_m(state, scale), hidden
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
        around = last_look.around_cells(
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
    return (GROUND_M + GROUND_SIGMAS * sigma) * narrowing


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

    There are `PARTS` parts in a count. The first is NaN where there is no surface, and the second is 0 at
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
