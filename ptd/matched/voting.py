"""Points against the ground's surface: noise moves a point, not its neighbourhood, so neighbours vote."""

from __future__ import annotations

import math

import numpy as np

from ptd.cells import Int32, Int64, cell_keys
from ptd.frame import Cells, Scale
from ptd.ground.morphology import Bool
from ptd.kernel import kernel
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


def radius_m(density_m2: float) -> float:
    """Radius of the neighbourhood, in whole centimetres: cells of that side have few digits."""
    return round(
        min(max(math.sqrt(NEIGHBOURS / (math.pi * max(density_m2, 1e-9))), RADIUS_M[0]), RADIUS_M[1]), 2
    )


@kernel
def _averaged(
    x: Int32, y: Int32, residual: Int32, keys: Int64, starts: Int64, width: int, square: Int32, alike: Int32
) -> Int32:
    """Mean residual of the neighbours of each point that are alike, itself among them, rounded down.

    Points come by cells as wide as the radius (``keys``, ``starts``) in a raster with a margin of one cell all around.
    """
    means = np.empty_like(residual)
    for i in range(residual.size):
        total, n = np.int64(0), np.int64(0)
        for dr in range(-1, 2):
            first = keys[i] + dr * width - 1
            for j in range(starts[first], starts[first + 3]):  # without branches: several at a time
                dx, dy = x[j] - x[i], y[j] - y[i]
                near = (abs(residual[j] - residual[i]) < alike[0]) & (dx * dx + dy * dy < square[0])
                total += np.int64(near) * residual[j]
                n += near
        means[i] = total // n
    return means


def votes(
    x: Int32, y: Int32, residual: Int64, asked: Bool, density_m2: float, sigma_m: float, scale: Scale
) -> Int64:
    """Residuals after the neighbours' vote.

    Parameters
    ----------
    x, y : int32 [n]
        Local counts.
    residual : int64 [n]
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
    px, py, keys, voters = px[order], py[order], keys[order], voters[order]
    votes = residual[voters].astype(np.int32)
    alike = np.array([round(PARTS * scale.counts_z(ALIKE_M + ALIKE_SIGMAS * sigma_m))], np.int32)
    square = np.array([round(scale.counts(side) ** 2)], np.int32)
    for _ in range(ROUNDS):
        votes = _averaged(px, py, votes, keys, starts, width, square, alike)
    found = residual.copy()
    found[voters] = votes
    return found
