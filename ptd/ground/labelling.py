"""The last step of most methods: label every point by its height above the finished TIN."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import Xyz
from ptd.ground.certificates import UInt8
from ptd.ground.criteria import Limits, across, facet_measures, judge
from ptd.ground.outliers import LowNoise
from ptd.kernel import kernel, wide
from ptd.passes import Model, Points
from ptd.tin.interpolation import canonical_facet
from ptd.tin.layout import Int32Array, Mesh, is_ghost, real_neighbour
from ptd.tin.location import coincident_vertex, locate, walk
from ptd.tin.locator import Locator, start_near
from ptd.tin.mesh import Tin

UNCLASSIFIED, GROUND, LOW_NOISE = 1, 2, 7
"""ASPRS classes that a filter gives."""


@kernel
def is_terrain(
    vertices: Int32Array,
    triangles: Int32Array,
    t: int,
    x: int,
    y: int,
    z: int,
    in_doubt: UInt8,
    limits: Limits,
    floor: float,
) -> tuple[bool, bool, bool]:
    """The rule of `label_points` for a point that lies in triangle t, which may be a ghost.

    Returns
    -------
    terrain : bool
    elsewhere : bool
        The answer rests on other triangles than t.
    doubtful : bool
        The answer rests on a triangle in doubt.
    """
    doubtful = in_doubt[t] != 0
    if is_ghost(triangles, t):
        return False, False, doubtful
    v = coincident_vertex(vertices, triangles, x, y, t)
    if v >= 0:
        return abs(float(z - vertices[4 * v + 2])) * limits.z_ratio <= floor, False, doubtful
    beside = across(vertices, triangles, t, x, y)
    doubtful = doubtful or in_doubt[beside] != 0
    measures = facet_measures(vertices, triangles, t, x, y, z, limits.z_ratio)
    if abs(measures[0]) <= floor:
        return True, beside != t, doubtful
    passed, mirrored, unsure = judge(vertices, triangles, t, x, y, z, measures, limits, in_doubt)
    return passed, mirrored or beside != t, doubtful or unsure


class GroundRule(NamedTuple):
    """When a point is ground, against the finished TIN (`label_points`).

    Attributes
    ----------
    limits : Limits
    floor : float
        Horizontal counts.
    vertices_only : bool
        Without a last pass: only what lies on a vertex, at its height, is ground.
    heights_only : bool
        Ground is what lies no more than ``floor + per_slope * slope`` (slope of the facet; on a vertex the floor) above
        or below the TIN, measured upright, whatever its angle.
    per_slope : float
        Horizontal counts.
    """

    limits: Limits
    floor: float
    vertices_only: bool = False
    heights_only: bool = False
    per_slope: float = 0.0


class _Facet(NamedTuple):
    """A real triangle and its limit, horizontal counts; corners in local counts, the smallest in (x, y) first."""

    t: int
    a: tuple[int, int, int]
    b: tuple[int, int, int]
    c: tuple[int, int, int]
    normal: tuple[float, float, float]
    length: float
    allowed: float


@kernel
def _facet(vertices: Int32Array, triangles: Int32Array, t: int, rule: GroundRule) -> _Facet:
    i, j, k = canonical_facet(vertices, triangles, t)
    a = wide(vertices[4 * i]), wide(vertices[4 * i + 1]), wide(vertices[4 * i + 2])
    b = wide(vertices[4 * j]), wide(vertices[4 * j + 1]), wide(vertices[4 * j + 2])
    c = wide(vertices[4 * k]), wide(vertices[4 * k + 1]), wide(vertices[4 * k + 2])
    ratio = rule.limits.z_ratio
    bx, by, bz = float(b[0] - a[0]), float(b[1] - a[1]), (b[2] - a[2]) * ratio
    cx, cy, cz = float(c[0] - a[0]), float(c[1] - a[1]), (c[2] - a[2]) * ratio
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    n2 = nx * nx + ny * ny + nz * nz
    cos2 = nz * nz / n2
    # The distance to a facet is the height above it times the cosine of its slope; so is what is allowed.
    allowed = rule.floor * math.sqrt(cos2) + rule.per_slope * math.sqrt(max(1.0 - cos2, 0.0))
    return _Facet(t, a, b, c, (nx, ny, nz), math.sqrt(n2), allowed)


@kernel
def _fits(f: _Facet, x: int, y: int, z: int, z_ratio: float) -> bool:
    """Whether a point lies near a facet in height."""
    dx, dy, dz = float(x - f.a[0]), float(y - f.a[1]), (z - f.a[2]) * z_ratio
    return abs((f.normal[0] * dx + f.normal[1] * dy + f.normal[2] * dz) / f.length) <= f.allowed


@kernel
def _is_near(
    vertices: Int32Array,
    triangles: Int32Array,
    t: int,
    x: int,
    y: int,
    z: int,
    in_doubt: UInt8,
    rule: GroundRule,
) -> tuple[bool, bool]:
    """Whether a point in triangle t, which may be a ghost, lies near it in height, and whether that is doubtful."""
    doubtful = in_doubt[t] != 0
    if is_ghost(triangles, t):
        return False, doubtful
    v = coincident_vertex(vertices, triangles, x, y, t)
    if v >= 0:
        return abs(float(z - vertices[4 * v + 2])) * rule.limits.z_ratio <= rule.floor, doubtful
    doubtful = doubtful or in_doubt[across(vertices, triangles, t, x, y)] != 0
    return _fits(_facet(vertices, triangles, t, rule), x, y, z, rule.limits.z_ratio), doubtful


@kernel
def _inside(f: _Facet, x: int, y: int) -> bool:
    """Whether a position lies in a triangle, and not on its border."""
    ax, ay, bx, by, cx, cy = f.a[0] - x, f.a[1] - y, f.b[0] - x, f.b[1] - y, f.c[0] - x, f.c[1] - y
    return bool(ax * by - ay * bx > 0 and bx * cy - by * cx > 0 and cx * ay - cy * ax > 0)


@kernel
def _label_by_height(
    mesh: Mesh, locator: Locator, points: Xyz, in_doubt: UInt8, rule: GroundRule
) -> tuple[UInt8, npt.NDArray[np.bool_]]:
    """As `_label` for `heights_only`: points that follow each other often lie in one facet, known by then."""
    vertices, triangles = mesh
    x, y, z = points
    labels, marked = np.empty(x.size, np.uint8), np.empty(x.size, np.bool_)
    facet = _facet(vertices, triangles, real_neighbour(triangles, wide(0)), rule)
    for i in range(x.size):
        px, py, pz = wide(x[i]), wide(y[i]), wide(z[i])
        if not _inside(facet, px, py):
            t = walk(vertices, triangles, px, py, wide(start_near(locator, x[i], y[i])))
            if not is_ghost(triangles, t):
                facet = _facet(vertices, triangles, t, rule)
            if is_ghost(triangles, t) or not _inside(facet, px, py):
                t = locate(vertices, triangles, px, py, t)
                terrain, marked[i] = _is_near(vertices, triangles, t, px, py, pz, in_doubt, rule)
                labels[i] = GROUND if terrain else UNCLASSIFIED
                continue
        labels[i] = GROUND if _fits(facet, px, py, pz, rule.limits.z_ratio) else UNCLASSIFIED
        marked[i] = in_doubt[facet.t] != 0
    return labels, marked


@kernel
def _label(
    mesh: Mesh, locator: Locator, points: Xyz, in_doubt: UInt8, rule: GroundRule
) -> tuple[UInt8, npt.NDArray[np.bool_]]:
    vertices, triangles = mesh
    x, y, z = points
    labels, marked = np.empty(x.size, np.uint8), np.empty(x.size, np.bool_)
    for i in range(x.size):
        px, py, pz = wide(x[i]), wide(y[i]), wide(z[i])
        t = locate(vertices, triangles, px, py, wide(start_near(locator, x[i], y[i])))
        if rule.vertices_only and (
            is_ghost(triangles, t) or coincident_vertex(vertices, triangles, px, py, t) < 0
        ):
            labels[i], marked[i] = UNCLASSIFIED, in_doubt[t] != 0
            continue
        terrain, _, marked[i] = is_terrain(
            vertices, triangles, t, px, py, pz, in_doubt, rule.limits, rule.floor
        )
        labels[i] = GROUND if terrain else UNCLASSIFIED
    return labels, marked


def label_points(
    tin: Tin, locator: Locator, points: Xyz, in_doubt: UInt8, rule: GroundRule
) -> tuple[UInt8, npt.NDArray[np.bool_]]:
    """Ground or not, against the finished TIN.

    Ours, not the papers': there, what lies in facets that take no more vertices is lost as type I. The rule is
    the one of densification; besides, a point within ``floor`` of its facet is ground whatever its angle, since
    close to a vertex noise alone makes any angle.

    Parameters
    ----------
    tin : Tin
    locator : Locator
        Of this TIN as it is now.
    points : Xyz
        In any order (fast where neighbours follow each other).
    in_doubt : uint8 [triangles]
        See `ptd.ground.certificates.Doubt.triangles`.
    rule : GroundRule

    Returns
    -------
    labels : uint8 [n]
        1 unclassified, 2 ground.
    marked : bool [n]
        Points outside the window could change the label.
    """
    if points.x.size and tin.n_triangles:
        label = _label_by_height if rule.heights_only and not rule.vertices_only else _label
        return label(tin.mesh, locator, points, in_doubt, rule)
    return np.full(points.x.size, UNCLASSIFIED, np.uint8), np.zeros(points.x.size, np.bool_)


class TinLabels(Model):
    """A window whose points are labelled against a TIN; as long as there is none, nothing but low noise is known.

    Parameters
    ----------
    closed : bool
        Points may lie beyond the window: without a TIN no label is certain.
    stats : dict
    low : LowNoise, optional
    """

    def __init__(self, closed: bool, stats: dict[str, Any], low: LowNoise | None = None) -> None:
        self.stats, self.low, self._closed = stats, low, closed
        self.tin: Tin | None = None

    def finish(self, tin: Tin, in_doubt: UInt8, rule: GroundRule) -> None:
        """Take a TIN, as it stays, to label with; see `label_points`."""
        self.tin, self._in_doubt, self._rule = tin, in_doubt, rule
        self._locator = Locator.of(tin)
        self.stats.update(vertices=tin.n_vertices)

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """ASPRS classes (uint8 [n]) and marks (bool [n]) of points, in any order."""
        xyz = Xyz(*points.columns())
        if self.tin is None:
            labels, marked = np.full(len(points), UNCLASSIFIED, np.uint8), np.full(len(points), self._closed)
        else:
            labels, marked = label_points(self.tin, self._locator, xyz, self._in_doubt, self._rule)
        if self.low is not None:
            others = np.flatnonzero(labels != GROUND)
            labels[others[self.low.holds(*(axis[others] for axis in xyz))]] = LOW_NOISE
        return labels, marked
