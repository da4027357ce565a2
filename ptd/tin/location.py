"""Point location by walking through the triangles."""

from ptd.kernel import as_int64, kernel
from ptd.tin.layout import Int32Array, next_edge, previous_edge, real_neighbour
from ptd.tin.predicates import lexicographic_less


@kernel
def walk(vertices: Int32Array, triangles: Int32Array, x: int, y: int, hint: int) -> int:
    """Walk to a triangle that contains (x, y), border included, or a ghost whose hull edge (x, y) is beyond.

    Each step crosses an edge that has the point strictly on its other side. In the
    (symbolically perturbed) Delaunay triangulation such a walk cannot come back to a triangle,
    whichever of two edges it takes (Edelsbrunner, An acyclicity theorem for cell complexes in d
    dimensions, 1990), so it ends.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.layout`
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
def coincident_vertex(
    vertices: Int32Array, triangles: Int32Array, x: int, y: int, triangle: int
) -> int:
    """The vertex of `triangle` that lies exactly at (x, y), or -1."""
    for corner in range(8 * triangle + 4, 8 * triangle + 7):
        v = int(triangles[corner])
        if v >= 0 and vertices[4 * v] == x and vertices[4 * v + 1] == y:
            return v
    return -1


@kernel
def locate(vertices: Int32Array, triangles: Int32Array, x: int, y: int, hint: int) -> int:
    """Find the triangle that owns the position (x, y), whatever the hint.

    - strictly inside a triangle: that triangle;
    - on an edge: of the two triangles, the one whose opposite vertex is lexicographically
      smaller in (x, y); on the hull the real one;
    - on a vertex: any incident real triangle (`coincident_vertex` finds the vertex);
    - outside the hull: a ghost triangle whose hull edge has the position strictly beyond it.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.layout`
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
