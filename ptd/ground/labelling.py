"""The last step of most methods: label every point by its height above the finished TIN."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import CellIndex, Int32, Xyz
from ptd.frame import Cells
from ptd.ground.certificates import UInt8
from ptd.ground.criteria import Limits, across, facet_measures, judge
from ptd.kernel import kernel, wide
from ptd.passes import Points
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
    distance, _nearest, cos2, _edge = facet_measures(vertices, triangles, t, x, y, z, rule.limits.z_ratio)
    # The distance to a facet is the height above it times the cosine of its slope; so is what is allowed.
    allowed = rule.floor * math.sqrt(cos2) + rule.per_slope * math.sqrt(max(1.0 - cos2, 0.0))
    return abs(distance) <= allowed, doubtful


class _Facet(NamedTuple):
    """A real triangle, and what `_is_near` needs of it: corners, local counts; plane and limit, horizontal counts.

    The plane is given by its lexicographically smallest corner and its normal, as `facet_measures` has them.
    """

    t: int
    ax: int
    ay: int
    bx: int
    by: int
    cx: int
    cy: int
    x: int
    y: int
    z: int
    nx: float
    ny: float
    nz: float
    length: float
    allowed: float


@kernel
def _facet(vertices: Int32Array, triangles: Int32Array, t: int, rule: GroundRule) -> _Facet:
    i, j, k = triangles[8 * t + 4], triangles[8 * t + 5], triangles[8 * t + 6]
    a, b, c = canonical_facet(vertices, triangles, t)
    x, y, z = vertices[4 * a], vertices[4 * a + 1], vertices[4 * a + 2]
    ratio = rule.limits.z_ratio
    bx, by, bz = float(vertices[4 * b] - x), float(vertices[4 * b + 1] - y), (vertices[4 * b + 2] - z) * ratio
    cx, cy, cz = float(vertices[4 * c] - x), float(vertices[4 * c + 1] - y), (vertices[4 * c + 2] - z) * ratio
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    n2 = nx * nx + ny * ny + nz * nz
    cos2 = nz * nz / n2
    # The distance to a facet is the height above it times the cosine of its slope; so is what is allowed.
    allowed = rule.floor * math.sqrt(cos2) + rule.per_slope * math.sqrt(max(1.0 - cos2, 0.0))
    return _Facet(
        t,
        wide(vertices[4 * i]),
        wide(vertices[4 * i + 1]),
        wide(vertices[4 * j]),
        wide(vertices[4 * j + 1]),
        wide(vertices[4 * k]),
        wide(vertices[4 * k + 1]),
        wide(x),
        wide(y),
        wide(z),
        nx,
        ny,
        nz,
        math.sqrt(n2),
        allowed,
    )


@kernel
def _inside(f: _Facet, x: int, y: int) -> bool:
    """Whether a position lies in a triangle, and not on its border."""
    ax, ay, bx, by, cx, cy = f.ax - x, f.ay - y, f.bx - x, f.by - y, f.cx - x, f.cy - y
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
        dx, dy, dz = float(px - facet.x), float(py - facet.y), (pz - facet.z) * rule.limits.z_ratio
        distance = (facet.nx * dx + facet.ny * dy + facet.nz * dz) / facet.length
        labels[i] = GROUND if abs(distance) <= facet.allowed else UNCLASSIFIED
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
        terrain, _elsewhere, marked[i] = is_terrain(
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


class LowNoise:
    """Where low outliers were found: points of the same cell that are not higher are low noise as well.

    Parameters
    ----------
    x, y, z : int32 [n]
        The outliers, local counts.
    cells : Cells
        Of which the lowest points were looked at.
    """

    def __init__(self, x: Int32, y: Int32, z: Int32, cells: Cells) -> None:
        self._index = CellIndex(x, y, cells) if x.size else None
        if self._index is not None:
            self._heights = np.maximum.reduceat(z[self._index.table.order], self._index.table.starts[:-1])

    def holds(self, x: Int32, y: Int32, z: Int32) -> npt.NDArray[np.bool_]:
        """Whether points are low noise: bool [n]."""
        if self._index is None:
            return np.zeros(z.size, np.bool_)
        found: npt.NDArray[np.bool_] = z <= self._heights.max()  # most lie above all of them
        low = np.flatnonzero(found)
        cell = self._index.find(x[low], y[low])
        found[low] = (cell >= 0) & (z[low] <= self._heights[cell])
        return found


class Terrain:
    """A finished TIN that tells ground from the rest.

    Parameters
    ----------
    tin : Tin
        As it stays.
    in_doubt : uint8 [triangles]
        See `ptd.ground.certificates.Doubt.triangles`.
    low : LowNoise
    rule : GroundRule
    """

    def __init__(self, tin: Tin, in_doubt: UInt8, low: LowNoise, rule: GroundRule) -> None:
        self.tin, self._in_doubt, self._low, self._rule = tin, in_doubt, low, rule
        self._locator = Locator.of(tin)

    def label(self, points: Points) -> tuple[UInt8, npt.NDArray[np.bool_]]:
        """ASPRS classes (uint8 [n]) and marks (bool [n]) of points, in any order."""
        xyz = Xyz(*(np.ascontiguousarray(c) for c in points.xyz))
        labels, marked = label_points(self.tin, self._locator, xyz, self._in_doubt, self._rule)
        labels[(labels != GROUND) & self._low.holds(*xyz)] = LOW_NOISE
        return labels, marked


def unlabelled(points: Points, closed: bool) -> tuple[UInt8, npt.NDArray[np.bool_]]:
    """Labels and marks of a window without a TIN: unclassified, for certain only if nothing lies beyond the window."""
    return np.full(len(points), UNCLASSIFIED, np.uint8), np.full(len(points), closed)
