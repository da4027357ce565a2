"""Natural neighbour interpolation (Sibson, A brief description of natural neighbour interpolation, 1981).

The weight of a neighbour is the area that the Voronoi cell of the inserted position takes from
the neighbour's cell. These weights reproduce linear functions. Therefore only heights above the
plane of the position's facet are averaged, and the plane is added afterwards: planes are exact
to the last bit, however the areas are rounded.

All lengths are relative to the position, and each sum starts at the lexicographically smallest
member of its ring or polygon. So the result does not depend on insertion, tile or frame.
"""

import math

import numpy as np

from ptd.arrays import Float64, Int32, UInt8
from ptd.kernel import as_int64, kernel
from ptd.tin.facets import (
    KnownBounds,
    canonical_facet,
    circle_inside,
    facet_certified,
    facet_plane,
    height_on,
    plane_height,
    unbounded,
)
from ptd.tin.raster import NO_OWNER, PixelCentres
from ptd.tin.triangles import (
    HEADER,
    N_TRIANGLES,
    is_ghost,
    lexicographic_less,
    next_edge,
    previous_edge,
)

# Shewchuk's error bound of the in-circle determinant with rounded differences and products is
# slightly above 10 units of rounding. A position that close to a circle takes a negligible
# area.
_ERROR = 16.0 * 2.0**-53


@kernel
def _centre(bx: float, by: float, cx: float, cy: float) -> tuple[float, float]:
    """Return the centre of the circle through the origin, b and c, infinite if they are collinear in float64."""
    b2, c2 = bx * bx + by * by, cx * cx + cy * cy
    area = 2.0 * (bx * cy - by * cx)
    if area == 0.0:
        return math.inf, math.inf
    return (cy * b2 - by * c2) / area, (bx * c2 - cx * b2) / area


@kernel
def _offset(vertices: Int32, v: int, x: int, y: int, scale: int) -> tuple[float, float]:
    return (
        float(scale * vertices[4 * v] - x) / scale,
        float(scale * vertices[4 * v + 1] - y) / scale,
    )


@kernel
def _facet_centres(vertices: Int32, triangles: Int32, n: int) -> tuple[Float64, Int32]:
    """Centres of the first n circumcircles, each relative to a vertex of its triangle, and that vertex.

    Each centre is a corner of three Voronoi cells and serves every position near them.
    """
    centres = np.empty((n, 2), np.float64)
    firsts = np.empty(n, np.int32)
    for triangle in range(n):
        if is_ghost(triangles, triangle):
            continue
        a, b, c = canonical_facet(vertices, triangles, triangle)
        centres[triangle, 0], centres[triangle, 1] = _centre(
            float(vertices[4 * b] - vertices[4 * a]),
            float(vertices[4 * b + 1] - vertices[4 * a + 1]),
            float(vertices[4 * c] - vertices[4 * a]),
            float(vertices[4 * c + 1] - vertices[4 * a + 1]),
        )
        firsts[triangle] = a
    return centres, firsts


@kernel
def _surely_inside(
    vertices: Int32, triangles: Int32, triangle: int, x: int, y: int, scale: int
) -> bool:
    """Whether the position lies inside the circumcircle of a real triangle by more than the rounding error."""
    a, b, c = canonical_facet(vertices, triangles, triangle)
    ax, ay = _offset(vertices, a, x, y, scale)
    bx, by = _offset(vertices, b, x, y, scale)
    cx, cy = _offset(vertices, c, x, y, scale)
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    value = a2 * (bx * cy - by * cx) + b2 * (cx * ay - cy * ax) + c2 * (ax * by - ay * bx)
    size = (
        a2 * (abs(bx * cy) + abs(by * cx))
        + b2 * (abs(cx * ay) + abs(cy * ax))
        + c2 * (abs(ax * by) + abs(ay * bx))
    )
    return value > _ERROR * size


@kernel
def _rim(
    vertices: Int32,
    triangles: Int32,
    scratch: Int32,
    first: int,
    x: int,
    y: int,
    scale: int,
) -> int:
    """Write the rim of the triangles in conflict with the position to `scratch`, counter-clockwise.

    The half-edges *inside* begin at HEADER, the stack begins in the middle. Returns the number
    of half-edges, 0 if a ghost is in conflict (on the hull), -1 if `scratch` is too small.
    """
    room = (scratch.size - HEADER) >> 1
    bottom = HEADER + room
    n = 0
    scratch[bottom] = 8 * first + 2
    scratch[bottom + 1] = 8 * first + 1
    scratch[bottom + 2] = 8 * first
    top = bottom + 3
    while top > bottom:
        top -= 1
        edge = as_int64(scratch[top])
        outer = as_int64(triangles[edge])
        t = outer >> 3
        if is_ghost(triangles, t):
            a = as_int64(triangles[next_edge(edge) + 4])
            b = as_int64(triangles[previous_edge(edge) + 4])
            side = as_int64(vertices[4 * b] - vertices[4 * a]) * (
                y - scale * vertices[4 * a + 1]
            ) - as_int64(vertices[4 * b + 1] - vertices[4 * a + 1]) * (
                x - scale * vertices[4 * a]
            )
            if side <= 0:
                return 0
        elif _surely_inside(vertices, triangles, t, x, y, scale):
            if n + (top - bottom) + 4 > room:
                return -1
            scratch[top] = previous_edge(outer)
            scratch[top + 1] = next_edge(outer)
            top += 2
            continue
        scratch[HEADER + n] = edge
        n += 1
    return n


@kernel
def _stolen_area(
    vertices: Int32,
    triangles: Int32,
    centres: Float64,
    firsts: Int32,
    edges: tuple[int, int],
    position: tuple[int, int, int],
    before: tuple[float, float],
    after: tuple[float, float],
) -> float:
    """Twice the area that the position (x, y, scale) takes from the cell of a vertex on its rim.

    Two edges of the rim meet in the vertex: the first of `edges` starts there, the second ends
    there. Corners of the area are the new centres on both edges, and the old centres of the
    triangles around the vertex from the first edge back to the second. Coordinates are relative
    to the new centre on the second edge, which limits cancellation.
    """
    edge, last_edge = edges
    x, y, scale = position
    (before_x, before_y), (after_x, after_y) = before, after
    ux, uy = after_x - before_x, after_y - before_y
    total = 0.0
    while True:
        triangle = edge >> 3
        ax, ay = _offset(vertices, as_int64(firsts[triangle]), x, y, scale)
        cx = ax + centres[triangle, 0] - before_x
        cy = ay + centres[triangle, 1] - before_y
        total += ux * cy - uy * cx
        ux, uy = cx, cy
        if triangle == last_edge >> 3:
            return float(total)
        # The edge of this triangle that ends in the vertex has a twin that starts there.
        edge = as_int64(triangles[previous_edge(edge)])


@kernel
def _position_height(
    vertices: Int32,
    triangles: Int32,
    centres: Float64,
    firsts: Int32,
    rim: Int32,
    n: int,
    owner: int,
    position: tuple[int, int, int],
) -> float:
    """Return Sibson's interpolant at a position (x, y, scale) strictly inside the hull, with the `rim` of `_rim`."""
    x, y, scale = position
    plane = facet_plane(vertices, triangles, owner)
    base = height_on(plane, x, y, scale)
    start = 0
    for i in range(1, n):
        v = 4 * as_int64(triangles[next_edge(as_int64(rim[HEADER + i])) + 4])
        w = 4 * as_int64(triangles[next_edge(as_int64(rim[HEADER + start])) + 4])
        if lexicographic_less(vertices[v], vertices[v + 1], vertices[w], vertices[w + 1]):
            start = i
    last = as_int64(rim[HEADER + (start + n - 1) % n])
    ax, ay = _offset(vertices, as_int64(triangles[next_edge(last) + 4]), x, y, scale)
    bx, by = _offset(vertices, as_int64(triangles[previous_edge(last) + 4]), x, y, scale)
    before = _centre(ax, ay, bx, by)
    weights, rises = 0.0, 0.0
    for i in range(n):
        edge = as_int64(rim[HEADER + (start + i) % n])
        v = as_int64(triangles[next_edge(edge) + 4])
        ax, ay = bx, by
        bx, by = _offset(vertices, as_int64(triangles[previous_edge(edge) + 4]), x, y, scale)
        after = _centre(ax, ay, bx, by)
        weight = _stolen_area(
            vertices, triangles, centres, firsts, (edge, last), position, before, after
        )
        below = height_on(
            plane,
            scale * as_int64(vertices[4 * v]),
            scale * as_int64(vertices[4 * v + 1]),
            scale,
        )
        weights += weight
        rises += weight * (vertices[4 * v + 2] - below)
        last, before = edge, after
    if not (weights > 0.0 and math.isfinite(rises)):
        return base
    return base + math.floor(rises / weights * 2.0**20 + 0.5) / 2.0**20


@kernel
def _rim_certified(
    vertices: Int32,
    triangles: Int32,
    rim: Int32,
    n: int,
    x: int,
    y: int,
    scale: int,
    sides: KnownBounds,
) -> bool:
    """Whether no point outside the window can change the natural neighbours."""
    px, py = float(x) / scale, float(y) / scale
    for i in range(n):
        edge = as_int64(rim[HEADER + i])
        ax, ay = _offset(vertices, as_int64(triangles[next_edge(edge) + 4]), x, y, scale)
        bx, by = _offset(vertices, as_int64(triangles[previous_edge(edge) + 4]), x, y, scale)
        if not circle_inside(px, py, ax, ay, bx, by, sides):
            return False
        if not facet_certified(vertices, triangles, edge >> 3, sides):
            return False
    return True


@kernel
def natural_heights(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    owners: Int32,
    marks: UInt8,
    lattice: PixelCentres,
    sides: KnownBounds,
) -> Float64:
    """Natural neighbour heights of the owned pixels: float64 [rows, columns], counts, NaN without owner.

    A pixel on a vertex gets the z of the vertex; heights on an edge of the hull are linear
    along the edge.

    Parameters
    ----------
    vertices, triangles, counters, owners, lattice, sides
        Arguments and results of `ptd.tin.raster.scan`.
    marks : uint8 [rows, columns]
        Marks of that scan, set to 1 where data outside the window could change the neighbours.
    """
    x0, y0, step, scale = lattice
    out = np.empty(owners.shape, np.float64)
    scratch = np.empty(HEADER + 1024, np.int32)
    centres, firsts = _facet_centres(vertices, triangles, counters[N_TRIANGLES])
    for row in range(owners.shape[0]):
        y = y0 - row * step
        for column in range(owners.shape[1]):
            owner = as_int64(owners[row, column])
            if owner == NO_OWNER:
                out[row, column] = np.nan
                continue
            if owner < 0:
                out[row, column] = vertices[4 * (-2 - owner) + 2]
                continue
            x = x0 + column * step
            n = _rim(vertices, triangles, scratch, owner, x, y, scale)
            while n < 0:
                scratch = np.empty(4 * scratch.size, np.int32)
                n = _rim(vertices, triangles, scratch, owner, x, y, scale)
            if n == 0:
                out[row, column] = plane_height(vertices, triangles, owner, x, y, scale)
                if not unbounded(sides):  # Unknown data beyond the hull would be neighbours.
                    marks[row, column] = 1
                continue
            out[row, column] = _position_height(
                vertices, triangles, centres, firsts, scratch, n, owner, (x, y, scale)
            )
            if not unbounded(sides) and not _rim_certified(
                vertices, triangles, scratch, n, x, y, scale, sides
            ):
                marks[row, column] = 1
    return out
