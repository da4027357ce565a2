"""The last step of most methods: label every point by its height above the finished TIN."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, UInt8
from ptd.cells import Xyz
from ptd.ground.certificates import CheckedMesh
from ptd.ground.criteria import FacetLimits, Point, across, facet_measures, judge
from ptd.ground.outliers import LowNoise
from ptd.kernel import as_int64, inlined, kernel
from ptd.passes import Model, Points, Stats
from ptd.places import Field, everywhere, value_at
from ptd.tin.facets import canonical_facet
from ptd.tin.mesh import Locator, Tin, start_near
from ptd.tin.triangles import coincident_vertex, is_ghost, locate, real_neighbour, walk

UNCLASSIFIED, GROUND, LOW_NOISE = 1, 2, 7
"""ASPRS classes that a filter gives."""
CLEAR = 1.0 - 1e-9
"""Factor just below 1 that outweighs rounding errors.

A point within `CLEAR` times the smallest limit of all places is ground, and one beyond the
largest limit / `CLEAR` is not.
"""
FAR, CROP, NEAR, ON = 0, 1, 2, 3
"""Degrees of closeness of a point to a TIN (`Closeness`)."""


@kernel
def is_terrain(
    vertices: Int32,
    triangles: Int32,
    uncertified: UInt8,
    t: int,
    point: Point,
    limits: FacetLimits,
    floor: float,
) -> tuple[bool, bool, bool]:
    """Apply the rule of `label_points` to a point in triangle t, which may be a ghost.

    Returns
    -------
    terrain : bool
    elsewhere : bool
        Whether the result depends on other triangles than t.
    is_uncertified : bool
        Whether the result depends on an uncertified triangle.
    """
    x, y, z = point
    is_uncertified = uncertified[t] != 0
    if is_ghost(triangles, t):
        return False, False, is_uncertified
    v = coincident_vertex(vertices, triangles, x, y, t)
    if v >= 0:
        return (
            abs(float(z - vertices[4 * v + 2])) * limits.z_ratio <= floor,
            False,
            is_uncertified,
        )
    beside = across(vertices, triangles, t, x, y)
    is_uncertified = is_uncertified or uncertified[beside] != 0
    measures = facet_measures(vertices, triangles, t, x, y, z, limits.z_ratio)
    if abs(measures[0]) <= floor:
        return True, beside != t, is_uncertified
    passed, mirrored, mirror_is_uncertified = judge(
        vertices, triangles, uncertified, t, point, measures, limits
    )
    return passed, mirrored or beside != t, is_uncertified or mirror_is_uncertified


class Closeness(NamedTuple):
    """Limits, in horizontal counts, of the distance to the TIN of points that are `ON`, `NEAR` or `CROP`.

    All other points are `FAR`.

    Attributes
    ----------
    on, near : float
        Largest heights above or below the TIN.
    on_slope, near_slope : float
        Additions to these heights per unit of slope.
    crop : float
        Addition to the limit of `NEAR` that gives the limit of `CROP`.
    """

    on: float = 0.0
    on_slope: float = 0.0
    near: float = 0.0
    near_slope: float = 0.0
    crop: float = 0.0


class LabelRule(NamedTuple):
    """Rule by which points are ground relative to the finished TIN (`label_points`).

    Attributes
    ----------
    limits : FacetLimits
    floor : float
        Distance to its facet within which a point is ground, in horizontal counts.
    vertices_only : bool
        Whether only points at the position and height of a vertex are ground.
    heights_only : bool
        Whether only the vertical distance to the TIN counts, at any angle. A point is ground up to
        ``floor + per_slope * slope`` above or below its facet, and up to ``floor`` at a vertex.
    per_slope : float
        Addition to `floor` per unit of the facet's slope, in horizontal counts.
    close : Closeness
        Limits for `label_by_height`.
    """

    limits: FacetLimits
    floor: float
    vertices_only: bool = False
    heights_only: bool = False
    per_slope: float = 0.0
    close: Closeness = Closeness()


class Bands(NamedTuple):
    """Fields ``floor`` and ``per_slope`` of a `LabelRule` by place, in horizontal counts."""

    floor: Field
    per_slope: Field


class _Limits(NamedTuple):
    """Smallest and largest figures of `Bands`, without its tables, which are expensive to pass to functions."""

    floor: float
    per_slope: float
    max_floor: float
    max_per_slope: float


@kernel
def _limits(bands: Bands) -> _Limits:
    floor, slope = bands
    return _Limits(floor.low, slope.low, floor.high, slope.high)


class _Facet(NamedTuple):
    """A real triangle with corners in local counts, the smallest in (x, y) first.

    It has only a few fields, because repeating some products per point is cheaper than keeping
    more numbers from point to point.
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
def _facet(vertices: Int32, triangles: Int32, t: int, z_ratio: float) -> _Facet:
    i, j, k = canonical_facet(vertices, triangles, t)
    a = as_int64(vertices[4 * i]), as_int64(vertices[4 * i + 1]), as_int64(vertices[4 * i + 2])
    b = as_int64(vertices[4 * j]), as_int64(vertices[4 * j + 1])
    c = as_int64(vertices[4 * k]), as_int64(vertices[4 * k + 1])
    bx, by, bz = float(b[0] - a[0]), float(b[1] - a[1]), (vertices[4 * j + 2] - a[2]) * z_ratio
    cx, cy, cz = float(c[0] - a[0]), float(c[1] - a[1]), (vertices[4 * k + 2] - a[2]) * z_ratio
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    n2 = nx * nx + ny * ny + nz * nz
    cos2 = nz * nz / n2
    return _Facet(
        t,
        a,
        b,
        c,
        (nx, ny, nz),
        math.sqrt(n2),
        math.sqrt(cos2),
        math.sqrt(max(1.0 - cos2, 0.0)),
    )


@inlined
def _closeness(distance: float, cos: float, sin: float, close: Closeness) -> int:
    """Return the closeness of a point from its distance to a facet, and the cosine and sine of the facet's slope.

    The distance to a facet is the height above it times the cosine of its slope, so the limits
    are multiplied too.
    """
    near = close.near * cos + close.near_slope * sin
    on = distance <= close.on * cos + close.on_slope * sin
    return int(on) + int(distance <= near) + int(distance <= near + close.crop * cos)


@inlined
def _distance(f: _Facet, x: int, y: int, z: int, z_ratio: float) -> float:
    """Return the distance of a point from a facet in horizontal counts."""
    dx, dy, dz = float(x - f.a[0]), float(y - f.a[1]), (z - f.a[2]) * z_ratio
    return abs((f.normal[0] * dx + f.normal[1] * dy + f.normal[2] * dz) / f.length)


@kernel
def _fits(f: _Facet, distance: float, x: int, y: int, bands: Bands) -> bool:
    """Return whether a point at a distance from a facet is ground by the limits of its place."""
    return (
        distance
        <= value_at(bands.floor, x, y) * f.cos + value_at(bands.per_slope, x, y) * f.sin
    )


@inlined
def _surely(f: _Facet, distance: float, limits: _Limits) -> tuple[bool, bool]:
    """Return whether a point at a distance from a facet is ground under the limits of every place.

    The second result is whether it is ground under the limits of no place.
    """
    least = CLEAR * (limits.floor * f.cos + limits.per_slope * f.sin)
    most = (limits.max_floor * f.cos + limits.max_per_slope * f.sin) * (1.0 / CLEAR)
    return distance <= least, distance > most


@kernel
def _on_vertex(
    height: int, x: int, y: int, z: int, rule: LabelRule, bands: Bands
) -> tuple[bool, int]:
    """Return whether a point at the position of a vertex is ground by its height, and its closeness."""
    distance, close = abs(float(z - height)) * rule.limits.z_ratio, rule.close
    fits = distance <= value_at(bands.floor, x, y)
    return fits, _closeness(distance, 1.0, 0.0, close)


@kernel
def _by_height(
    vertices: Int32,
    triangles: Int32,
    uncertified: UInt8,
    t: int,
    point: Point,
    rule: LabelRule,
    bands: Bands,
) -> tuple[bool, int, bool]:
    """Return whether the height of a point in triangle t makes it ground, and its closeness.

    The third result is whether both are uncertified. Triangle t may be a ghost.
    """
    x, y, z = point
    is_uncertified = uncertified[t] != 0
    if is_ghost(triangles, t):
        return False, FAR, is_uncertified
    v = coincident_vertex(vertices, triangles, x, y, t)
    if v >= 0:
        return *_on_vertex(as_int64(vertices[4 * v + 2]), x, y, z, rule, bands), is_uncertified
    is_uncertified = is_uncertified or uncertified[across(vertices, triangles, t, x, y)] != 0
    f = _facet(vertices, triangles, t, rule.limits.z_ratio)
    distance = _distance(f, x, y, z, rule.limits.z_ratio)
    fits = _fits(f, distance, x, y, bands)
    return fits, _closeness(distance, f.cos, f.sin, rule.close), is_uncertified


@inlined
def _inside(f: _Facet, x: int, y: int) -> bool:
    """Return whether a position lies in a triangle, and not on its border."""
    ax, ay, bx, by, cx, cy = (
        f.a[0] - x,
        f.a[1] - y,
        f.b[0] - x,
        f.b[1] - y,
        f.c[0] - x,
        f.c[1] - y,
    )
    return bool(ax * by - ay * bx > 0 and bx * cy - by * cx > 0 and cx * ay - cy * ax > 0)


@kernel
def _label_by_height(
    mesh: CheckedMesh, locator: Locator, points: Xyz, rule: LabelRule, bands: Bands
) -> tuple[UInt8, Bool, UInt8]:
    """Label points by height only, and measure their closeness. Consecutive points often lie in one facet."""
    vertices, triangles, uncertified = mesh
    x, y, z = points
    labels, uncertified_labels, close = (
        np.empty(x.size, np.uint8),
        np.empty(x.size, np.bool_),
        np.empty(x.size, np.uint8),
    )
    limits, z_ratio = _limits(bands), rule.limits.z_ratio
    facet = _facet(vertices, triangles, real_neighbour(triangles, as_int64(0)), z_ratio)
    for i in range(x.size):
        px, py, pz = as_int64(x[i]), as_int64(y[i]), as_int64(z[i])
        if not _inside(facet, px, py):
            t = walk(vertices, triangles, px, py, as_int64(start_near(locator, x[i], y[i])))
            v = coincident_vertex(vertices, triangles, px, py, t)
            # One point in ten is at a vertex. `locate` and `_by_height` would search again.
            if v >= 0:
                fits, close[i] = _on_vertex(
                    as_int64(vertices[4 * v + 2]), px, py, pz, rule, bands
                )
                labels[i] = GROUND if fits else UNCLASSIFIED
                uncertified_labels[i] = uncertified[t] != 0
                continue
            if not is_ghost(triangles, t):
                facet = _facet(vertices, triangles, t, z_ratio)
            if is_ghost(triangles, t) or not _inside(facet, px, py):
                t = locate(vertices, triangles, px, py, t)
                terrain, close[i], uncertified_labels[i] = _by_height(
                    vertices, triangles, uncertified, t, (px, py, pz), rule, bands
                )
                labels[i] = GROUND if terrain else UNCLASSIFIED
                continue
        distance = _distance(facet, px, py, pz, z_ratio)
        close[i] = _closeness(distance, facet.cos, facet.sin, rule.close)
        fits, never = _surely(facet, distance, limits)
        if not fits and not never:
            fits = _fits(facet, distance, px, py, bands)
        labels[i] = GROUND if fits else UNCLASSIFIED
        uncertified_labels[i] = uncertified[facet.t] != 0
    return labels, uncertified_labels, close


@kernel
def _label(
    mesh: CheckedMesh, locator: Locator, points: Xyz, rule: LabelRule
) -> tuple[UInt8, Bool]:
    vertices, triangles, uncertified = mesh
    x, y, z = points
    labels, uncertified_labels = np.empty(x.size, np.uint8), np.empty(x.size, np.bool_)
    for i in range(x.size):
        px, py, pz = as_int64(x[i]), as_int64(y[i]), as_int64(z[i])
        t = locate(vertices, triangles, px, py, as_int64(start_near(locator, x[i], y[i])))
        if rule.vertices_only and (
            is_ghost(triangles, t) or coincident_vertex(vertices, triangles, px, py, t) < 0
        ):
            labels[i], uncertified_labels[i] = UNCLASSIFIED, uncertified[t] != 0
            continue
        terrain, _, uncertified_labels[i] = is_terrain(
            vertices, triangles, uncertified, t, (px, py, pz), rule.limits, rule.floor
        )
        labels[i] = GROUND if terrain else UNCLASSIFIED
    return labels, uncertified_labels


def label_points(
    tin: Tin,
    locator: Locator,
    points: Xyz,
    uncertified: UInt8,
    rule: LabelRule,
    bands: Bands | None = None,
) -> tuple[UInt8, Bool]:
    """Label points as ground or not by the finished TIN.

    This step is not in the papers, which lose points in facets that take no more vertices (type
    I errors). The rule is that of densification. In addition, a point within ``floor`` of its
    facet is ground at any angle, because near a vertex, noise alone can cause any angle.

    Parameters
    ----------
    tin : Tin
    locator : Locator
        Locator of the TIN in its current state.
    points : Xyz
        Points in any order. Labelling is fast if successive points are neighbours.
    uncertified : uint8 [triangles]
        Mask of uncertified triangles (`ptd.ground.certificates.UncertifiedRegion.triangles`).
    rule : LabelRule
    bands : Bands, optional
        Fields ``floor`` and ``per_slope`` of a rule with ``heights_only`` set, if they differ by place.

    Returns
    -------
    labels : uint8 [n]
        ASPRS classes: 1 unclassified, 2 ground.
    uncertified_labels : bool [n]
        Mask of the labels that points outside the window could change.
    """
    if rule.heights_only and not rule.vertices_only:
        return label_by_height(tin, locator, points, uncertified, rule, bands)[:2]
    if points.x.size and tin.n_triangles:
        return _label(CheckedMesh(*tin.mesh, uncertified), locator, points, rule)
    return np.full(points.x.size, UNCLASSIFIED, np.uint8), np.zeros(points.x.size, np.bool_)


def label_by_height(
    tin: Tin,
    locator: Locator,
    points: Xyz,
    uncertified: UInt8,
    rule: LabelRule,
    bands: Bands | None = None,
) -> tuple[UInt8, Bool, UInt8]:
    """Label points like `label_points` by a rule with ``heights_only`` set.

    The third result is the closeness of each point to the TIN: uint8 [n].
    """
    if points.x.size and tin.n_triangles:
        bands = bands or Bands(everywhere(rule.floor), everywhere(rule.per_slope))
        return _label_by_height(
            CheckedMesh(*tin.mesh, uncertified), locator, points, rule, bands
        )
    n = points.x.size
    return np.full(n, UNCLASSIFIED, np.uint8), np.zeros(n, np.bool_), np.full(n, FAR, np.uint8)


class TinLabels(Model):
    """Model that labels the points of a window by a TIN. Without a TIN it labels only low noise.

    Parameters
    ----------
    closed : bool
        Whether points may lie beyond the window, so that no label is certified without a TIN.
    stats : dict
    low : LowNoise, optional
    """

    def __init__(self, closed: bool, stats: Stats, low: LowNoise | None = None) -> None:
        self.stats, self.low, self._closed = stats, low, closed
        self.tin: Tin | None = None

    def finish(
        self, tin: Tin, uncertified: UInt8, rule: LabelRule, bands: Bands | None = None
    ) -> None:
        """Set the finished TIN and the rule of labelling. `label_points` describes the parameters."""
        self.tin, self.uncertified, self.rule, self.bands = tin, uncertified, rule, bands
        self.locator = Locator.of(tin)
        self.stats.update(vertices=tin.n_vertices)

    def judged(self, tin: Tin, points: Xyz) -> tuple[UInt8, Bool]:
        """Return labels and a mask of uncertified labels by the finished TIN (`label_points`)."""
        return label_points(tin, self.locator, points, self.uncertified, self.rule, self.bands)

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Return ASPRS classes (uint8 [n]) and a mask of uncertified labels (bool [n]) of points in any order."""
        xyz = Xyz(*points.columns())
        if self.tin is None:
            labels, uncertified_labels = (
                np.full(len(points), UNCLASSIFIED, np.uint8),
                np.full(len(points), self._closed),
            )
        else:
            labels, uncertified_labels = self.judged(self.tin, xyz)
        if self.low is not None:
            labels[self.low.holds(*xyz, among=labels != GROUND)] = LOW_NOISE
        return labels, uncertified_labels
