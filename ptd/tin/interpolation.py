"""Heights on the planes of facets, bit-equal for any order of insertion, tile and shift of the frame.

Positions are integers in units of 1 / `scale` count (1 for vertices' positions, 2 for half
counts, 2 q for the centres of pixels of p / q counts). A plane is evaluated relative to the
lexicographically smallest vertex of its facet. The height above that vertex is rounded to
2**-20 count, so that adding the vertex's z is exact. So a shift of x and y changes no bit, and
a shift of z by whole counts shifts the result by exactly as much.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.kernel import as_int64, kernel
from ptd.tin.layout import N_TRIANGLES, Int32Array, is_ghost
from ptd.tin.location import coincident_vertex, locate

Float64Array = npt.NDArray[np.float64]

_STEPS = 2.0**20  # steps of a height in one count


@kernel
def canonical_facet(
    vertices: Int32Array, triangles: Int32Array, triangle: int
) -> tuple[int, int, int]:
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
def real_facets(
    vertices: Int32Array, triangles: Int32Array, counters: Int32Array
) -> Int32Array:
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
def facet_plane(vertices: Int32Array, triangles: Int32Array, triangle: int) -> Plane:
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
    vertices: Int32Array, triangles: Int32Array, triangle: int, x: int, y: int, scale: int
) -> float:
    """Height of the plane of a real triangle at a position, inside the triangle or not.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.layout`
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
def heights(
    vertices: Int32Array, triangles: Int32Array, x: Int32Array, y: Int32Array
) -> Float64Array:
    """Linear interpolation at positions in counts.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.layout`
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
