"""Vote of neighbours on the height of points above the ground surface: noise moves a point, not its neighbourhood."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, cell_keys
from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import Bool
from ptd.kernel import as_int64, kernel
from ptd.matched.cells import by_cell
from ptd.places import Field, as_field, values_at

Float64 = npt.NDArray[np.float64]

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


def _cell_size_m(least: float, most: float) -> float:
    """Return the size of the cells in metres, rounded up to 0.01 m, for radii between two limits."""
    return math.ceil(100.0 * most / round(most / least) - ROUNDED) / 100.0


def _figures(field: Field, x: Int32, y: Int32) -> Float64:
    """Return the figure at each point, or a single one if it is the same everywhere."""
    return field.values[0, :1].copy() if field.even else values_at(field, x, y)


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
    radius, noise = (_figures(as_field(figure), px, py) for figure in (radius_m, sigma_m))
    cell_m = _cell_size_m(float(radius.min()), float(radius.max()))
    cells, most = CellLattice.of(cell_m, scale), math.ceil(radius.max() / cell_m - ROUNDED)
    column, row = cells.column(int(px.min())) - most, cells.row(int(py.min())) - most
    width = cells.column(int(px.max())) - column + 1 + most
    height = cells.row(int(py.max())) - row + 1 + most
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
