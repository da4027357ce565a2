"""Test seeds against a curved surface (conicoid) fitted to their neighbours.

Source: Remote Sensing 8(1):71 (2016), section 2.2. The heights of a seed and its neighbours in
the TIN are observations of ``z = b0 + b1 x + b2 y + b3 x2 + b4 xy + b5 y2`` (equations 2-5). A
seed is a gross error if its normalised residual lies outside the confidence interval of the t
distribution (equations 6-10).

One kernel fits seed by seed: coordinates are relative to the judged seed, neighbours are in the
order of (x, y), and modified Gram-Schmidt uses plain sums. So equal neighbours give equal bits.
Neither the tile, nor the order of the points, nor a linear algebra library has an effect.
"""

from __future__ import annotations

import math

import numpy as np

from ptd.arrays import Bool, Float64, Int32, UInt8
from ptd.ground.certificates import UncertifiedRegion
from ptd.kernel import kernel
from ptd.tin.mesh import Tin
from ptd.tin.triangles import Mesh, next_edge

UNKNOWNS = 6
MIN_NEIGHBOURS = 10
"""Number of neighbours below which a seed is not tested."""

DEPENDENT = 1e-6
"""Smallest share of a column that has to be independent of the other columns.

Otherwise the conicoid is undetermined. If 1 - leverage of the seed is at most this share, its
own height determines the fit, and there is no residual. In both cases the seed stays.
"""


@kernel
def _gather(
    mesh: Mesh,
    v: int,
    centre: int,
    data: Bool,
    seen: Int32,
    found: Int32,
    n: int,
    uncertified: UInt8,
) -> tuple[int, bool]:
    """Append the data vertices around v that were not yet found for this centre to the n found before.

    Returns the new number, and whether a triangle around v is uncertified.
    """
    vertices, triangles = mesh
    is_uncertified = False
    start = vertices[4 * v + 3]
    edge = np.int64(8) * start
    while triangles[edge + 4] != v:
        edge += 1
    while True:
        is_uncertified = is_uncertified or uncertified[edge >> 3] != 0
        other = triangles[next_edge(edge) + 4]
        if other >= 0 and data[other] and seen[other] != centre:
            seen[other] = centre
            found[n] = other
            n += 1
        edge = next_edge(triangles[next_edge(edge)])
        if edge >> 3 == start:
            return n, is_uncertified


@kernel
def _fit(rows: Float64, n: int) -> tuple[float, float, float]:
    """Least squares by modified Gram-Schmidt, in place.

    Parameters
    ----------
    rows : float64 [>= n, UNKNOWNS + 1]
        x, y, x2, xy, y2, 1, z of each point; the judged point comes first, at (0, 0, 0).
    n : int
        Number of points.

    Returns
    -------
    residual : float
        Residual of the judged point (equation 7), up to its sign.
    leverage : float
        Its diagonal element of X (X'X)^-1 X', which is 1 - q_ii of equation 6. NaN if the columns are dependent.
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
    # All columns except the constant are 0 in the judged point, so the constant alone makes its
    # leverage.
    return rows[0, UNKNOWNS], rows[0, UNKNOWNS - 1] * rows[0, UNKNOWNS - 1], squares


@kernel
def _statistics(
    mesh: Mesh, n_vertices: int, data: Bool, uncertified: UInt8, length: float
) -> tuple[Float64, Float64, Int32, Bool]:
    """Return normalised residual (0: not judged), residual in vertical counts, and number of observations by vertex.

    The last result is a mask of the vertices with an uncertified triangle.
    """
    vertices = mesh[0]
    statistic, residual = np.zeros(n_vertices), np.zeros(n_vertices)
    observations, uncertified_vertices = (
        np.zeros(n_vertices, np.int32),
        np.zeros(n_vertices, np.bool_),
    )
    seen = np.full(n_vertices, -1, np.int32)
    neighbours = np.empty(n_vertices, np.int32)
    rows = np.empty((64, UNKNOWNS + 1), np.float64)
    for v in range(n_vertices):
        if not data[v]:
            continue
        seen[v] = v
        m, uncertified_vertices[v] = _gather(mesh, v, v, data, seen, neighbours, 0, uncertified)
        for k in range(m):
            m, neighbour_is_uncertified = _gather(
                mesh, neighbours[k], v, data, seen, neighbours, m, uncertified
            )
            uncertified_vertices[v] = uncertified_vertices[v] or neighbour_is_uncertified
        observations[v] = m + 1
        if m < MIN_NEIGHBOURS:
            continue
        if m + 1 > rows.shape[0]:
            rows = np.empty((2 * m, UNKNOWNS + 1), np.float64)
        x0, y0, z0 = vertices[4 * v], vertices[4 * v + 1], vertices[4 * v + 2]
        keys = np.empty(m, np.int64)
        for k in range(m):
            keys[k] = (np.int64(vertices[4 * neighbours[k]] - x0) << 32) + (
                vertices[4 * neighbours[k] + 1] - y0
            )
        order = np.argsort(keys)
        rows[0, :] = 0.0
        rows[0, UNKNOWNS - 1] = 1.0
        for k in range(m):
            u = 4 * neighbours[order[k]]
            x, y = (vertices[u] - x0) / length, (vertices[u + 1] - y0) / length
            rows[k + 1, 0], rows[k + 1, 1] = x, y
            rows[k + 1, 2], rows[k + 1, 3], rows[k + 1, 4] = x * x, x * y, y * y
            rows[k + 1, 5], rows[k + 1, 6] = 1.0, float(vertices[u + 2] - z0)
        residual[v], leverage, squares = _fit(rows, m + 1)
        variance = squares / (m + 1 - UNKNOWNS - 1) * (1.0 - leverage)  # equations 8 and 9
        if variance > 0.0 and 1.0 - leverage > DEPENDENT:
            statistic[v] = abs(residual[v]) / math.sqrt(variance)
    return statistic, residual, observations, uncertified_vertices


def conicoid_outliers(
    tin: Tin,
    data: Bool,
    length: float,
    confidence: float,
    least: float,
    region: UncertifiedRegion,
) -> Bool:
    """Return a mask of the seeds that do not fit the conicoid through their neighbours, all in the same TIN.

    The observations are the seed itself and the data vertices up to two edges away, over data
    vertices only. The paper judges one seed after the other, in the TIN that earlier decisions
    left, which depends on their order.

    With n observations the normalised residual cannot exceed the root of n - u - 1 (equations 8
    and 9). So at 98 % no seed with fewer than 16 observations is contradicted.

    Parameters
    ----------
    tin : Tin
        TIN of the seeds.
    data : bool [vertices]
        False for virtual seeds, which are neither judged nor observations.
    length : float
        Typical distance of seeds in counts, the unit of the coordinates in the fit.
    confidence : float
        1 - alpha, two-sided, of t with n - u - 1 degrees of freedom; with 1 no seed is contradicted.
    least : float
        Smallest residual that contradicts a seed, vertical counts.
    region : UncertifiedRegion
        Uncertified region. It is extended by the positions of seeds whose result depends on points outside the window.

    Returns
    -------
    bool [vertices]
    """
    from scipy.special import stdtrit

    n = tin.n_vertices
    if confidence == 1.0:
        return np.zeros(n, np.bool_)
    uncertified = region.triangles(tin)
    statistic, residual, observations, uncertified_vertices = _statistics(
        tin.mesh, n, data, uncertified, length
    )
    xyz = tin.vertices
    region.add_points(
        np.ascontiguousarray(xyz[:, 0]), np.ascontiguousarray(xyz[:, 1]), uncertified_vertices
    )
    freedom = np.maximum(observations - UNKNOWNS - 1, 1)
    limit = stdtrit(freedom, 0.5 + 0.5 * confidence)
    is_outlier: Bool = data & (statistic > limit) & (abs(residual) > least)
    return is_outlier
