"""Test seeds against a curved surface (conicoid) fitted to their neighbours.

Source: Remote Sensing 8(1):71 (2016), section 2.2. The heights of a seed and its neighbours in the TIN are observations
of ``z = b0 + b1 x + b2 y + b3 x2 + b4 xy + b5 y2`` (equations 2-5); a seed whose normalised residual leaves the
confidence interval of the t distribution is a gross error (equations 6-10).

The fit is done seed by seed in one kernel: coordinates relative to the judged seed, neighbours in the order of (x, y),
modified Gram-Schmidt with plain sums. So equal neighbours give equal bits, whatever the tile, the order of the points
or the linear algebra library.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ptd.ground.certificates import Doubt, UInt8
from ptd.kernel import kernel
from ptd.tin.layout import Int32Array, Mesh, next_edge
from ptd.tin.mesh import Tin

Bool = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]

UNKNOWNS = 6
MIN_NEIGHBOURS = 10
"""With fewer neighbours a seed is not tested."""

DEPENDENT = 1e-6
"""A column of which the others leave no more than this share makes the conicoid undetermined, a seed whose own height
decides on all but this share of its fit has no residual: the seed stays."""


@kernel
def _gather(
    mesh: Mesh, v: int, centre: int, data: Bool, seen: Int32Array, found: Int32Array, n: int, in_doubt: UInt8
) -> tuple[int, bool]:
    """Append the data vertices around v that were not yet seen from the centre to the n found before.

    How many are found now, and whether a triangle around v is in doubt.
    """
    vertices, triangles = mesh
    unsure = False
    start = vertices[4 * v + 3]
    edge = np.int64(8) * start
    while triangles[edge + 4] != v:
        edge += 1
    while True:
        unsure = unsure or in_doubt[edge >> 3] != 0
        other = triangles[next_edge(edge) + 4]
        if other >= 0 and data[other] and seen[other] != centre:
            seen[other] = centre
            found[n] = other
            n += 1
        edge = next_edge(triangles[next_edge(edge)])
        if edge >> 3 == start:
            return n, unsure


@kernel
def _fit(rows: Float64, n: int) -> tuple[float, float, float]:
    """Least squares by modified Gram-Schmidt, in place.

    Parameters
    ----------
    rows : float64 [>= n, UNKNOWNS + 1]
        x, y, x2, xy, y2, 1, z of each point; the judged one first, at (0, 0, 0).
    n : int

    Returns
    -------
    residual : float
        Of the judged point (equation 7), up to its sign.
    leverage : float
        Its diagonal element of X (X'X)^-1 X'; q_ii of equation 6 is 1 less this. NaN if the columns are dependent.
    squares : float
        Sum of the squared residuals.
    """
    for j in range(UNKNOWNS):
        norm2 = 0.0
        for i in range(n):
            norm2 += rows[i, j] * rows[i, j]
        if not norm2 > 0.0:
            return 0.0, math.nan, 0.0
        norm = math.sqrt(norm2)
        for i in range(n):
            rows[i, j] /= norm
        for k in range(j + 1, UNKNOWNS + 1):
            whole = 0.0
            dot = 0.0
            for i in range(n):
                whole += rows[i, k] * rows[i, k]
                dot += rows[i, j] * rows[i, k]
            left = 0.0
            for i in range(n):
                rows[i, k] -= dot * rows[i, j]
                left += rows[i, k] * rows[i, k]
            if k < UNKNOWNS and left <= DEPENDENT * DEPENDENT * whole:
                return 0.0, math.nan, 0.0
    squares = 0.0
    for i in range(n):
        squares += rows[i, UNKNOWNS] * rows[i, UNKNOWNS]
    # In the judged point all columns but the constant are 0: it alone makes its leverage.
    return rows[0, UNKNOWNS], rows[0, UNKNOWNS - 1] * rows[0, UNKNOWNS - 1], squares


@kernel
def _statistics(
    mesh: Mesh, n_vertices: int, data: Bool, in_doubt: UInt8, length: float
) -> tuple[Float64, Float64, Int32Array, Bool]:
    """Normalised residual (0: cannot be judged), residual in vertical counts, n and doubt of each data vertex."""
    vertices = mesh[0]
    statistic, residual = np.zeros(n_vertices), np.zeros(n_vertices)
    observations, unsure = np.zeros(n_vertices, np.int32), np.zeros(n_vertices, np.bool_)
    seen = np.full(n_vertices, -1, np.int32)
    found = np.empty(n_vertices, np.int32)
    rows = np.empty((64, UNKNOWNS + 1), np.float64)
    for v in range(n_vertices):
        if not data[v]:
            continue
        seen[v] = v
        m, unsure[v] = _gather(mesh, v, v, data, seen, found, 0, in_doubt)
        for k in range(m):
            m, doubtful = _gather(mesh, found[k], v, data, seen, found, m, in_doubt)
            unsure[v] = unsure[v] or doubtful
        observations[v] = m + 1
        if m < MIN_NEIGHBOURS:
            continue
        if m + 1 > rows.shape[0]:
            rows = np.empty((2 * m, UNKNOWNS + 1), np.float64)
        x0, y0, z0 = vertices[4 * v], vertices[4 * v + 1], vertices[4 * v + 2]
        keys = np.empty(m, np.int64)
        for k in range(m):
            keys[k] = (np.int64(vertices[4 * found[k]] - x0) << 32) + (vertices[4 * found[k] + 1] - y0)
        order = np.argsort(keys)
        rows[0, :] = 0.0
        rows[0, UNKNOWNS - 1] = 1.0
        for k in range(m):
            u = 4 * found[order[k]]
            x, y = (vertices[u] - x0) / length, (vertices[u + 1] - y0) / length
            rows[k + 1, 0], rows[k + 1, 1] = x, y
            rows[k + 1, 2], rows[k + 1, 3], rows[k + 1, 4] = x * x, x * y, y * y
            rows[k + 1, 5], rows[k + 1, 6] = 1.0, float(vertices[u + 2] - z0)
        residual[v], leverage, squares = _fit(rows, m + 1)
        variance = squares / (m + 1 - UNKNOWNS - 1) * (1.0 - leverage)  # of equations 8 and 9
        if variance > 0.0 and 1.0 - leverage > DEPENDENT:
            statistic[v] = abs(residual[v]) / math.sqrt(variance)
    return statistic, residual, observations, unsure


def contradicted(
    tin: Tin, data: Bool, length: float, confidence: float, least: float, doubt: Doubt
) -> npt.NDArray[np.bool_]:
    """Which seeds do not fit the conicoid through their neighbours; all are judged against the same TIN.

    A seed is judged by the data vertices up to two edges away, over data vertices alone, and by itself. The paper
    judges one seed after the other, in the TIN that the ones before left: that depends on their order.

    With n observations the normalised residual cannot exceed the root of n - u - 1 (equations 8 and 9), so that at
    98 % nothing is contradicted below 16 of them.

    Parameters
    ----------
    tin : Tin
        Of the seeds.
    data : bool [vertices]
        Not a virtual seed; those are neither judged nor observations.
    length : float
        Ordinary distance of seeds, counts: coordinates are taken in it.
    confidence : float
        1 - alpha, two-sided, of t with n - u - 1 degrees of freedom; 1 contradicts nothing.
    least : float
        Vertical counts: smaller residuals contradict nothing.
    doubt : Doubt
        Grows by the places of seeds that points outside the window could save or drop.

    Returns
    -------
    bool [vertices]
    """
    from scipy.special import stdtrit

    n = tin.n_vertices
    if confidence == 1.0:
        return np.zeros(n, np.bool_)
    in_doubt = doubt.triangles(tin)
    statistic, residual, observations, unsure = _statistics(tin.mesh, n, data, in_doubt, length)
    xyz = tin.vertices
    doubt.add_points(np.ascontiguousarray(xyz[:, 0]), np.ascontiguousarray(xyz[:, 1]), unsure)
    freedom = np.maximum(observations - UNKNOWNS - 1, 1)
    limit = stdtrit(freedom, 0.5 + 0.5 * confidence)
    found: Bool = data & (statistic > limit) & (abs(residual) > least)
    return found
