"""Triangles of a TIN: how they lie in memory, exact predicates on their corners, and the walk that finds one.

Three flat int32 arrays are a TIN:

``vertices`` (4 int32 per vertex)
    ``vertices[4 * v + 0 .. 2]`` are x, y, z in counts, ``vertices[4 * v + 3]`` is one incident triangle (-1
    as long as all vertices are collinear and there is no triangle at all).

``triangles`` (8 int32 per triangle)
    ``triangles[8 * t + 0 .. 2]`` are the twins of its three half-edges, ``[8 * t + 3]`` the stamp of its
    last change, ``[8 * t + 4 .. 6]`` its vertices counter-clockwise, ``[8 * t + 7]`` is 0 and
    makes a row 32 bytes long.

    A *half-edge* is the number ``h = 8 * t + j``, j = 0, 1, 2. It lies opposite vertex j of triangle t, so
    ``triangles[h]`` is its twin (again a half-edge number), ``triangles[h + 4]`` the vertex opposite, ``h
    >> 3`` its triangle; no search for the mirror index is ever needed.

``counters`` (int32)
    The first `HEADER` entries are named below, the rest is scratch for insertion.

The *ghost* vertex (-1) lies at infinity. Each edge a -> b of the counter-clockwise hull has a
ghost triangle with the vertices b, a, ghost in cyclic order, so each half-edge has a twin. A
TIN of n vertices that are not all collinear has 2 n - 2 triangles, which need 16 + 64 = 80
bytes per vertex.

Predicates are exact for integer coordinates whose differences stay below 2**26. Their arguments
are the positions of the other points *relative to the query point*, as int64. Then

- a product of two differences is below 2**52 and the difference of two such products below 2**53: it is
  exact in int64 and in float64;
- the in-circle determinant is the sum of three products of a square sum and a cross product, each factor an
  integer of at most 2**53, hence exact in float64. Only three products and two sums are rounded, so with u
  = 2**-53 the error stays below 4 u S, S the sum of the absolute products. If the float64 value does not
  exceed that bound, the true value stays below 8 u S < 2**58, hence *the same expression in int64, which
  wraps modulo 2**64, is the exact value*. No wide integers are needed.

Sources: the idea of a filter with an error bound is Shewchuk's (Adaptive precision
floating-point arithmetic and fast robust geometric predicates, 1997). The perturbation is that
of Devillers and Teillaud (Perturbations and vertex removal in a 3D Delaunay triangulation, SODA
2003), as "the lexicographically largest point moves most".
"""

from typing import NamedTuple

import numpy as np

from ptd.arrays import Int32
from ptd.kernel import as_int64, kernel

GHOST = -1
STAMP = 3  # column of a triangle
VERTEX = 4  # first vertex column of a triangle

N_VERTICES = 0  # entries of `counters`
N_TRIANGLES = 1
HEADER = 8

MAX_VERTICES = 2**27  # half-edge numbers have to fit int32
_SCRATCH = 4 * 256


class Mesh(NamedTuple):
    """The arrays of a TIN, as one argument of kernels that only read it."""

    vertices: Int32
    triangles: Int32


def vertices_array(max_vertices: int) -> Int32:
    """Room for `max_vertices` vertices: int32 [4 * max_vertices]."""
    return np.empty(4 * max_vertices, np.int32)


def triangles_array(max_vertices: int) -> Int32:
    """Room for the triangles of `max_vertices` vertices: int32 [16 * max_vertices]."""
    return np.empty(16 * max_vertices, np.int32)


def counters_array() -> Int32:
    """Counters of an empty TIN, with scratch for cavities of ordinary size: int32 [HEADER + 1024]."""
    return np.zeros(HEADER + _SCRATCH, np.int32)


@kernel
def next_edge(edge: int) -> int:
    """Half-edge that follows `edge` counter-clockwise in its triangle."""
    return edge - 2 if (edge & 3) == 2 else edge + 1


@kernel
def previous_edge(edge: int) -> int:
    """Half-edge that precedes `edge` counter-clockwise in its triangle."""
    return edge + 2 if (edge & 3) == 0 else edge - 1


@kernel
def is_ghost(triangles: Int32, triangle: int) -> bool:
    """Whether `triangle` has the vertex at infinity, that is, lies outside the hull."""
    row = 8 * triangle
    return bool((triangles[row + 4] | triangles[row + 5] | triangles[row + 6]) < 0)


@kernel
def real_neighbour(triangles: Int32, triangle: int) -> int:
    """`triangle` itself if it is real, otherwise the real triangle on the other side of its hull edge."""
    row = 8 * triangle
    if triangles[row + 4] < 0:
        return int(triangles[row] >> 3)
    if triangles[row + 5] < 0:
        return int(triangles[row + 1] >> 3)
    if triangles[row + 6] < 0:
        return int(triangles[row + 2] >> 3)
    return triangle


_ERROR = 4.0 * 2.0**-53


@kernel
def cross_at(x: int, y: int, ax: int, ay: int, bx: int, by: int) -> int:
    """Orientation of the points (a, b, p) with p = (x, y): positive if p lies to the left of a -> b."""
    return (ax - x) * (by - y) - (ay - y) * (bx - x)


@kernel
def lexicographic_less(ax: int, ay: int, bx: int, by: int) -> bool:
    """Whether a comes before b in the order by x, then y."""
    return ax < bx or (ax == bx and ay < by)


@kernel
def in_circle(ax: int, ay: int, bx: int, by: int, cx: int, cy: int) -> bool:
    """Whether the origin lies inside the circle through the counter-clockwise triangle (a, b, c).

    The symbolic perturbation decides for points on the circle: it raises the lift of the
    lexicographically largest of the four points most. So the answer depends on the four
    positions alone, neither on the order of insertion nor on a translation.

    Parameters
    ----------
    ax, ay, bx, by, cx, cy : int64
        Positions relative to the query point, counts, each below 2**26 in magnitude.
    """
    fax, fay, fbx, fby, fcx, fcy = (
        float(ax),
        float(ay),
        float(bx),
        float(by),
        float(cx),
        float(cy),
    )
    first = (fax * fax + fay * fay) * (fbx * fcy - fby * fcx)
    second = (fbx * fbx + fby * fby) * (fcx * fay - fcy * fax)
    third = (fcx * fcx + fcy * fcy) * (fax * fby - fay * fbx)
    value = first + second + third
    bound = _ERROR * (abs(first) + abs(second) + abs(third))
    if value > bound:
        return True
    if value < -bound:
        return False
    return _in_circle_close(ax, ay, bx, by, cx, cy)


@kernel
def _in_circle_close(ax: int, ay: int, bx: int, by: int, cx: int, cy: int) -> bool:
    """`in_circle` in int64, for determinants too close to zero for float64."""
    exact = (
        (ax * ax + ay * ay) * (bx * cy - by * cx)
        + (bx * bx + by * by) * (cx * ay - cy * ax)
        + (cx * cx + cy * cy) * (ax * by - ay * bx)
    )
    if exact != 0:
        return exact > 0
    # No three of four distinct points on a circle are collinear, so none of the cross products
    # is zero.
    if lexicographic_less(ax, ay, bx, by):
        if lexicographic_less(bx, by, cx, cy):
            return (
                lexicographic_less(as_int64(0), as_int64(0), cx, cy) and ax * by - ay * bx > 0
            )
        return lexicographic_less(as_int64(0), as_int64(0), bx, by) and cx * ay - cy * ax > 0
    if lexicographic_less(ax, ay, cx, cy):
        return lexicographic_less(as_int64(0), as_int64(0), cx, cy) and ax * by - ay * bx > 0
    return lexicographic_less(as_int64(0), as_int64(0), ax, ay) and bx * cy - by * cx > 0


@kernel
def ghost_conflict(ax: int, ay: int, bx: int, by: int) -> bool:
    """Whether the origin lies in the "circle" of the ghost triangle (ghost, a, b).

    This "circle" is the open half-plane to the left of a -> b and the open segment a b.
    """
    area = ax * by - ay * bx
    if area != 0:
        return area > 0
    return ax * bx + ay * by < 0


@kernel
def walk(vertices: Int32, triangles: Int32, x: int, y: int, hint: int) -> int:
    """Walk to a triangle that contains (x, y), border included, or a ghost whose hull edge (x, y) is beyond.

    Each step crosses an edge that has the point strictly on its other side. In the
    (symbolically perturbed) Delaunay triangulation such a walk cannot come back to a triangle,
    whichever of two edges it takes (Edelsbrunner, An acyclicity theorem for cell complexes in d
    dimensions, 1990), so it ends.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see above
        A TIN with at least one real triangle.
    x, y : int
        Position in counts.
    hint : int
        Any triangle; the nearer the faster.
    """
    t = real_neighbour(triangles, hint)
    row = 8 * t
    i, j, k = 4 * triangles[row + 4], 4 * triangles[row + 5], 4 * triangles[row + 6]
    ax, ay = vertices[i] - x, vertices[i + 1] - y
    bx, by = vertices[j] - x, vertices[j + 1] - y
    cx, cy = vertices[k] - x, vertices[k + 1] - y
    # (a, b) become the ends of the edge to cross, counter-clockwise in the triangle that the
    # walk leaves.
    if ax * by - ay * bx < 0:
        edge = row + 2
    elif bx * cy - by * cx < 0:
        edge = row
        ax, ay, bx, by = bx, by, cx, cy
    elif cx * ay - cy * ax < 0:
        edge = row + 1
        ax, ay, bx, by = cx, cy, ax, ay
    else:
        return t
    while True:
        edge = int(triangles[edge])
        apex = triangles[edge + 4]
        if apex < 0:
            return edge >> 3
        cx, cy = vertices[4 * apex] - x, vertices[4 * apex + 1] - y
        if ax * cy - ay * cx < 0:
            edge = next_edge(edge)
            bx, by = cx, cy
        elif cx * by - cy * bx < 0:
            edge = previous_edge(edge)
            ax, ay = cx, cy
        else:
            return edge >> 3


@kernel
def coincident_vertex(vertices: Int32, triangles: Int32, x: int, y: int, triangle: int) -> int:
    """The vertex of `triangle` that lies exactly at (x, y), or -1."""
    for corner in range(8 * triangle + 4, 8 * triangle + 7):
        v = int(triangles[corner])
        if v >= 0 and vertices[4 * v] == x and vertices[4 * v + 1] == y:
            return v
    return -1


@kernel
def locate(vertices: Int32, triangles: Int32, x: int, y: int, hint: int) -> int:
    """Find the triangle that owns the position (x, y), whatever the hint.

    - strictly inside a triangle: that triangle;
    - on an edge: of the two triangles, the one whose opposite vertex is lexicographically
      smaller in (x, y); on the hull the real one;
    - on a vertex: any incident real triangle (`coincident_vertex` finds the vertex);
    - outside the hull: a ghost triangle whose hull edge has the position strictly beyond it.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see above
        A TIN with at least one real triangle.
    x, y : int
        Position in counts.
    hint : int
        Any triangle; the nearer the faster.

    Returns
    -------
    int
        Triangle number.
    """
    t = walk(vertices, triangles, x, y, hint)
    row = 8 * t
    i, j, k = triangles[row + 4], triangles[row + 5], triangles[row + 6]
    if (i | j | k) < 0:
        return t
    ax, ay = vertices[4 * i] - x, vertices[4 * i + 1] - y
    bx, by = vertices[4 * j] - x, vertices[4 * j + 1] - y
    cx, cy = vertices[4 * k] - x, vertices[4 * k + 1] - y
    on_a = bx * cy - by * cx == 0
    on_b = cx * ay - cy * ax == 0
    on_c = ax * by - ay * bx == 0
    if on_a and not (on_b or on_c):
        twin, own = triangles[row], i
    elif on_b and not (on_a or on_c):
        twin, own = triangles[row + 1], j
    elif on_c and not (on_a or on_b):
        twin, own = triangles[row + 2], k
    else:
        return t
    other = triangles[twin + 4]
    if other < 0:
        return t
    if lexicographic_less(
        as_int64(vertices[4 * other]),
        as_int64(vertices[4 * other + 1]),
        as_int64(vertices[4 * own]),
        as_int64(vertices[4 * own + 1]),
    ):
        return int(twin >> 3)
    return t
