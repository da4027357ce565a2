"""Circumcircles of facets: whether a facet is too wide to count, and whether data outside can change it."""

import math
from typing import NamedTuple

from ptd.kernel import as_int64, kernel
from ptd.tin.interpolation import canonical_facet
from ptd.tin.layout import Int32Array, is_ghost

# 32 units of rounding bound the error of the few operations that make a centre, with room to
# spare. The bound includes the rounding of the inputs, which may be sums of squares and
# products (pixel centres).
_ROUNDING = 32.0 * 2.0**-53


class Rule(NamedTuple):
    """Longest edge and largest circumradius of a facet that counts.

    Attributes
    ----------
    max_edge2 : int64
        Square of the longest edge, counts squared; compared exactly.
    max_radius : float64
        Largest circumradius, counts; may be infinite. The comparison in float64 takes the edges in the order
        of their lengths, so the answer does not depend on insertion, tile or frame.
    """

    max_edge2: int
    max_radius: float


class KnownBounds(NamedTuple):
    """Sides of the window in which all points are known: float64, local counts.

    Data are unknown at x < west, y < south, x > east, y > north. If no data exist beyond a
    side, it is at infinity.
    """

    west: float
    south: float
    east: float
    north: float


@kernel
def unbounded(sides: KnownBounds) -> bool:
    """Whether the window has no side beyond which points may lie."""
    return (
        sides.west == -math.inf
        and sides.south == -math.inf
        and sides.east == math.inf
        and sides.north == math.inf
    )


@kernel
def facet_passes(
    vertices: Int32Array, triangles: Int32Array, triangle: int, rule: Rule
) -> bool:
    """Whether a real facet has its longest edge and its circumradius within the limits.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.layout`
    triangle : int
        A ghost never passes.
    rule : Rule
    """
    row = 8 * triangle
    a, b, c = triangles[row + 4], triangles[row + 5], triangles[row + 6]
    if (a | b | c) < 0:
        return False
    ax, ay = as_int64(vertices[4 * a]), as_int64(vertices[4 * a + 1])
    bx, by = vertices[4 * b] - ax, vertices[4 * b + 1] - ay
    cx, cy = vertices[4 * c] - ax, vertices[4 * c + 1] - ay
    ab, ac = bx * bx + by * by, cx * cx + cy * cy
    bc = (cx - bx) * (cx - bx) + (cy - by) * (cy - by)
    longest, shortest = max(ab, bc, ac), min(ab, bc, ac)
    if longest > rule.max_edge2 or rule.max_radius == math.inf:
        return bool(longest <= rule.max_edge2)
    middle = ab + bc + ac - longest - shortest
    doubled = 2.0 * float(bx * cy - by * cx) * rule.max_radius
    return float(longest) * float(middle) * float(shortest) <= doubled * doubled


@kernel
def circle_inside(
    x: float, y: float, bx: float, by: float, cx: float, cy: float, sides: KnownBounds
) -> bool:
    """Whether the circle through a = (x, y), a + b and a + c is certain to stay inside the window.

    The bound of the rounding error is added to the radius, so a wrong no is possible and a
    wrong yes is not. A degenerate circle is inside only if the window is the whole plane.
    """
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    area = 2.0 * (bx * cy - by * cx)
    spread = abs(bx * cy) + abs(by * cx)
    # the terms cancel, so the centre is meaningless
    if abs(area) <= _ROUNDING * 2.0**10 * spread:
        return unbounded(sides)
    dx = (cy * b2 - by * c2) / area
    dy = (bx * c2 - cx * b2) / area
    terms = (abs(cy) + abs(cx)) * b2 + (abs(by) + abs(bx)) * c2
    error = _ROUNDING * (terms + spread * (abs(dx) + abs(dy))) / abs(area)
    reach = math.sqrt(dx * dx + dy * dy) + 3.0 * error
    return (
        x + dx - reach >= sides.west
        and x + dx + reach <= sides.east
        and y + dy - reach >= sides.south
        and y + dy + reach <= sides.north
    )


@kernel
def facet_certified(
    vertices: Int32Array, triangles: Int32Array, triangle: int, sides: KnownBounds
) -> bool:
    """Whether no point outside the window can lie in the circumcircle of a triangle.

    Such a triangle belongs to the triangulation of any larger set of data that agrees inside
    the window.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.layout`
    triangle : int
        The circle of a ghost is a half-plane: only a window without sides contains it.
    sides : KnownBounds
    """
    if unbounded(sides):
        return True
    if is_ghost(triangles, triangle):
        return False
    a, b, c = canonical_facet(vertices, triangles, triangle)
    ax, ay = vertices[4 * a], vertices[4 * a + 1]
    return circle_inside(
        float(ax),
        float(ay),
        float(vertices[4 * b] - ax),
        float(vertices[4 * b + 1] - ay),
        float(vertices[4 * c] - ax),
        float(vertices[4 * c + 1] - ay),
        sides,
    )
