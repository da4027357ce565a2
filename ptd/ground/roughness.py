"""Noise of a cloud's heights: root mean square of the residuals of planes (Dong 2018, eq. 1), and its density.

The paper averages nine patches picked by hand. Here patches are the cells of a lattice of
`PATCH_M` anchored at CRS coordinate 0. A patch counts if it passes three tests:

- *Many* points: at least `MIN_POINTS`, and `MIN_POINTS_PER_QUARTER` in each quarter of the
  cell.
- *Planar*: the root mean square of the residuals is at most `MAX_SIGMA_M`, and no residual
  exceeds `MAX_RESIDUAL` times the root mean square. The residual variance of separate planes
  for the quarters is at least `MIN_VARIANCE_SHARE` of that of the one plane, so a bend or a
  step is less than the noise.
- *Ground*: the plane is no steeper than 45 degrees, and no patch within `REACH_CELLS` cells
  lies more than `DROP_M` below it.

There is no noise value if less than a share `MIN_SHARE` of the cells with `MIN_POINTS` pass the
other tests.

The noise is the lower quartile of the patches' values (`ptd.ground.noise_sums`). Lawns, fields
and low plants pass all tests and may be most of the patches, while no patch is smoother than a
hard surface. Sums are of integers, and each patch belongs to the core with its first point, so
neither tiles nor the order of points change the result.

Deviations from eq. 1: the sum of squares is divided by N - 3, not N (a fitted plane follows its
points), and the average is a quartile.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.cells import Xyz, cell_keys, occupied
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.noise_sums import (
    BIN_M,
    MAX_SIGMA_M,
    PATCH_M,
    PatchCounts,
    PlaceCounts,
    histogram,
)
from ptd.ground.slopes import MOMENTS, add_point, fit_plane
from ptd.kernel import kernel
from ptd.places import PLACE_M

MIN_POINTS = 16
MIN_POINTS_PER_QUARTER = 4
MAX_RESIDUAL = 4.5
MIN_VARIANCE_SHARE = 0.5
STEEPEST = 1.0
DROP_M = 2.0
REACH_CELLS = 5
REACH_M = PATCH_M * (REACH_CELLS + 1)
"""Margin around the core that a window needs so that `measure` gives the same result with any
tiles."""
MIN_QUARTER_PLANE_POINTS = 12
"""Least number of points in a quarter of a patch for measuring its roughness by a plane."""
PATCHES_ACROSS = round(PLACE_M / PATCH_M)
TALLEST_M = 8.0
"""Largest height range of the points of a planar patch, which keeps the sums small."""


class _Moments(NamedTuple):
    """Sums over the points of each cell.

    The moments of each quarter, int64 [cells, 4, MOMENTS], are relative to the cell's
    south-western corner (x, y) and its lowest point. The first point of a cell is the
    southernmost one, or the westernmost of several.
    """

    x: Int64
    y: Int64
    low: Int64
    high: Int64
    sums: Int64
    first: Int64


@kernel
def _sums(
    points: Xyz,
    slot: Int64,
    corners: tuple[Int64, Int64],
    size: tuple[int, int],
    tallest: float,
) -> _Moments:
    """Compute the moments of cells of size p / q counts, only n and z for cells taller than a limit."""
    x, y, z = points
    corner_x, corner_y = corners
    p, q = size
    low, high = (
        np.full(corner_x.size, 2**40, np.int64),
        np.full(corner_x.size, -(2**40), np.int64),
    )
    sums = np.zeros((corner_x.size, 4, MOMENTS), np.int64)
    first = np.full(corner_x.size, -1, np.int64)
    for i in range(x.size):
        k = slot[i]
        low[k], high[k] = min(low[k], np.int64(z[i])), max(high[k], np.int64(z[i]))
        f = first[k]
        if f < 0 or y[i] < y[f] or (y[i] == y[f] and x[i] < x[f]):
            first[k] = i
    for i in range(x.size):
        k = slot[i]
        dx, dy, dz = (
            np.int64(x[i]) - corner_x[k],
            np.int64(y[i]) - corner_y[k],
            np.int64(z[i]) - low[k],
        )
        quarter = 2 * int(2 * q * dy >= p) + int(2 * q * dx >= p)
        if high[k] - low[k] <= tallest:
            add_point(sums[k, quarter], dx, dy, dz)
        else:
            sums[k, quarter, 0] += 1
            sums[k, quarter, 3] += dz
    return _Moments(corner_x, corner_y, low, high, sums, first)


@kernel
def _patches(
    moments: _Moments, whole: Int64, tallest: float, largest: float, z_ratio: float
) -> Float64:
    """Return the planes a, b, c of cells with many points that are planar, and their noise, in horizontal counts.

    The noise of all other cells is -1.
    """
    low, high, sums = moments.low, moments.high, moments.sums
    planes = np.zeros((low.size, 4))
    planes[:, 3] = -1.0
    for k in range(low.size):
        fewest = min(min(sums[k, 0, 0], sums[k, 1, 0]), min(sums[k, 2, 0], sums[k, 3, 0]))
        if high[k] - low[k] > tallest or fewest < MIN_POINTS_PER_QUARTER:
            continue
        n = whole[k, 0]
        if n < MIN_POINTS:
            continue
        a, b, c, squares = fit_plane(whole[k], z_ratio)
        variance = squares / (n - 3)
        cos = 1.0 / math.sqrt(1.0 + a * a + b * b)
        if (
            squares < 0.0
            or math.sqrt(variance) * cos > largest
            or a * a + b * b > STEEPEST * STEEPEST
        ):
            continue
        parts = 0.0
        for quarter in range(4):
            left = fit_plane(sums[k, quarter], z_ratio)[3]
            parts = parts + left if left >= 0.0 and parts >= 0.0 else -1.0
        if parts / (n - 12 if n > 12 else 1) < MIN_VARIANCE_SHARE * variance and squares > 0.0:
            continue
        planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3] = (
            a,
            b,
            c,
            math.sqrt(variance) * cos,
        )
    return planes


@kernel
def _quarters(sums: Int64, z_ratio: float) -> Float64:
    """Return the root mean square of the vertical residuals of quarters from their planes, or -1 for too few points."""
    noise = np.full((sums.shape[0], 4), -1.0)
    for k in range(sums.shape[0]):
        for quarter in range(4):
            n = sums[k, quarter, 0]
            if n < MIN_QUARTER_PLANE_POINTS or sums[k, quarter, 9] == 0:
                continue
            squares = fit_plane(sums[k, quarter], z_ratio)[3]
            if squares >= 0.0:
                noise[k, quarter] = math.sqrt(squares / (n - 3))
    return noise


@kernel
def _drop_bent(
    points: Xyz, slot: Int64, moments: _Moments, planes: Float64, z_ratio: float
) -> None:
    """Remove the patches with a point beyond `MAX_RESIDUAL` times the noise."""
    x, y, z = points
    worst = np.zeros(planes.shape[0])
    for i in range(x.size):
        k = slot[i]
        a, b, c, noise = planes[k]
        if noise < 0.0:
            continue
        level = a * (x[i] - moments.x[k]) + b * (y[i] - moments.y[k]) + c
        vertical = (z[i] - moments.low[k]) * z_ratio - level
        worst[k] = max(worst[k], abs(vertical) / math.sqrt(1.0 + a * a + b * b))
    for k in range(worst.size):
        if worst[k] > MAX_RESIDUAL * planes[k, 3]:
            planes[k, 3] = -1.0


@kernel
def _is_ground(
    keys: Int64,
    width: int,
    moments: _Moments,
    whole: Int64,
    planes: Float64,
    size: float,
    drop: float,
    z_ratio: float,
) -> Bool:
    """Return a mask of the patches that are ground.

    A patch is not ground if the mean height of a nearby cell with many points is far below its
    plane.
    """
    low = moments.low
    ground = planes[:, 3] >= 0.0
    for k in range(keys.size):
        if not ground[k]:
            continue
        a, b, c, _ = planes[k]
        for row in range(-REACH_CELLS, REACH_CELLS + 1):
            j = np.searchsorted(keys, keys[k] + row * width - REACH_CELLS)
            while j < keys.size and keys[j] <= keys[k] + row * width + REACH_CELLS:
                if whole[j, 0] >= MIN_POINTS:
                    mean = (whole[j, 3] / whole[j, 0] + (low[j] - low[k])) * z_ratio
                    px, py = (
                        moments.x[j] - moments.x[k] + size / 2,
                        moments.y[j] - moments.y[k] + size / 2,
                    )
                    if mean < a * px + b * py + c - drop:
                        ground[k] = False
                j += 1
    return ground


class Patches(NamedTuple):
    """Cells of `PATCH_M` with points in the core of a window.

    Attributes
    ----------
    columns, rows : int64 [m]
        Column and row of each cell on the lattice.
    points : int64 [m]
        Number of the cell's points in the core.
    own : bool [m]
        Whether the core contains the cell's first point, so that the figures of the cell are counted here.
    full : bool [m]
        Whether the cell has at least `MIN_POINTS` points.
    noise : int64 [m]
        Bin of `BIN_M` of the residuals from the cell's plane; -1 if it is not a planar patch of ground.
    quarters : int64 [m, 4]
        Bins of the residuals from the planes of the quarters; -1 for too few points or too rough quarters.
    """

    columns: Int64
    rows: Int64
    points: Int64
    own: Bool
    full: Bool
    noise: Int64
    quarters: Int64

    def counts(self, which: Any = slice(None)) -> PatchCounts:
        """Return the counts that some cells add to the run's figures."""
        is_in_core = self.own[which]
        return {
            "points": int(self.points[which].sum()),
            "cells": int(is_in_core.sum()),
            "full": int(np.count_nonzero(self.full[which][is_in_core])),
            "patches": histogram(self.noise[which][is_in_core]),
            "quarters": histogram(self.quarters[which][is_in_core].ravel()),
        }


def patches(xyz: Int32, core: Window, scale: Scale) -> Patches:
    """Measure the cells of a core, by rows. `measure` describes the parameters."""
    points = Xyz(*(np.ascontiguousarray(c) for c in xyz))
    x, y = points.x, points.y
    if x.size == 0:
        none, never = np.zeros(0, np.int64), np.zeros(0, np.bool_)
        return Patches(none, none, none, never, never, none, np.zeros((0, 4), np.int64))
    cells = CellLattice.of(PATCH_M, scale)
    inside = core.contains(x, y)
    # With a margin around the occupied cells, a key beyond the raster is never a cell
    # of another row.
    col0, row0, width, height = cells.extent(x, y, REACH_CELLS)
    keys, slot = occupied(cell_keys(x, y, cells, col0, row0, width), width * height)
    columns, rows = keys % width + col0, keys // width + row0
    corners = cells.corners(columns, rows)
    tallest, ratio = scale.counts_z(TALLEST_M), scale.z_ratio
    moments = _sums(points, slot, corners, (cells.p, cells.q), tallest)
    whole = moments.sums.sum(axis=1)
    planes = _patches(moments, whole, tallest, scale.counts(MAX_SIGMA_M), ratio)
    _drop_bent(points, slot, moments, planes, ratio)
    size, drop = scale.counts(PATCH_M), scale.counts(DROP_M)
    ground = _is_ground(keys, width, moments, whole, planes, size, drop, ratio)
    held = np.bincount(slot[inside], minlength=keys.size) if core.closed else whole[:, 0]
    quarters = _quarters(moments.sums[held > 0], ratio)
    quarters[quarters >= scale.counts(MAX_SIGMA_M)] = -1.0
    noise = np.where(ground, planes[:, 3], -1.0)
    some = held > 0
    return Patches(
        columns[some],
        rows[some],
        held[some],
        inside[moments.first][some],
        whole[some, 0] >= MIN_POINTS,
        _bins(noise[some], scale),
        _bins(quarters, scale),
    )


def measure(xyz: Int32, window: Window, core: Window, scale: Scale) -> PatchCounts:
    """Return the counts that the core of a window adds to the run's figures.

    Parameters
    ----------
    xyz : int32 [3, n]
        Local counts of all points of the window, in any order.
    window, core : Window
        The window extends at least `REACH_M` beyond the core.
    scale : Scale
    """
    return patches(xyz, core, scale).counts()


def _bins(noise: Float64, scale: Scale) -> Int64:
    """Return the bins of noise values in horizontal counts, or -1 for negative values."""
    return np.where(noise < 0.0, -1, noise / scale.counts(BIN_M)).astype(np.int64)


def measure_places(xyz: Int32, core: Window, scale: Scale) -> list[PlaceCounts]:
    """Return the counts that the core of a window adds to each place that it touches.

    `ptd.ground.roughness.measure` describes the parameters.
    """
    measured_patches = patches(xyz, core, scale)
    columns, rows = (
        measured_patches.columns // PATCHES_ACROSS,
        measured_patches.rows // PATCHES_ACROSS,
    )
    order = np.lexsort((columns, rows))
    other = (np.diff(columns[order]) != 0) | (np.diff(rows[order]) != 0)
    parts = np.split(order, np.flatnonzero(other) + 1) if order.size else []
    return [
        {"place": [int(columns[part[0]]), int(rows[part[0]])], **measured_patches.counts(part)}
        for part in parts
    ]
