"""Find seeds that are noise: corners of over-long facets, and small raised clusters (Chen 2023, 2.3)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64, UInt8
from ptd.kernel import kernel
from ptd.tin.facets import real_facets
from ptd.tin.mesh import Tin
from ptd.tin.triangles import VERTEX


class ClusterLimits(NamedTuple):
    """Limits of facets and clusters, for the paper's "large", "narrow", "small" and "locally prominent".

    Attributes
    ----------
    long_side : float
        If a side of a facet is longer in space, its highest corner is noise. Horizontal counts; 0 turns this off.
    narrow_cos : float
        Cosine of an angle in space. A facet with a smaller angle is narrow.
    small : int
        Largest number of seeds of a small cluster.
    prominence : float
        Height above the seeds around it, on average, from which a cluster is prominent. Counts of height.
    z_ratio : float
        Horizontal counts in one vertical count.
    """

    long_side: float
    narrow_cos: float
    small: int
    prominence: float
    z_ratio: float


@kernel
def _sides(vertices: Int32, facet: Int32, z_ratio: float) -> tuple[float, float, float]:
    """Return the squared sides of a facet in space, growing, with bits that do not depend on the order of corners."""
    short, middle, longest = np.inf, np.inf, -np.inf
    for k in range(3):
        a, b = facet[k], facet[(k + 1) % 3]
        dx, dy = float(vertices[a, 0] - vertices[b, 0]), float(vertices[a, 1] - vertices[b, 1])
        dz = float(vertices[a, 2] - vertices[b, 2]) * z_ratio
        side = dx * dx + dy * dy + dz * dz
        middle = max(min(side, middle), short)
        short, longest = min(side, short), max(side, longest)
    return short, middle, longest


@kernel
def _highest(vertices: Int32, facet: Int32) -> int:
    """Return the highest corner, among equally high ones the lexicographically smallest in (x, y)."""
    top = facet[0]
    for k in range(1, 3):
        v = facet[k]
        if vertices[v, 2] > vertices[top, 2] or (
            vertices[v, 2] == vertices[top, 2]
            and (
                vertices[v, 0] < vertices[top, 0]
                or (vertices[v, 0] == vertices[top, 0] and vertices[v, 1] < vertices[top, 1])
            )
        ):
            top = v
    return int(top)


@kernel
def _judge_facets(
    vertices: Int32,
    facets: Int32,
    real: Bool,
    long_side: float,
    narrow_cos: float,
    z_ratio: float,
) -> tuple[Int32, Bool]:
    """Return, for each facet, the corner that is noise (-1: none), and whether it joins its corners to a cluster."""
    tips = np.full(facets.shape[0], -1, np.int32)
    joins = np.zeros(facets.shape[0], np.bool_)
    for i in range(facets.shape[0]):
        short, middle, longest = _sides(vertices, facets[i], z_ratio)
        if long_side > 0.0 and longest > long_side * long_side:
            top = _highest(vertices, facets[i])
            if real[top]:
                tips[i] = top
        if real[facets[i, 0]] and real[facets[i, 1]] and real[facets[i, 2]]:
            # The smallest angle lies between the two longer sides.
            joins[i] = (
                middle + longest - short <= 2.0 * math.sqrt(middle * longest) * narrow_cos
            )
    return tips, joins


@kernel
def _root(parents: Int32, v: int) -> int:
    while parents[v] != v:
        parents[v] = parents[parents[v]]
        v = parents[v]
    return v


@kernel
def _flood(facets: Int32, joins: Bool, n: int) -> Int32:
    """Join the corners of chosen facets, and return the cluster of each vertex: the number of one of its vertices."""
    parents = np.arange(n).astype(np.int32)
    for i in range(facets.shape[0]):
        if joins[i]:
            a = _root(parents, facets[i, 0])
            for k in range(1, 3):
                b = _root(parents, facets[i, k])
                parents[max(a, b)] = min(a, b)
                a = min(a, b)
    for v in range(n):
        parents[v] = _root(parents, v)
    return parents


@kernel
def _sums(
    vertices: Int32, facets: Int32, clusters: Int32, counted: Bool
) -> tuple[Int64, Int64, Int64, Int64]:
    """Return, by cluster, the number and the sum of heights of its seeds and of neighbours across its border.

    A neighbour counts once per facet and corner of the cluster in it.
    """
    n = clusters.size
    size, total = np.zeros(n, np.int64), np.zeros(n, np.int64)
    around, total_around = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for v in range(n):
        if counted[v]:
            size[clusters[v]] += 1
            total[clusters[v]] += vertices[v, 2]
    for i in range(facets.shape[0]):
        for k in range(3):
            for step in range(1, 3):
                a, b = facets[i, k], facets[i, (k + step) % 3]
                if counted[a] and counted[b] and clusters[a] != clusters[b]:
                    around[clusters[a]] += 1
                    total_around[clusters[a]] += vertices[b, 2]
    return size, total, around, total_around


def noisy_seeds(
    tin: Tin, real: Bool, limits: ClusterLimits, uncertified: UInt8
) -> tuple[Bool, Bool]:
    """Return masks of the seeds that are noise, and of those for which that is uncertified.

    1. If a facet has an over-long side in space, its highest corner is noise. All facets are judged in one TIN.
    2. Facets that are not narrow and hold no such noise join their corners to clusters. A small cluster that lies
       higher than its neighbours, on average, is noise.

    The paper gives neither the limits nor the reference of "locally prominent". Here it is the
    mean height of the seeds that share a facet with the cluster, each counted once per facet
    and corner of the cluster in it. Facets join over common corners, so each seed belongs to
    one cluster. Virtual seeds are never noise, join nothing, and are not compared with.

    Parameters
    ----------
    tin : Tin
    real : bool [vertices]
        False for virtual seeds.
    limits : ClusterLimits
    uncertified : uint8 [triangles]
        Mask of uncertified triangles (`ptd.ground.certificates.UncertifiedRegion.triangles`).

    Returns
    -------
    noise : bool [vertices]
    uncertified_seeds : bool [vertices]
    """
    vertices = tin.vertex_array[: 4 * tin.n_vertices].reshape(-1, 4)
    facets = real_facets(tin.vertex_array, tin.triangle_array, tin.counters)
    corners = tin.triangle_array[: 8 * tin.n_triangles].reshape(-1, 8)[:, VERTEX : VERTEX + 3]
    uncertified_facets = uncertified[(corners >= 0).all(axis=1)] != 0
    uncertified_corners = corners[
        uncertified != 0
    ]  # also beyond the hull, where a vertex may have unknown facets
    tips, joins = _judge_facets(
        vertices, facets, real, limits.long_side, limits.narrow_cos, limits.z_ratio
    )
    noise = np.zeros(real.size, np.bool_)
    noise[tips[tips >= 0]] = True
    uncertified_seeds = np.zeros(real.size, np.bool_)
    if uncertified_corners.size:
        uncertified_seeds[uncertified_corners[uncertified_corners >= 0]] = True
        uncertified_seeds &= real
        uncertified_seeds[tips[(tips >= 0) & ~uncertified_facets]] = False
        uncertified_facets |= uncertified_seeds[facets].any(axis=1)
    joins &= ~noise[facets].any(axis=1)
    clusters = _flood(facets, joins, real.size)
    size, total, around, total_around = _sums(vertices, facets, clusters, real & ~noise)
    small = (size <= limits.small) & (size > 0) & (around > 0)
    rise = total / np.maximum(size, 1) - total_around / np.maximum(around, 1)
    is_noise = noise | ((small & (rise > limits.prominence))[clusters] & real)
    if uncertified_facets.any():
        uncertified_seeds |= (
            _uncertified_clusters(facets, joins, uncertified_facets, clusters, limits.small)
            & real
        )
    return is_noise, uncertified_seeds


def _uncertified_clusters(
    facets: Int32, joins: Bool, uncertified_facets: Bool, clusters: Int32, small: int
) -> Bool:
    """Return the vertices of clusters that touch an uncertified facet, unless certified facets make them large."""
    touched = np.zeros(clusters.size, np.bool_)
    touched[clusters[facets[uncertified_facets]]] = True
    certain = _flood(facets, joins & ~uncertified_facets, clusters.size)
    members = np.bincount(certain, minlength=clusters.size)
    is_uncertified: Bool = touched[clusters] & (members[certain] <= small)
    return is_uncertified
