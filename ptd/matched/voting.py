"""Points against the ground's surface: noise moves a point, not its neighbourhood, so neighbours vote."""

from __future__ import annotations

import math

import numpy as np

from ptd.cells import Int32, Int64, cell_keys
from ptd.frame import Cells, Scale
from ptd.ground.morphology import Bool
from ptd.kernel import kernel, wide
from ptd.matched.cells import by_cell

PARTS = 16
"""Residuals are whole parts of a vertical count, so that their sums do not depend on an order."""

NEIGHBOURS = 10.0
"""Points within the radius of the neighbourhood, on average."""
RADIUS_M = (0.25, 1.0)
"""Its limits."""
ROUNDS = 2
ALIKE_M, ALIKE_SIGMAS = 0.05, 4.0
"""Residuals of neighbours that are averaged differ by less than this."""
REACH_M = ROUNDS * RADIUS_M[1]
"""Nothing farther away has a part in a point's label."""

STEP = 32
"""Neighbours that are looked at without a look at how many are left."""
FAR = 2**30
"""No residual is alike."""
FINEST = 2**14
"""Positions are told apart by so small a part of the radius, or by the cloud's own counts where those are coarser."""


def radius_m(density_m2: float) -> float:
    """Radius of the neighbourhood, in whole centimetres: cells of that side have few digits."""
    return round(
        min(max(math.sqrt(NEIGHBOURS / (math.pi * max(density_m2, 1e-9))), RADIUS_M[0]), RADIUS_M[1]), 2
    )


@kernel
def _averaged(
    x: Int32, y: Int32, residual: Int32, starts: Int64, width: int, square: int, alike: int
) -> Int32:
    """Mean residual of the neighbours of each point that are alike, itself among them, rounded down.

    Points come by cells as wide as the radius (``starts``) in a raster with a margin of one cell all around. What may
    be near the points of a cell is copied side by side, with points far away up to whole `STEP`: several at a time.
    """
    means = np.empty_like(residual)
    room = 32 * STEP
    near_x, near_y, near_residual = (
        np.empty(room, np.int32),
        np.empty(room, np.int32),
        np.empty(room, np.int32),
    )
    limit, most = np.int32(square), np.int32(alike)
    for key in range(width + 1, starts.size - width - 2):
        begin, end = starts[key], starts[key + 1]
        if begin == end:
            continue
        n = 0
        for row in (key - width, key, key + width):
            n += starts[row + 2] - starts[row - 1]
        if n + STEP > room:
            room = 2 * n + STEP
            near_x, near_y, near_residual = (
                np.empty(room, np.int32),
                np.empty(room, np.int32),
                np.empty(room, np.int32),
            )
        n = 0
        for row in (key - width, key, key + width):
            for j in range(starts[row - 1], starts[row + 2]):
                near_x[n], near_y[n], near_residual[n] = x[j], y[j], residual[j]
                n += 1
        filled = (n + STEP - 1) // STEP * STEP
        for j in range(n, filled):
            near_x[j], near_y[j], near_residual[j] = x[begin], y[begin], FAR
        for i in range(begin, end):
            own_x, own_y, own = x[i], y[i], residual[i]
            low, high, count = np.int32(0), np.int32(0), np.int32(0)
            for j in range(filled):  # without branches, in 32 bits: the sum is in two parts
                dx, dy = np.int32(near_x[j] - own_x), np.int32(near_y[j] - own_y)
                difference = np.int32(near_residual[j] - own)
                near = np.int32(np.int32(dx * dx) + np.int32(dy * dy)) < limit
                one = np.int32(near & (np.int32(abs(difference)) < most))
                low += np.int32(one * np.int32(difference & 4095))
                high += np.int32(one * np.int32(difference >> 12))
                count += one
            means[i] = own + np.int32(math.floor((wide(high) * 4096 + low) / count))
    return means


def votes(
    x: Int32, y: Int32, residual: Int32, asked: Bool, density_m2: float, sigma_m: float, scale: Scale
) -> Int32:
    """Residuals after the neighbours' vote.

    Parameters
    ----------
    x, y : int32 [n]
        Local counts.
    residual : int32 [n]
        Height above the surface in `PARTS` of a vertical count.
    asked : bool [n]
        Points that have a residual and a vote; all others keep theirs.
    density_m2, sigma_m : float
        Of the run.
    scale : Scale
    """
    voters = np.flatnonzero(asked)
    if voters.size == 0:
        return residual
    px, py, side = x[voters], y[voters], radius_m(density_m2)
    cells = Cells.of(side, scale)
    column, row = cells.column(int(px.min())) - 1, cells.row(int(py.min())) - 1
    width, height = cells.column(int(px.max())) - column + 2, cells.row(int(py.max())) - row + 2
    keys = cell_keys(px, py, cells.p, cells.q, cells.origin_x, cells.origin_y, column, row, width)
    starts, order = by_cell(keys, width * height)
    finer = max(math.ceil(math.log2(scale.counts(side) / FINEST)), 0)  # squares of more counts would overflow
    px, py, voters = px[order] >> finer, py[order] >> finer, voters[order]
    votes = residual[voters]
    alike = round(PARTS * scale.counts_z(ALIKE_M + ALIKE_SIGMAS * sigma_m))
    square = round((scale.counts(side) / 2**finer) ** 2)
    for _ in range(ROUNDS):
        votes = _averaged(px, py, votes, starts, width, square, alike)
    found = residual.copy()
    found[voters] = votes
    return found
