"""Insertion of one point into the Delaunay TIN. Of several points at one position the lowest stays."""

from ptd.kernel import as_int64, kernel
from ptd.tin.cavity import link_vertex
from ptd.tin.layout import (
    GHOST,
    N_TRIANGLES,
    N_VERTICES,
    Int32Array,
    next_edge,
)
from ptd.tin.location import coincident_vertex, walk
from ptd.tin.predicates import cross_at


@kernel
def lower_vertex(
    vertices: Int32Array, triangles: Int32Array, vertex: int, z: int, stamp: int
) -> None:
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
    vertices: Int32Array,
    triangles: Int32Array,
    counters: Int32Array,
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
    vertices: Int32Array,
    triangles: Int32Array,
    counters: Int32Array,
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
    vertices, triangles, counters : int32 arrays, see `ptd.tin.layout`
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
