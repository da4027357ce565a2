"""Facets of a TIN: heights on their planes, and their circumcircles.

Heights are bit-equal for any order of insertion, tile and shift of the frame. Positions are
integers in units of 1 / `scale` count (1 for vertices' positions, 2 for half counts, 2 q for
the centres of pixels of p / q counts). A plane is evaluated relative to the
lexicographically smallest vertex of its facet. The height above that vertex is rounded to
2**-20 count, so that adding the vertex's z is exact. So a shift of x and y changes no bit, and
a shift of z by whole counts shifts the result by exactly as much.

A circumcircle tells whether a facet is too wide to count, and whether data outside a window can change it.
"""

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Float64, Int32
from ptd.kernel import as_int64, kernel
from ptd.tin.triangles import N_TRIANGLES, coincident_vertex, is_ghost, locate

_STEPS = 2.0**20  # steps of a height in one count


@kernel
def canonical_facet(vertices: Int32, triangles: Int32, triangle: int) -> tuple[int, int, int]:
    """Vertices of a real triangle, counter-clockwise, the lexicographically smallest in (x, y) first."""
    row = 8 * triangle + 4
    a, b, c = triangles[row], triangles[row + 1], triangles[row + 2]
    # One int64 orders (x, y) lexicographically. Comparing it needs no branches, which would be
    # unpredictable here.
    key_a = (as_int64(vertices[4 * a]) << 32) + vertices[4 * a + 1]
    key_b = (as_int64(vertices[4 * b]) << 32) + vertices[4 * b + 1]
    key_c = (as_int64(vertices[4 * c]) << 32) + vertices[4 * c + 1]
    first = 2 if key_c < min(key_a, key_b) else (1 if key_b < key_a else 0)
    second = 0 if first == 2 else first + 1
    third = 2 if first == 0 else first - 1
    return (
        as_int64(triangles[row + first]),
        as_int64(triangles[row + second]),
        as_int64(triangles[row + third]),
    )


@kernel
def real_facets(vertices: Int32, triangles: Int32, counters: Int32) -> Int32:
    """Vertex numbers of the real triangles in the order in which they are stored: int32 [m, 3].

    Vertices are counter-clockwise, beginning with the lexicographically smallest in (x, y).
    """
    m = 0
    for t in range(counters[N_TRIANGLES]):
        if not is_ghost(triangles, t):
            m += 1
    out = np.empty((m, 3), np.int32)
    m = 0
    for t in range(counters[N_TRIANGLES]):
        if not is_ghost(triangles, t):
            a, b, c = canonical_facet(vertices, triangles, t)
            out[m, 0], out[m, 1], out[m, 2] = a, b, c
            m += 1
    return out


class Plane(NamedTuple):
    """Plane of a facet, relative to its lexicographically smallest vertex (x, y, z)."""

    x: int
    y: int
    z: int
    slope_x: float  # multiplied by the area
    slope_y: float
    area: float  # twice the area of the facet, counts squared


@kernel
def facet_plane(vertices: Int32, triangles: Int32, triangle: int) -> Plane:
    """Return the plane of a real triangle. All products are exact in int64, and the slopes are rounded once."""
    a, b, c = canonical_facet(vertices, triangles, triangle)
    ax, ay, az = (
        as_int64(vertices[4 * a]),
        as_int64(vertices[4 * a + 1]),
        as_int64(vertices[4 * a + 2]),
    )
    bx, by, bz = vertices[4 * b] - ax, vertices[4 * b + 1] - ay, vertices[4 * b + 2] - az
    cx, cy, cz = vertices[4 * c] - ax, vertices[4 * c + 1] - ay, vertices[4 * c + 2] - az
    slope_x, slope_y, area = bz * cy - cz * by, bx * cz - cx * bz, bx * cy - cx * by
    return Plane(ax, ay, az, float(slope_x), float(slope_y), float(area))


@kernel
def height_on(plane: Plane, x: int, y: int, scale: int) -> float:
    """Height of `plane` at the position (x, y) / scale: see `plane_height`."""
    dx, dy = float(x - scale * plane.x), float(y - scale * plane.y)
    rise = (plane.slope_x * dx + plane.slope_y * dy) / (plane.area * float(scale))
    return float(plane.z) + math.floor(rise * _STEPS + 0.5) / _STEPS


@kernel
def plane_height(
    vertices: Int32, triangles: Int32, triangle: int, x: int, y: int, scale: int
) -> float:
    """Height of the plane of a real triangle at a position, inside the triangle or not.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.triangles`
    triangle : int
        Not a ghost.
    x, y : int64
        Position in 1 / `scale` counts, less than 2**53 from the triangle.
    scale : int64
        Less than 2**10.

    Returns
    -------
    float64
        Counts, a multiple of 2**-20 (unless it is beyond 2**32 counts from the vertices' heights).
    """
    return height_on(facet_plane(vertices, triangles, triangle), x, y, scale)


@kernel
def heights(vertices: Int32, triangles: Int32, x: Int32, y: Int32) -> Float64:
    """Linear interpolation at positions in counts.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.triangles`
        A TIN with at least one real triangle.
    x, y : int32 [n]
        Positions in counts. Fast if neighbours in the arrays are neighbours on the ground.

    Returns
    -------
    float64 [n]
        Counts; NaN outside the hull, exactly the vertex's z on a vertex.
    """
    out = np.empty(x.size, np.float64)
    t = as_int64(0)
    for i in range(x.size):
        px, py = as_int64(x[i]), as_int64(y[i])
        t = as_int64(locate(vertices, triangles, px, py, t))
        if is_ghost(triangles, t):
            out[i] = np.nan
            continue
        v = coincident_vertex(vertices, triangles, px, py, t)
        if v >= 0:
            out[i] = vertices[4 * v + 2]
        else:
            out[i] = plane_height(vertices, triangles, t, px, py, 1)
    return out


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
def facet_passes(vertices: Int32, triangles: Int32, triangle: int, rule: Rule) -> bool:
    """Whether a real facet has its longest edge and its circumradius within the limits.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.triangles`
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
    vertices: Int32, triangles: Int32, triangle: int, sides: KnownBounds
) -> bool:
    """Whether no point outside the window can lie in the circumcircle of a triangle.

    Such a triangle belongs to the triangulation of any larger set of data that agrees inside
    the window.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.triangles`
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
