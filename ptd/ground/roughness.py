"""Noise of a cloud's heights: root mean square of the residuals of planes (Dong 2018, eq. 1), and its density.

The paper averages nine patches picked by hand. Here patches are the cells of a lattice of `PATCH_M` anchored at CRS
coordinate 0, and those count that are

- *many*: at least `MIN_POINTS` points, `MIN_QUARTER` in each quarter of the cell, and of such cells a share of at least
  `LEAST_SHARE` passes;
- *planar*: residuals of at most `LARGEST_SIGMA_M`, none beyond `LARGEST_RESIDUAL` of their root mean square, and planes
  of the quarters leave at least `LEAST_QUARTERS` of their variance, so a bend or a step is less than the noise;
- *ground*: no steeper than 45 degrees, and no patch within `REACH_CELLS` cells lies more than `DROP_M` below the plane.

The run's noise is the lower quartile of the patches' values: lawns, fields and low plants pass all the tests of a plane
and may be most of them, while what is smoother than a hard surface is not found. Sums are of integers and each patch
belongs to the core that holds its first point, so neither tiles nor the order of points show.

Deviations from eq. 1: the sum of squares is divided by N - 3, not N (a fitted plane follows its points), and the
average is a quartile.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, Xyz, cell_keys, occupied
from ptd.frame import Cells, Scale, Window
from ptd.kernel import kernel, wide

PATCH_M = 4.0
MIN_POINTS = 16
MIN_QUARTER = 4
LARGEST_SIGMA_M = 0.3
LARGEST_RESIDUAL = 4.5
LEAST_QUARTERS = 0.5
STEEPEST = 1.0
DROP_M = 2.0
REACH_CELLS = 5
REACH_M = PATCH_M * (REACH_CELLS + 1)
"""What a window must hold around its core for `measure` to give the same with any tiles."""
LEAST_SHARE = 0.005
"""Least share of planar patches among cells with enough points: in a wood the few that look planar tell nothing."""
BIN_M = 0.001
CELL_POINTS = 12
"""Least points of a quarter of a patch whose plane says how rough it is."""
SMOOTHEST_SHARE, SMOOTHEST_FACTOR = 0.05, 1.25
"""Noise from what is smoothest, whatever stands on the ground: this quantile of all quarters of patches, times this."""
TALLEST_M = 8.0
"""Patches whose points span more height are no planes; keeps the sums small."""

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Roughness:
    """Figures of a run.

    Attributes
    ----------
    density_m2 : float
        Points per square metre of the cells of `PATCH_M` that hold any; 0 without points.
    sigma_m : float or None
        Noise of heights, metres; None if there is no planar patch, or next to none.
    patches : int
        How many planar patches there are, on which it rests.
    smoothest_m : float or None
        Noise of the smoothest places, metres, with no test of what they are: there are some in any dense cloud. None if
        no quarter of a patch has enough points.
    """

    density_m2: float
    sigma_m: float | None
    patches: int
    smoothest_m: float | None = None


class _Moments(NamedTuple):
    """Sums over the points of each cell.

    Attributes
    ----------
    low, high : int64 [cells]
        Lowest and highest point, counts.
    sums : int64 [cells, 4, 10]
        Moments of each quarter: n, x, y, z, xx, xy, yy, xz, yz, zz from the cell's corner and lowest point.
    first : int64 [cells]
        The southernmost point, of those the westernmost.
    """

    low: Int64
    high: Int64
    sums: Int64
    first: Int64


@kernel
def _sums(
    points: Xyz, slot: Int64, corners: tuple[Int64, Int64], side: tuple[int, int], tallest: float
) -> _Moments:
    """Moments of cells of side p / q counts; of those taller than a limit n and z alone."""
    x, y, z = points
    corner_x, corner_y = corners
    p, q = side
    low, high = np.full(corner_x.size, 2**40, np.int64), np.full(corner_x.size, -(2**40), np.int64)
    sums, first = np.zeros((corner_x.size, 4, 10), np.int64), np.full(corner_x.size, -1, np.int64)
    for i in range(x.size):
        k = slot[i]
        low[k], high[k] = min(low[k], np.int64(z[i])), max(high[k], np.int64(z[i]))
        f = first[k]
        if f < 0 or y[i] < y[f] or (y[i] == y[f] and x[i] < x[f]):
            first[k] = i
    for i in range(x.size):
        k = slot[i]
        dx, dy, dz = np.int64(x[i]) - corner_x[k], np.int64(y[i]) - corner_y[k], np.int64(z[i]) - low[k]
        quarter = 2 * int(2 * q * dy >= p) + int(2 * q * dx >= p)
        s = sums[k, quarter]
        s[0] += 1
        s[3] += dz
        if high[k] - low[k] > tallest:
            continue
        s[1] += dx
        s[2] += dy
        s[4] += dx * dx
        s[5] += dx * dy
        s[6] += dy * dy
        s[7] += dx * dz
        s[8] += dy * dz
        s[9] += dz * dz
    return _Moments(low, high, sums, first)


@kernel
def fit_plane(s: Int64, z_ratio: float) -> tuple[float, float, float, float]:
    """Least squares ``z = c + a x + b y`` in horizontal counts from moments: a, b, c, sum of squared residuals.

    The last is -1 where the points lie on a line.
    """
    n = float(s[0])
    mx, my, mz = s[1] / n, s[2] / n, s[3] / n
    xx, xy, yy = s[4] - n * mx * mx, s[5] - n * mx * my, s[6] - n * my * my
    xz, yz, zz = (s[7] - n * mx * mz) * z_ratio, (s[8] - n * my * mz) * z_ratio, s[9] - n * mz * mz
    det = xx * yy - xy * xy
    if det <= 1e-6 * xx * yy:
        return 0.0, 0.0, 0.0, -1.0
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    return a, b, mz * z_ratio - a * mx - b * my, max(zz * z_ratio * z_ratio - a * xz - b * yz, 0.0)


@kernel
def _total(sums: Int64, cell: int, moment: int) -> int:
    """A moment of a cell: the sum of its quarters' (sums of arrays take numba as long to compile as ten such)."""
    return sums[cell, 0, moment] + sums[cell, 1, moment] + sums[cell, 2, moment] + sums[cell, 3, moment]  # type: ignore[no-any-return]


@kernel
def _patches(
    sums: Int64, low: Int64, high: Int64, tallest: float, largest: float, z_ratio: float
) -> tuple[Float64, Float64]:
    """Planes a, b, c of the cells that are many and planar, and their noise (-1 for all others), horizontal counts."""
    planes = np.zeros((low.size, 3))
    noise = np.full(low.size, -1.0)
    total = np.empty(sums.shape[2], np.int64)
    for k in range(low.size):
        fewest = min(min(sums[k, 0, 0], sums[k, 1, 0]), min(sums[k, 2, 0], sums[k, 3, 0]))
        if high[k] - low[k] > tallest or fewest < MIN_QUARTER:
            continue
        for moment in range(total.size):
            total[moment] = _total(sums, k, moment)
        n = total[0]
        if n < MIN_POINTS:
            continue
        a, b, c, squares = fit_plane(total, z_ratio)
        variance = squares / (n - 3)
        cos = 1.0 / math.sqrt(1.0 + a * a + b * b)
        if squares < 0.0 or math.sqrt(variance) * cos > largest or a * a + b * b > STEEPEST * STEEPEST:
            continue
        parts = 0.0
        for quarter in range(4):
            left = fit_plane(sums[k, quarter], z_ratio)[3]
            parts = parts + left if left >= 0.0 and parts >= 0.0 else -1.0
        if parts / (n - 12 if n > 12 else 1) < LEAST_QUARTERS * variance and squares > 0.0:
            continue
        planes[k, 0], planes[k, 1], planes[k, 2] = a, b, c
        noise[k] = math.sqrt(variance) * cos
    return planes, noise


@kernel
def _quarters(sums: Int64, z_ratio: float) -> Float64:
    """Root mean square of the vertical residuals of the quarters from their planes (-1: too few points)."""
    noise = np.full((sums.shape[0], 4), -1.0)
    for k in range(sums.shape[0]):
        for quarter in range(4):
            n = sums[k, quarter, 0]
            if n < CELL_POINTS or sums[k, quarter, 9] == 0:
                continue
            squares = fit_plane(sums[k, quarter], z_ratio)[3]
            if squares >= 0.0:
                noise[k, quarter] = math.sqrt(squares / (n - 3))
    return noise


@kernel
def _drop_bent(
    points: Xyz,
    slot: Int64,
    corners: tuple[Int64, Int64],
    low: Int64,
    planes: Float64,
    noise: Float64,
    z_ratio: float,
) -> None:
    """Refuse the patches one of whose points lies beyond `LARGEST_RESIDUAL` times the noise."""
    x, y, z = points
    corner_x, corner_y = corners
    worst = np.zeros(noise.size)
    for i in range(x.size):
        k = slot[i]
        if noise[k] < 0.0:
            continue
        a, b, c = planes[k]
        vertical = (z[i] - low[k]) * z_ratio - (a * (x[i] - corner_x[k]) + b * (y[i] - corner_y[k]) + c)
        worst[k] = max(worst[k], abs(vertical) / math.sqrt(1.0 + a * a + b * b))
    for k in range(noise.size):
        if worst[k] > LARGEST_RESIDUAL * noise[k]:
            noise[k] = -1.0


@kernel
def _drop_raised(
    keys: Int64,
    width: int,
    corners: tuple[Int64, Int64],
    moments: _Moments,
    planes: Float64,
    noise: Float64,
    side: float,
    drop: float,
    z_ratio: float,
) -> npt.NDArray[np.bool_]:
    """Which patches are ground: no cell with enough points around them has its mean far below their plane."""
    corner_x, corner_y = corners
    low, sums = moments.low, moments.sums
    ground = noise >= 0.0
    for k in range(keys.size):
        if not ground[k]:
            continue
        a, b, c = planes[k]
        for row in range(-REACH_CELLS, REACH_CELLS + 1):
            j = np.searchsorted(keys, keys[k] + row * width - REACH_CELLS)
            while j < keys.size and keys[j] <= keys[k] + row * width + REACH_CELLS:
                n = _total(sums, j, wide(0))
                if n >= MIN_POINTS:
                    mean = (_total(sums, j, wide(3)) / n + (low[j] - low[k])) * z_ratio
                    px, py = corner_x[j] - corner_x[k] + side / 2, corner_y[j] - corner_y[k] + side / 2
                    if mean < a * px + b * py + c - drop:
                        ground[k] = False
                j += 1
    return ground


def measure(xyz: Int32, window: Window, core: Window, scale: Scale) -> dict[str, Any]:
    """What the core of a window adds to the run's figures.

    Parameters
    ----------
    xyz : int32 [3, n]
        All points of the window, local counts, in any order.
    window, core : Window
        The window holds at least `REACH_M` around the core.
    scale : Scale

    Returns
    -------
    dict
        ``points``, ``cells`` (of `PATCH_M`, with any point), ``full`` (with at least `MIN_POINTS`), ``patches`` and
        ``quarters``: [[bin, count], ...] with bins of `BIN_M`.
    """
    points = Xyz(*(np.ascontiguousarray(c) for c in xyz))
    x, y = points.x, points.y
    if x.size == 0:
        return {"points": 0, "cells": 0, "full": 0, "patches": [], "quarters": []}
    cells = Cells.of(PATCH_M, scale)
    inside = core.has(x, y)
    # A margin of columns around the occupied ones, so that a key beside the raster is no cell of another row.
    col0, row0 = cells.column(int(x.min())) - REACH_CELLS, cells.row(int(y.min()))
    width = cells.column(int(x.max())) + REACH_CELLS + 1 - col0
    point_keys = cell_keys(x, y, cells.p, cells.q, cells.origin_x, cells.origin_y, col0, row0, width)
    keys, slot = occupied(point_keys, width * (cells.row(int(y.max())) - row0 + 1))
    corner_x, corner_y = cells.corners(keys % width + col0, keys // width + row0)
    corners, tallest, ratio = (corner_x, corner_y), scale.counts_z(TALLEST_M), scale.z_ratio
    moments = _sums(points, slot, corners, (cells.p, cells.q), tallest)
    low, high, sums, first = moments
    planes, noise = _patches(sums, low, high, tallest, scale.counts(LARGEST_SIGMA_M), ratio)
    _drop_bent(points, slot, corners, low, planes, noise, ratio)
    side, drop = scale.counts(PATCH_M), scale.counts(DROP_M)
    ground = _drop_raised(keys, width, corners, moments, planes, noise, side, drop, ratio)
    own = inside[first]
    quarters = _quarters(sums[own], ratio)
    return {
        "points": int(inside.sum()),
        "cells": int(own.sum()),
        "full": int(np.count_nonzero(sums[own, :, 0].sum(axis=1) >= MIN_POINTS)),
        "patches": _binned(noise[own & ground], scale),
        "quarters": _binned(quarters[(quarters >= 0.0) & (quarters < scale.counts(LARGEST_SIGMA_M))], scale),
    }


def _binned(noise: Float64, scale: Scale) -> list[list[int]]:
    """Values in horizontal counts as [[bin, count], ...]."""
    found, counts = np.unique((noise / scale.counts(BIN_M)).astype(np.int64), return_counts=True)
    return [[int(b), int(n)] for b, n in zip(found, counts, strict=True)]


def merge(partials: Iterable[Mapping[str, Any]]) -> Roughness:
    """The run's figures from those of all cores, in any order."""
    points = cells = full = 0
    patches: Counter[int] = Counter()
    quarters: Counter[int] = Counter()
    for partial in partials:
        points, cells = points + int(partial["points"]), cells + int(partial["cells"])
        full += int(partial["full"])
        patches.update({int(index): int(count) for index, count in partial["patches"]})
        quarters.update({int(index): int(count) for index, count in partial["quarters"]})
    density = points / (cells * PATCH_M**2) if cells else 0.0
    smoothest = _quantile(quarters, SMOOTHEST_SHARE)
    smoothest = None if smoothest is None else round(SMOOTHEST_FACTOR * smoothest, 6)
    sigma = None if patches.total() < LEAST_SHARE * full else _quantile(patches, 0.25)
    return Roughness(density, sigma, patches.total(), smoothest)


def _quantile(histogram: Counter[int], share: float) -> float | None:
    """The value below which so much of a histogram with bins of `BIN_M` lies; None of an empty one."""
    below = 0
    for index in sorted(histogram):
        below += histogram[index]
        if below >= share * histogram.total():
            return round((index + 0.5) * BIN_M, 6)
    return None
