"""Axelsson's test of whether a point may join the facet in which it lies.

Source: Axelsson (2000), DEM generation from laser scanner data using adaptive TIN models; the
edge rules are those of Dong (2018), section 2.1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptd.arrays import Int32, UInt8
from ptd.frame import Scale
from ptd.kernel import as_int64, kernel
from ptd.tin.facets import canonical_facet
from ptd.tin.triangles import coincident_vertex, is_ghost, lexicographic_less, locate

Measures = tuple[float, float, float, float]
"""Result of `facet_measures`."""
Point = tuple[int, int, int]
"""x, y and z in local counts."""


class FacetLimits(NamedTuple):
    """Thresholds of the facet test in horizontal counts and radians.

    Attributes
    ----------
    distance : float
        Iteration distance: largest distance from the point to the facet's plane.
    angle : float
        Iteration angle: limit of the largest angle between the facet's plane and the lines from the point to the
        corners.
    steep_cos2 : float
        Squared cosine of the terrain angle. A facet whose normal is more inclined mirrors its points.
    reduce_edge : float
        Length of the facet's longest edge below which the angle shrinks in proportion; 0: never.
    stop_edge : float
        Length of the longest edge below which a facet takes no more vertices; 0: never.
    z_ratio : float
        Horizontal counts in one vertical count.
    """

    distance: float
    angle: float
    steep_cos2: float
    reduce_edge: float
    stop_edge: float
    z_ratio: float

    @classmethod
    def of(
        cls,
        scale: Scale,
        *,
        distance_m: float,
        angle_deg: float,
        terrain_deg: float,
        reduce_m: float = 0.0,
        stop_m: float = 0.0,
    ) -> FacetLimits:
        """Convert metres and degrees."""
        return cls(
            scale.counts(distance_m),
            math.radians(angle_deg),
            math.cos(math.radians(terrain_deg)) ** 2,
            scale.counts(reduce_m),
            scale.counts(stop_m),
            scale.z_ratio,
        )


@kernel
def facet_measures(
    vertices: Int32, triangles: Int32, t: int, x: int, y: int, z: int, z_ratio: float
) -> Measures:
    """Measure the position of a point relative to a real facet.

    Everything is computed relative to the facet's lexicographically smallest corner and in one
    order of the corners. So the same facet and point give the same bits in any tile.

    Returns
    -------
    distance : float
        Distance from the facet's plane to the point in horizontal counts, positive above it.
    nearest : float
        Distance in space from the point to the nearest corner, in horizontal counts.
    cos2 : float
        Squared cosine of the facet's slope.
    edge : float
        Length of the longest edge in plan, in horizontal counts.
    """
    a, b, c = canonical_facet(vertices, triangles, t)
    ax, ay, az = vertices[4 * a], vertices[4 * a + 1], vertices[4 * a + 2]
    bx, by = float(vertices[4 * b] - ax), float(vertices[4 * b + 1] - ay)
    cx, cy = float(vertices[4 * c] - ax), float(vertices[4 * c + 1] - ay)
    bz, cz = (vertices[4 * b + 2] - az) * z_ratio, (vertices[4 * c + 2] - az) * z_ratio
    px, py, pz = float(x - ax), float(y - ay), (z - az) * z_ratio
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    n2 = nx * nx + ny * ny + nz * nz
    distance = (nx * px + ny * py + nz * pz) / math.sqrt(n2)
    to_a = px * px + py * py + pz * pz
    to_b = (px - bx) * (px - bx) + (py - by) * (py - by) + (pz - bz) * (pz - bz)
    to_c = (px - cx) * (px - cx) + (py - cy) * (py - cy) + (pz - cz) * (pz - cz)
    nearest = math.sqrt(min(to_a, to_b, to_c))
    edge2 = max(
        bx * bx + by * by, cx * cx + cy * cy, (cx - bx) * (cx - bx) + (cy - by) * (cy - by)
    )
    return distance, nearest, nz * nz / n2, math.sqrt(edge2)


@kernel
def within(distance: float, nearest: float, edge: float, limits: FacetLimits) -> bool:
    """Return whether distance and angle are within the limits."""
    if abs(distance) > limits.distance:
        return False
    angle = limits.angle
    if edge < limits.reduce_edge:
        angle *= edge / limits.reduce_edge
    return abs(distance) <= nearest * math.sin(angle)


@kernel
def mirror_facet(
    vertices: Int32, triangles: Int32, t: int, x: int, y: int
) -> tuple[int, int, int]:
    """Mirror a point in plan through the facet's highest corner.

    Of equally high corners the lexicographically smallest counts. The height of the point
    stays. If it were mirrored as well, a point beyond the edge of a terrace would be tested
    below the terrace.

    Returns
    -------
    t : int
        Triangle at the mirrored position.
    x, y : int
        Mirrored position.
    """
    corners = canonical_facet(vertices, triangles, t)
    top = corners[0]
    for v in corners[1:]:
        higher = vertices[4 * v + 2] > vertices[4 * top + 2]
        tie = vertices[4 * v + 2] == vertices[4 * top + 2]
        x0, y0, x1, y1 = (
            vertices[4 * v],
            vertices[4 * v + 1],
            vertices[4 * top],
            vertices[4 * top + 1],
        )
        if higher or (
            tie and lexicographic_less(as_int64(x0), as_int64(y0), as_int64(x1), as_int64(y1))
        ):
            top = v
    mx, my = 2 * vertices[4 * top] - x, 2 * vertices[4 * top + 1] - y
    return locate(vertices, triangles, mx, my, t), mx, my


@kernel
def across(vertices: Int32, triangles: Int32, t: int, x: int, y: int) -> int:
    """Return the triangle across the edge of t on which (x, y) lies, or t if it lies on no edge or on a corner.

    Which of the two triangles owns the position depends on both, so a result there depends on
    both.
    """
    row = 8 * t
    if is_ghost(triangles, t):
        return t
    i, j, k = 4 * triangles[row + 4], 4 * triangles[row + 5], 4 * triangles[row + 6]
    ax, ay = vertices[i] - x, vertices[i + 1] - y
    bx, by = vertices[j] - x, vertices[j + 1] - y
    cx, cy = vertices[k] - x, vertices[k + 1] - y
    on_a, on_b, on_c = bx * cy - by * cx == 0, cx * ay - cy * ax == 0, ax * by - ay * bx == 0
    if on_a and not (on_b or on_c):
        return int(triangles[row] >> 3)
    if on_b and not (on_a or on_c):
        return int(triangles[row + 1] >> 3)
    if on_c and not (on_a or on_b):
        return int(triangles[row + 2] >> 3)
    return t


@kernel
def accepts(
    vertices: Int32,
    triangles: Int32,
    uncertified: UInt8,
    t: int,
    point: Point,
    limits: FacetLimits,
) -> tuple[bool, bool, bool]:
    """Test a point in the real triangle t by Axelsson's criteria.

    At the position of a vertex, t may be any of its triangles, and only a point at the vertex's
    height passes.

    Parameters
    ----------
    uncertified : uint8 [triangles]
        Mask of uncertified triangles (`ptd.ground.certificates.UncertifiedRegion.triangles`).

    Returns
    -------
    passed : bool
        Whether the point belongs to the terrain.
    elsewhere : bool
        Whether the result depends on other triangles than t.
    is_uncertified : bool
        Whether the result depends on an uncertified triangle.
    """
    x, y, z = point
    v = coincident_vertex(vertices, triangles, x, y, t)
    if v >= 0:
        return z == vertices[4 * v + 2], False, uncertified[t] != 0
    beside = across(vertices, triangles, t, x, y)
    is_uncertified = uncertified[t] != 0 or uncertified[beside] != 0
    measures = facet_measures(vertices, triangles, t, x, y, z, limits.z_ratio)
    passed, mirrored, mirror_is_uncertified = judge(
        vertices, triangles, uncertified, t, point, measures, limits
    )
    return passed, mirrored or beside != t, is_uncertified or mirror_is_uncertified


@kernel
def judge(
    vertices: Int32,
    triangles: Int32,
    uncertified: UInt8,
    t: int,
    point: Point,
    measures: Measures,
    limits: FacetLimits,
) -> tuple[bool, bool, bool]:
    """Test a point that is not at a vertex, like `accepts`, from its `facet_measures`.

    Returns
    -------
    passed : bool
        Whether the point belongs to the terrain.
    mirrored : bool
        Whether the point was tested at its mirrored position.
    is_uncertified : bool
        Whether a triangle at the mirrored position is uncertified.
    """
    x, y, z = point
    distance, nearest, cos2, edge = measures
    if edge < limits.stop_edge:
        return False, False, False
    if cos2 >= limits.steep_cos2:
        return within(distance, nearest, edge, limits), False, False
    other, mx, my = mirror_facet(vertices, triangles, t, x, y)
    is_uncertified = uncertified[other] != 0
    if is_ghost(triangles, other):
        return False, True, is_uncertified
    v = coincident_vertex(vertices, triangles, mx, my, other)
    if v >= 0:
        return z == vertices[4 * v + 2], True, is_uncertified
    is_uncertified = (
        is_uncertified or uncertified[across(vertices, triangles, other, mx, my)] != 0
    )
    distance, nearest, cos2, edge = facet_measures(
        vertices, triangles, other, mx, my, z, limits.z_ratio
    )
    return within(distance, nearest, edge, limits), True, is_uncertified
