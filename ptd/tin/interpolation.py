"""Heights on the planes of facets, bit-equal for any order of insertion, tile and shift of the frame.

Positions are integers in units of 1 / `scale` count (1 for vertices' positions, 2 for half counts, 2 q for the centres
of pixels of p / q counts). A plane is evaluated relative to the lexicographically smallest vertex of its facet, and the
height above that vertex is rounded to 2**-20 count, so that adding the vertex's z is exact: a shift of x and y
changes no bit, a shift of z by whole counts shifts the result by exactly that.
"""

import math

import numpy as np
import numpy.typing as npt

from ptd.kernel import kernel, wide
from ptd.tin.layout import Int32Array, is_ghost
from ptd.tin.location import coincident_vertex, locate
from ptd.tin.predicates import lexicographic_less

__all__ = ["canonical_facet", "heights", "plane_height"]

Float64Array = npt.NDArray[np.float64]

_STEPS = 2.0**20  # of a height in one count


@kernel
def canonical_facet(vertices: Int32Array, triangles: Int32Array, triangle: int) -> tuple[int, int, int]:
    """Vertices of a real triangle, counter-clockwise, the lexicographically smallest in (x, y) first."""
    a = wide(triangles[8 * triangle + 4])
    b = wide(triangles[8 * triangle + 5])
    c = wide(triangles[8 * triangle + 6])
    ax, ay = vertices[4 * a], vertices[4 * a + 1]
    bx, by = vertices[4 * b], vertices[4 * b + 1]
    cx, cy = vertices[4 * c], vertices[4 * c + 1]
    if lexicographic_less(ax, ay, bx, by):
        if lexicographic_less(ax, ay, cx, cy):
            return a, b, c
        return c, a, b
    if lexicographic_less(bx, by, cx, cy):
        return b, c, a
    return c, a, b


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
        At most 2**8.

    Returns
    -------
    float64
        Counts, a multiple of 2**-20 (unless it is beyond 2**32 counts from the vertices' heights).
    """
    a, b, c = canonical_facet(vertices, triangles, triangle)
    ax, ay, az = vertices[4 * a], vertices[4 * a + 1], vertices[4 * a + 2]
    bx, by, bz = vertices[4 * b] - ax, vertices[4 * b + 1] - ay, vertices[4 * b + 2] - az
    cx, cy, cz = vertices[4 * c] - ax, vertices[4 * c + 1] - ay, vertices[4 * c + 2] - az
    slope_x = float(bz * cy - cz * by)
    slope_y = float(bx * cz - cx * bz)
    area = float(bx * cy - cx * by)
    rise = (slope_x * float(x - scale * ax) + slope_y * float(y - scale * ay)) / (area * float(scale))
    return float(az + math.floor(rise * _STEPS + 0.5) / _STEPS)


@kernel
def heights(vertices: Int32Array, triangles: Int32Array, x: Int32Array, y: Int32Array) -> Float64Array:
    """Linear interpolation at positions in counts.

    Parameters
    ----------
    vertices, triangles : int32 arrays, see `ptd.tin.layout`
        A TIN with at least one real triangle.
    x, y : int32 [n]
        Fast if neighbours in the arrays are neighbours on the ground.

    Returns
    -------
    float64 [n]
        Counts; NaN outside the hull, exactly the vertex's z on a vertex.
    """
    out = np.empty(x.size, np.float64)
    t = wide(0)
    for i in range(x.size):
        px, py = wide(x[i]), wide(y[i])
        t = wide(locate(vertices, triangles, px, py, t))
        if is_ghost(triangles, t):
            out[i] = np.nan
            continue
        v = coincident_vertex(vertices, triangles, px, py, t)
        if v >= 0:
            out[i] = vertices[4 * v + 2]
        else:
            out[i] = plane_height(vertices, triangles, t, px, py, 1)
    return out
