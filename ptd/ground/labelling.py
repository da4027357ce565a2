"""The last step of most methods: label every point by its height above the finished TIN."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import Xyz
from ptd.ground.certificates import UInt8
from ptd.ground.criteria import FacetLimits, across, facet_measures, judge
from ptd.ground.outliers import LowNoise
from ptd.kernel import as_int64, inlined, kernel
from ptd.passes import Model, Points
from ptd.places import Field, everywhere, value_at
from ptd.tin.interpolation import canonical_facet
from ptd.tin.layout import Int32Array, Mesh, is_ghost, real_neighbour
from ptd.tin.location import coincident_vertex, locate, walk
from ptd.tin.locator import Locator, start_near
from ptd.tin.mesh import Tin

UNCLASSIFIED, GROUND, LOW_NOISE = 1, 2, 7
"""ASPRS classes that a filter gives."""
CLEAR = 1.0 - 1e-9
"""Factor that widens the range of limits by place by more than rounding can change them."""
FAR, CROP, NEAR, ON = 0, 1, 2, 3
"""Steps of closeness of a point to a TIN, see `Closeness`."""


@kernel
def is_terrain(
    vertices: Int32Array,
    triangles: Int32Array,
    t: int,
    x: int,
    y: int,
    z: int,
    in_doubt: UInt8,
    limits: FacetLimits,
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


class Closeness(NamedTuple):
    """How close to the TIN points are called `ON`, `NEAR` and `CROP`; all others are `FAR`. Horizontal counts.

    Attributes
    ----------
    on, near : float
        Heights above or below it.
    on_slope, near_slope : float
        So much more per unit of slope.
    crop : float
        So much more than near.
    """

    on: float = 0.0
    on_slope: float = 0.0
    near: float = 0.0
    near_slope: float = 0.0
    crop: float = 0.0


class LabelRule(NamedTuple):
    """When a point is ground, against the finished TIN (`label_points`).

    Attributes
    ----------
    limits : FacetLimits
    floor : float
        Horizontal counts.
    vertices_only : bool
        Without a last pass: only what lies on a vertex, at its height, is ground.
    heights_only : bool
        Ground is what lies no more than ``floor + per_slope * slope`` (slope of the facet; on a vertex the floor) above
        or below the TIN, measured upright, whatever its angle.
    per_slope : float
        Horizontal counts.
    close : Closeness
        For `label_by_height`.
    """

    limits: FacetLimits
    floor: float
    vertices_only: bool = False
    heights_only: bool = False
    per_slope: float = 0.0
    close: Closeness = Closeness()


class Bands(NamedTuple):
    """``floor`` and ``per_slope`` of a `LabelRule` by place, horizontal counts."""

    floor: Field
    per_slope: Field


class _Limits(NamedTuple):
    """Least and largest figures of `Bands`: without the tables, which cost more to hand on than to use."""

    floor: float
    per_slope: float
    max_floor: float
    max_per_slope: float


@kernel
def _limits(bands: Bands) -> _Limits:
    floor, slope = bands
    return _Limits(floor.low, slope.low, floor.high, slope.high)


class _Facet(NamedTuple):
    """A real triangle; corners in local counts, the smallest in (x, y) first.

    What is the same for all facets is not kept: fewer numbers that live on from point to point are worth more than a
    few products.
    """

    t: int
    a: tuple[int, int, int]
    b: tuple[int, int]
    c: tuple[int, int]
    normal: tuple[float, float, float]
    length: float
    cos: float
    sin: float


@inlined
def _facet(vertices: Int32Array, triangles: Int32Array, t: int, z_ratio: float) -> _Facet:
    i, j, k = canonical_facet(vertices, triangles, t)
    a = as_int64(vertices[4 * i]), as_int64(vertices[4 * i + 1]), as_int64(vertices[4 * i + 2])
    b = as_int64(vertices[4 * j]), as_int64(vertices[4 * j + 1])
    c = as_int64(vertices[4 * k]), as_int64(vertices[4 * k + 1])
    bx, by, bz = float(b[0] - a[0]), float(b[1] - a[1]), (vertices[4 * j + 2] - a[2]) * z_ratio
    cx, cy, cz = float(c[0] - a[0]), float(c[1] - a[1]), (vertices[4 * k + 2] - a[2]) * z_ratio
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    n2 = nx * nx + ny * ny + nz * nz
    cos2 = nz * nz / n2
    return _Facet(t, a, b, c, (nx, ny, nz), math.sqrt(n2), math.sqrt(cos2), math.sqrt(max(1.0 - cos2, 0.0)))


@inlined
def _closeness(distance: float, cos: float, sin: float, close: Closeness) -> int:
    """How close a point at some distance from a facet is, given the cosine and sine of the facet's slope.

    The distance to a facet is the height above it times the cosine of its slope; so is what is allowed.
    """
    near = close.near * cos + close.near_slope * sin
    on = distance <= close.on * cos + close.on_slope * sin
    return int(on) + int(distance <= near) + int(distance <= near + close.crop * cos)


@inlined
def _distance(f: _Facet, x: int, y: int, z: int, z_ratio: float) -> float:
    """From a facet, horizontal counts."""
    dx, dy, dz = float(x - f.a[0]), float(y - f.a[1]), (z - f.a[2]) * z_ratio
    return abs((f.normal[0] * dx + f.normal[1] * dy + f.normal[2] * dz) / f.length)


@kernel
def _fits(f: _Facet, distance: float, x: int, y: int, bands: Bands) -> bool:
    """Whether a point at some distance from a facet is ground by the limits of its place."""
    return distance <= value_at(bands.floor, x, y) * f.cos + value_at(bands.per_slope, x, y) * f.sin


@inlined
def _surely(f: _Facet, distance: float, limits: _Limits) -> tuple[bool, bool]:
    """Whether a point at some distance from a facet is ground at any place, and whether it is at none."""
    least = CLEAR * (limits.floor * f.cos + limits.per_slope * f.sin)
    most = (limits.max_floor * f.cos + limits.max_per_slope * f.sin) * (1.0 / CLEAR)
    return distance <= least, distance > most


@kernel
def _on_vertex(height: int, x: int, y: int, z: int, rule: LabelRule, bands: Bands) -> tuple[bool, int]:
    """Whether a point at the position of a vertex lies near it in height, and how close."""
    distance, close = abs(float(z - height)) * rule.limits.z_ratio, rule.close
    fits = distance <= value_at(bands.floor, x, y)
    return fits, _closeness(distance, 1.0, 0.0, close)


@kernel
def _is_near(
    vertices: Int32Array,
    triangles: Int32Array,
    t: int,
    x: int,
    y: int,
    z: int,
    in_doubt: UInt8,
    rule: LabelRule,
    bands: Bands,
) -> tuple[bool, int, bool]:
    """Whether a point in triangle t, which may be a ghost, lies near it in height, how close, and if it is doubtful."""
    doubtful = in_doubt[t] != 0
    if is_ghost(triangles, t):
        return False, FAR, doubtful
    v = coincident_vertex(vertices, triangles, x, y, t)
    if v >= 0:
        return *_on_vertex(as_int64(vertices[4 * v + 2]), x, y, z, rule, bands), doubtful
    doubtful = doubtful or in_doubt[across(vertices, triangles, t, x, y)] != 0
    f = _facet(vertices, triangles, t, rule.limits.z_ratio)
    distance = _distance(f, x, y, z, rule.limits.z_ratio)
    fits = _fits(f, distance, x, y, bands)
    return fits, _closeness(distance, f.cos, f.sin, rule.close), doubtful


@inlined
def _inside(f: _Facet, x: int, y: int) -> bool:
    """Whether a position lies in a triangle, and not on its border."""
    ax, ay, bx, by, cx, cy = f.a[0] - x, f.a[1] - y, f.b[0] - x, f.b[1] - y, f.c[0] - x, f.c[1] - y
    return bool(ax * by - ay * bx > 0 and bx * cy - by * cx > 0 and cx * ay - cy * ax > 0)


@kernel
def _label_by_height(
    mesh: Mesh, locator: Locator, points: Xyz, in_doubt: UInt8, rule: LabelRule, bands: Bands
) -> tuple[UInt8, npt.NDArray[np.bool_], UInt8]:
    """Label points by height alone, and measure how close they are. Consecutive points often lie in one facet."""
    vertices, triangles = mesh
    x, y, z = points
    labels, marked, close = np.empty(x.size, np.uint8), np.empty(x.size, np.bool_), np.empty(x.size, np.uint8)
    limits, z_ratio = _limits(bands), rule.limits.z_ratio
    facet = _facet(vertices, triangles, real_neighbour(triangles, as_int64(0)), z_ratio)
    for i in range(x.size):
        px, py, pz = as_int64(x[i]), as_int64(y[i]), as_int64(z[i])
        if not _inside(facet, px, py):
            t = walk(vertices, triangles, px, py, as_int64(start_near(locator, x[i], y[i])))
            v = coincident_vertex(vertices, triangles, px, py, t)
            if v >= 0:  # as one point in ten does; `_is_near` would say the same, but locate it again
                fits, close[i] = _on_vertex(as_int64(vertices[4 * v + 2]), px, py, pz, rule, bands)
                labels[i] = GROUND if fits else UNCLASSIFIED
                marked[i] = in_doubt[t] != 0
                continue
            if not is_ghost(triangles, t):
                facet = _facet(vertices, triangles, t, z_ratio)
            if is_ghost(triangles, t) or not _inside(facet, px, py):
                t = locate(vertices, triangles, px, py, t)
                terrain, close[i], marked[i] = _is_near(
                    vertices, triangles, t, px, py, pz, in_doubt, rule, bands
                )
                labels[i] = GROUND if terrain else UNCLASSIFIED
                continue
        distance = _distance(facet, px, py, pz, z_ratio)
        close[i] = _closeness(distance, facet.cos, facet.sin, rule.close)
        fits, never = _surely(facet, distance, limits)
        if not fits and not never:
            fits = _fits(facet, distance, px, py, bands)
        labels[i] = GROUND if fits else UNCLASSIFIED
        marked[i] = in_doubt[facet.t] != 0
    return labels, marked, close


@kernel
def _label(
    mesh: Mesh, locator: Locator, points: Xyz, in_doubt: UInt8, rule: LabelRule
) -> tuple[UInt8, npt.NDArray[np.bool_]]:
    vertices, triangles = mesh
    x, y, z = points
    labels, marked = np.empty(x.size, np.uint8), np.empty(x.size, np.bool_)
    for i in range(x.size):
        px, py, pz = as_int64(x[i]), as_int64(y[i]), as_int64(z[i])
        t = locate(vertices, triangles, px, py, as_int64(start_near(locator, x[i], y[i])))
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
    tin: Tin, locator: Locator, points: Xyz, in_doubt: UInt8, rule: LabelRule, bands: Bands | None = None
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
        See `ptd.ground.certificates.UncertifiedRegion.triangles`.
    rule : LabelRule
    bands : Bands, optional
        For `heights_only`, where ``floor`` and ``per_slope`` of the rule differ by place.

    Returns
    -------
    labels : uint8 [n]
        1 unclassified, 2 ground.
    marked : bool [n]
        Points outside the window could change the label.
    """
    if rule.heights_only and not rule.vertices_only:
        return label_by_height(tin, locator, points, in_doubt, rule, bands)[:2]
    if points.x.size and tin.n_triangles:
        return _label(tin.mesh, locator, points, in_doubt, rule)
    return np.full(points.x.size, UNCLASSIFIED, np.uint8), np.zeros(points.x.size, np.bool_)


def label_by_height(
    tin: Tin, locator: Locator, points: Xyz, in_doubt: UInt8, rule: LabelRule, bands: Bands | None = None
) -> tuple[UInt8, npt.NDArray[np.bool_], UInt8]:
    """`label_points` for a rule of ``heights_only``, and how close to the TIN each point is: uint8 [n]."""
    if points.x.size and tin.n_triangles:
        bands = bands or Bands(everywhere(rule.floor), everywhere(rule.per_slope))
        return _label_by_height(tin.mesh, locator, points, in_doubt, rule, bands)
    n = points.x.size
    return np.full(n, UNCLASSIFIED, np.uint8), np.zeros(n, np.bool_), np.full(n, FAR, np.uint8)


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

    def finish(self, tin: Tin, in_doubt: UInt8, rule: LabelRule, bands: Bands | None = None) -> None:
        """Take a TIN, as it stays, to label with; see `label_points`."""
        self.tin, self.in_doubt, self.rule, self.bands = tin, in_doubt, rule, bands
        self.locator = Locator.of(tin)
        self.stats.update(vertices=tin.n_vertices)

    def judged(self, tin: Tin, points: Xyz) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """Labels and marks of `label_points`, against the TIN that was taken."""
        return label_points(tin, self.locator, points, self.in_doubt, self.rule, self.bands)

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """ASPRS classes (uint8 [n]) and marks (bool [n]) of points, in any order."""
        xyz = Xyz(*points.columns())
        if self.tin is None:
            labels, marked = np.full(len(points), UNCLASSIFIED, np.uint8), np.full(len(points), self._closed)
        else:
            labels, marked = self.judged(self.tin, xyz)
        if self.low is not None:
            labels[self.low.holds(*xyz, among=labels != GROUND)] = LOW_NOISE
        return labels, marked
