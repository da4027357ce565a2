"""Insertion of one point into the Delaunay TIN (Bowyer, 1981, and Watson, 1981).

The triangles in conflict with a new point form a disk without inner vertices, so the graph of
their adjacencies is a tree. It is therefore enough to follow the contour of the disk: no
triangle needs a mark, and the rim comes out in counter-clockwise order, ready to be linked to
the new vertex. Of several points at one position the lowest stays.
"""

from typing import NamedTuple

import numpy as np

from ptd.arrays import Int32
from ptd.kernel import as_int64, kernel
from ptd.tin.triangles import (
    GHOST,
    HEADER,
    N_TRIANGLES,
    N_VERTICES,
    coincident_vertex,
    cross_at,
    ghost_conflict,
    in_circle,
    next_edge,
    previous_edge,
    walk,
)


class _Corner(NamedTuple):
    """Number of a vertex, -1 for the ghost, and its position relative to the new point."""

    vertex: int
    x: int
    y: int


@kernel
def _corner(vertices: Int32, vertex: int, x: int, y: int) -> _Corner:
    at = 4 * max(vertex, 0)
    return _Corner(vertex, vertices[at] - x, vertices[at + 1] - y)


@kernel
def _conflict(a: _Corner, b: _Corner, d: _Corner) -> bool:
    """`in_circle` for the triangle (a, d, b), one of whose vertices may be the ghost."""
    if (a.vertex | b.vertex | d.vertex) >= 0:
        return in_circle(a.x, a.y, d.x, d.y, b.x, b.y)
    if d.vertex < 0:
        return ghost_conflict(b.x, b.y, a.x, a.y)
    if a.vertex < 0:
        return ghost_conflict(d.x, d.y, b.x, b.y)
    return ghost_conflict(a.x, a.y, d.x, d.y)


@kernel
def _collect(
    vertices: Int32, triangles: Int32, scratch: Int32, x: int, y: int, first: int
) -> int:
    """Write the triangles in conflict with (x, y) and their rim to `scratch`, and change no other array.

    With c = (scratch.size - HEADER) // 4, the triangles begin at HEADER, and the rim at HEADER
    + 2 c. The rim has a pair per edge, counter-clockwise: the half-edge outside and the vertex
    where it starts. From HEADER + c on lies the stack of edges that are still to be crossed.

    Returns
    -------
    int
        Number of triangles in conflict, or -1 if `scratch` is too small.
    """
    room = (scratch.size - HEADER) >> 2
    bottom = HEADER + room
    top = bottom + 2
    rim = HEADER + 2 * room
    n_conflicts = 1
    row = 8 * first
    scratch[HEADER] = first
    scratch[bottom] = row + 2
    scratch[bottom + 1] = row + 1
    edge = row
    start = _corner(vertices, triangles[row + 5], x, y)
    while True:
        end = _corner(vertices, triangles[previous_edge(edge) + 4], x, y)
        while True:
            outer = triangles[edge]
            opposite = _corner(vertices, triangles[outer + 4], x, y)
            if not _conflict(start, end, opposite):
                break
            if n_conflicts + 4 > room:
                return -1
            scratch[HEADER + n_conflicts] = outer >> 3
            n_conflicts += 1
            scratch[top] = previous_edge(outer)
            top += 1
            edge = next_edge(outer)
            end = opposite
        scratch[rim] = outer
        scratch[rim + 1] = start.vertex
        rim += 2
        if top == bottom:
            return n_conflicts
        start = end
        top -= 1
        edge = scratch[top]


@kernel
def _fill(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    scratch: Int32,
    n_conflicts: int,
    vertex: int,
    stamp: int,
) -> None:
    """Replace the triangles that `_collect` found by the fan from `vertex` to the rim."""
    room = (scratch.size - HEADER) >> 2
    rim = HEADER + 2 * room
    n_triangles = counters[N_TRIANGLES]
    n = n_conflicts + 2
    scratch[HEADER + n - 2] = n_triangles
    scratch[HEADER + n - 1] = n_triangles + 1
    scratch[HEADER + n] = scratch[HEADER]
    scratch[rim + 2 * n + 1] = scratch[rim + 1]
    counters[N_TRIANGLES] = n_triangles + 2
    before = 8 * scratch[HEADER + n - 1]
    row = 8 * scratch[HEADER]
    a = scratch[rim + 1]
    vertices[4 * vertex + 3] = row >> 3
    for i in range(n):
        after = 8 * scratch[HEADER + i + 1]
        outer = scratch[rim + 2 * i]
        b = scratch[rim + 2 * i + 3]
        triangles[row] = outer
        triangles[row + 1] = after + 2
        triangles[row + 2] = before + 1
        triangles[row + 3] = stamp
        triangles[row + 4] = vertex
        triangles[row + 5] = a
        triangles[row + 6] = b
        triangles[row + 7] = 0
        triangles[outer] = row
        if a >= 0:
            vertices[4 * a + 3] = row >> 3
        before = row
        row = after
        a = b


@kernel
def _link_large(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    vertex: int,
    first: int,
    stamp: int,
) -> None:
    """`link_vertex` for a cavity that does not fit the scratch of `counters`."""
    size = counters.size
    n_conflicts = -1
    scratch = np.empty(size, np.int32)
    while n_conflicts < 0:
        size *= 4
        scratch = np.empty(size, np.int32)
        n_conflicts = _collect(
            vertices, triangles, scratch, vertices[4 * vertex], vertices[4 * vertex + 1], first
        )
    _fill(vertices, triangles, counters, scratch, n_conflicts, vertex, stamp)


@kernel
def link_vertex(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    vertex: int,
    first: int,
    stamp: int,
) -> None:
    """Link a vertex whose coordinates are stored and that no triangle has yet.

    Parameters
    ----------
    vertices, triangles, counters : int32 arrays, see `ptd.tin.triangles`
    vertex : int
        Number of the vertex. No other vertex may lie at its position.
    first : int
        A triangle that contains it, as `ptd.tin.triangles.walk` gives it.
    stamp : int
        Written to each triangle that is created or changed.
    """
    x = vertices[4 * vertex]
    y = vertices[4 * vertex + 1]
    n_conflicts = _collect(vertices, triangles, counters, x, y, first)
    if n_conflicts < 0:
        _link_large(vertices, triangles, counters, vertex, first, stamp)
    else:
        _fill(vertices, triangles, counters, counters, n_conflicts, vertex, stamp)


@kernel
def lower_vertex(vertices: Int32, triangles: Int32, vertex: int, z: int, stamp: int) -> None:
    """Lower `vertex` to `z` unless it is as low, and stamp its triangles if it moved."""
    if z >= vertices[4 * vertex + 2]:
        return
    vertices[4 * vertex + 2] = z
    edge = 8 * vertices[4 * vertex + 3]
    while triangles[edge + 4] != vertex:
        edge += 1
    start = edge >> 3
    while True:
        triangles[8 * (edge >> 3) + 3] = stamp
        edge = next_edge(triangles[next_edge(edge)])
        if edge >> 3 == start:
            return


@kernel
def start_triangulation(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    i: int,
    j: int,
    k: int,
    stamp: int,
) -> None:
    """Make the first triangle, of the stored non-collinear vertices i, j, k, and its three ghosts."""
    side = cross_at(
        vertices[4 * k],
        vertices[4 * k + 1],
        vertices[4 * i],
        vertices[4 * i + 1],
        vertices[4 * j],
        vertices[4 * j + 1],
    )
    if side < 0:
        i, j = j, i
    corners = (as_int64(i), as_int64(j), as_int64(k))
    for n in range(3):
        a, b = corners[(n + 1) % 3], corners[(n + 2) % 3]
        ghost = 8 * (n + 1)
        # Half-edge n of triangle 0 runs a -> b, so ghost n + 1 is (ghost vertex, b, a).
        triangles[n] = ghost
        triangles[4 + n] = corners[n]
        triangles[ghost] = n
        triangles[ghost + 4] = GHOST
        triangles[ghost + 5] = b
        triangles[ghost + 6] = a
        # The edge (a, ghost) lies opposite b. Its twin belongs to the ghost of the hull edge
        # that ends in a.
        triangles[ghost + 1] = 8 * ((n + 2) % 3 + 1) + 2
        triangles[ghost + 2] = 8 * ((n + 1) % 3 + 1) + 1
        triangles[ghost + 3] = stamp
        triangles[ghost + 7] = 0
        vertices[4 * corners[n] + 3] = 0
    triangles[3] = stamp
    triangles[7] = 0
    counters[N_TRIANGLES] = 4


@kernel
def insert(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    x: int,
    y: int,
    z: int,
    hint: int,
    stamp: int,
) -> int:
    """Insert a point. If a vertex lies at the same (x, y), the lower z is kept.

    The triangulation after a set of insertions depends on the set alone, not on its order
    (vertex and triangle *numbers* do depend on it). Existing vertices keep their numbers.

    Parameters
    ----------
    vertices, triangles, counters : int32 arrays, see `ptd.tin.triangles`
        A TIN with at least one real triangle.
    x, y, z : int
        Position in counts. Differences of x and of y within one TIN have to stay below 2**26: not checked
        here.
    hint : int
        Any triangle, the nearer the faster.
    stamp : int
        Written to each triangle that is created, rewired or made to have another height.

    Returns
    -------
    int
        Number of the vertex at (x, y), new or not; -1 if there is no room for another.
    """
    first = walk(vertices, triangles, x, y, hint)
    v = coincident_vertex(vertices, triangles, x, y, first)
    if v >= 0:
        lower_vertex(vertices, triangles, v, z, stamp)
        return v
    v = as_int64(counters[N_VERTICES])
    if 4 * v + 4 > vertices.size or 16 * v > triangles.size:
        return -1
    vertices[4 * v] = x
    vertices[4 * v + 1] = y
    vertices[4 * v + 2] = z
    counters[N_VERTICES] = v + 1
    link_vertex(vertices, triangles, counters, v, first, stamp)
    return v
