"""Axelsson's test: may a point join the facet that it lies in? (Axelsson, 2000; its edge rules as in Dong 2018, 2.1)."""

from __future__ import annotations

import math
from typing import NamedTuple

from ptd.frame import Scale
from ptd.kernel import kernel
from ptd.tin.interpolation import canonical_facet
from ptd.tin.layout import Int32Array, is_ghost
from ptd.tin.location import locate


class Limits(NamedTuple):
    """Thresholds of the facet test in horizontal counts and radians; 0 turns an edge rule off.

    Attributes
    ----------
    distance : float
        Iteration distance: from the point to the facet's plane.
    angle : float
        Iteration angle: the largest of the angles between the facet's plane and the lines from the point to its corners.
    steep_cos2 : float
        Squared cosine of the terrain angle: a facet whose normal is more inclined mirrors its points.
    reduce_edge : float
        Below this length of the facet's longest edge the angle shrinks in proportion.
    stop_edge : float
        A facet whose longest edge is shorter takes no more vertices.
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
    ) -> Limits:
        """From metres and degrees."""
        return cls(
            scale.counts(distance_m), math.radians(angle_deg), math.cos(math.radians(terrain_deg)) ** 2,
            scale.counts(reduce_m), scale.counts(stop_m), scale.z_ratio,
        )  # fmt: skip


@kernel
def facet_measures(
    vertices: Int32Array, triangles: Int32Array, t: int, x: int, y: int, z: int, z_ratio: float
) -> tuple[float, float, float, float]:
    """How a point lies to a real facet.

    Everything is computed relative to the facet's lexicographically smallest corner and in one order of the corners, so
    the same facet and point give the same bits in any tile.

    Returns
    -------
    distance : float
        From the point to the facet's plane, horizontal counts, positive above.
    nearest : float
        From the point to the nearest corner in space, horizontal counts.
    cos2 : float
        Squared cosine of the facet's slope.
    edge : float
        Longest edge in plan, horizontal counts.
    """
    a, b, c = canonical_facet(vertices, triangles, t)
    ax, ay, az = vertices[4 * a], vertices[4 * a + 1], vertices[4 * a + 2]
    bx, by, bz = (
        float(vertices[4 * b] - ax),
        float(vertices[4 * b + 1] - ay),
        (vertices[4 * b + 2] - az) * z_ratio,
    )
    cx, cy, cz = (
        float(vertices[4 * c] - ax),
        float(vertices[4 * c + 1] - ay),
        (vertices[4 * c + 2] - az) * z_ratio,
    )
    px, py, pz = float(x - ax), float(y - ay), (z - az) * z_ratio
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    n2 = nx * nx + ny * ny + nz * nz
    distance = (nx * px + ny * py + nz * pz) / math.sqrt(n2)
    to_a = px * px + py * py + pz * pz
    to_b = (px - bx) * (px - bx) + (py - by) * (py - by) + (pz - bz) * (pz - bz)
    to_c = (px - cx) * (px - cx) + (py - cy) * (py - cy) + (pz - cz) * (pz - cz)
    nearest = math.sqrt(min(to_a, to_b, to_c))
    edge2 = max(bx * bx + by * by, cx * cx + cy * cy, (cx - bx) * (cx - bx) + (cy - by) * (cy - by))
    return distance, nearest, nz * nz / n2, math.sqrt(edge2)


@kernel
def within(distance: float, nearest: float, edge: float, limits: Limits) -> bool:
    """Whether distance and angle are within the limits; a point on a corner is judged by its distance alone."""
    if abs(distance) > limits.distance:
        return False
    angle = limits.angle
    if edge < limits.reduce_edge:
        angle *= edge / limits.reduce_edge
    return abs(distance) <= nearest * math.sin(angle) or nearest == 0.0


@kernel
def mirror_facet(vertices: Int32Array, triangles: Int32Array, t: int, x: int, y: int) -> tuple[int, int, int]:
    """The point mirrored in plan through the facet's highest corner, and the triangle that it falls in.

    Of equally high corners the lexicographically smallest. The height stays: mirrored in z as well, a point beyond
    the edge of a terrace would be tested below the terrace.
    """
    corners = canonical_facet(vertices, triangles, t)
    top = corners[0]
    for v in corners[1:]:
        higher = vertices[4 * v + 2] > vertices[4 * top + 2]
        tie = vertices[4 * v + 2] == vertices[4 * top + 2]
        left = vertices[4 * v] < vertices[4 * top] or (
            vertices[4 * v] == vertices[4 * top] and vertices[4 * v + 1] < vertices[4 * top + 1]
        )
        if higher or (tie and left):
            top = v
    mx, my = 2 * vertices[4 * top] - x, 2 * vertices[4 * top + 1] - y
    return locate(vertices, triangles, mx, my, t), mx, my


@kernel
def accepts(
    vertices: Int32Array, triangles: Int32Array, t: int, x: int, y: int, z: int, limits: Limits
) -> tuple[bool, int]:
    """Axelsson's test of a point that lies in triangle t.

    Returns
    -------
    bool
        The point belongs to the terrain.
    int
        The other triangle that the answer rests on (t itself unless the point was mirrored).
    """
    distance, nearest, cos2, edge = facet_measures(vertices, triangles, t, x, y, z, limits.z_ratio)
    if edge < limits.stop_edge:
        return False, t
    if cos2 >= limits.steep_cos2:
        return within(distance, nearest, edge, limits), t
    other, mx, my = mirror_facet(vertices, triangles, t, x, y)
    if is_ghost(triangles, other):
        return False, other
    distance, nearest, cos2, edge = facet_measures(vertices, triangles, other, mx, my, z, limits.z_ratio)
    return within(distance, nearest, edge, limits), other
