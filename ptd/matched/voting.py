"""Points against the ground's surface: noise moves a point, not its neighbourhood, so neighbours vote."""

from __future__ import annotations

import math

import numpy as np

from ptd.cells import Int32, Int64, cell_keys
from ptd.frame import Cells, Scale
from ptd.kernel import kernel
from ptd.matched.cells import by_cell
from ptd.morphology import Bool

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
def averaged(
    x: Int32, y: Int32, residual: Int64, asked: Bool, keys: Int64, starts: Int64, order: Int32, width: int,
    radius: float, alike: int,
) -> Int64:  # fmt: skip
    """Mean residual of the neighbours of each point that are alike, itself among them, rounded down.

    ``keys`` are those of cells as wide as the radius in a raster with a margin of one cell all around; points that are
    not asked keep their residual and have no vote.
    """
    means = residual.copy()
    square = radius * radius
    for i in range(residual.size):
        if not asked[i]:
            continue
        total, n = np.int64(0), 0
        for dr in range(-1, 2):
            first = keys[i] + dr * width - 1
            for k in range(starts[first], starts[first + 3]):
                j = order[k]
                if asked[j] and abs(residual[j] - residual[i]) < alike:
                    dx, dy = np.int64(x[j]) - x[i], np.int64(y[j]) - y[i]
                    if dx * dx + dy * dy < square:
                        total += residual[j]
                        n += 1
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
        Points that have a residual and a vote.
    density_m2, sigma_m : float
        Of the run.
    scale : Scale
    """
    if x.size == 0:
        return residual
    side = radius_m(density_m2)
    cells = Cells.of(side, scale)
    column, row = cells.column(int(x.min())) - 1, cells.row(int(y.min())) - 1
    width, height = cells.column(int(x.max())) - column + 2, cells.row(int(y.max())) - row + 2
    keys = cell_keys(x, y, cells.p, cells.q, cells.origin_x, cells.origin_y, column, row, width)
    starts, order = by_cell(keys, width * height)
    alike = round(PARTS * scale.counts_z(ALIKE_M + ALIKE_SIGMAS * sigma_m))
    for _ in range(ROUNDS):
        residual = averaged(x, y, residual, asked, keys, starts, order, width, scale.counts(side), alike)
    return residual
