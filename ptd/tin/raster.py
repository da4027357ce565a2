"""Gridding of a TIN: which facet owns each pixel centre, what height that gives, and how far the data around are known.

Rasters have row 0 in the north. The centre of the pixel with the global indices (column, iy)
lies at ((2 column + 1) p / (2 q), (2 iy + 1) p / (2 q)) absolute counts, p / q counts being the
cell size; iy grows to the north, so ``row = top - iy``.

All positions are scaled by 2 q, which makes them integers. The side of an edge on which a
centre lies is the cross product of the unscaled edge (below 2**26) and the scaled offset (below
2**26 * 2 q): for q < 2**9 it is below 2**63 and exact in int64.

A centre on an edge belongs to the side whose opposite vertex is lexicographically smaller in
(x, y), *among the sides that pass the rule*. A centre on a vertex takes the vertex's z if any
facet around it passes. (If sides that fail counted as well, unknown data could change a pixel
from any distance.)
"""

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Float64, Int32, UInt8
from ptd.kernel import as_int64, kernel
from ptd.tin.facets import (
    KnownBounds,
    Plane,
    Rule,
    facet_certified,
    facet_passes,
    facet_plane,
    height_on,
)
from ptd.tin.triangles import N_TRIANGLES, N_VERTICES, Mesh, lexicographic_less, next_edge

# Bits of a mark while the facets are scanned.
_NEAR = 1
_FAR = 2
_OWNED = 4


class PixelCentres(NamedTuple):
    """Pixel centres: int64, in local units of 1 / `scale` count.

    Attributes
    ----------
    x0, y0
        Centre of pixel (0, 0).
    step
        Distance of the centres; columns go to the east, rows to the south.
    scale
        Units in a count, less than 2**10.
    """

    x0: int
    y0: int
    step: int
    scale: int


@kernel
def _known_within(
    lattice: PixelCentres, sides: KnownBounds, column: int, row: int, reach: float
) -> bool:
    """Whether the window extends `reach` counts to all four sides of a pixel's centre."""
    x = float(lattice.x0 + column * lattice.step) / lattice.scale
    y = float(lattice.y0 - row * lattice.step) / lattice.scale
    across = x - reach >= sides.west and x + reach <= sides.east
    return across and y - reach >= sides.south and y + reach <= sides.north


@kernel
def _mark_near_sides(
    marks: UInt8, lattice: PixelCentres, rule: Rule, sides: KnownBounds
) -> None:
    """Set the bits of pixels near unknown data.

    Set `_NEAR` where unknown data could change a pixel without a facet, and `_FAR` where they
    could change one with a facet.
    """
    slack = 1.0 + 2.0**-20
    far = 2.0 * rule.max_radius * slack + 2.0
    near = min(far, math.sqrt(float(rule.max_edge2)) * slack + 2.0)
    for row in range(marks.shape[0]):
        for column in range(marks.shape[1]):
            mark = 0
            if not _known_within(lattice, sides, column, row, near):
                mark |= _NEAR
            if not _known_within(lattice, sides, column, row, far):
                mark |= _FAR
            marks[row, column] = mark


@kernel
def _settle_marks(marks: UInt8) -> None:
    """Replace the bits of each pixel by its final mark: 1 if unknown data could change it, else 0.

    The circle of a facet that passes reaches at most twice `max_radius` from its pixel, and may
    hold unknown data. A pixel without such a facet could get one from unknown data. But the
    corners of that facet would lie at most the length of its longest edge from the pixel. If
    all of them were known, the circle would be empty of known data too, and the facet would be
    a triangle of this TIN. So a smaller reach suffices there.
    """
    for row in range(marks.shape[0]):
        for column in range(marks.shape[1]):
            mark = marks[row, column]
            asked = _FAR if mark & _OWNED else _NEAR
            marks[row, column] = 1 if mark & asked else 0


NO_OWNER = -1  # owner of a pixel without one; an owner -2 - v is vertex v

_WIDE = 6  # columns from which cutting each row to the triangle saves time


class _Outputs(NamedTuple):
    """Arrays that `scan` fills, as one argument of kernels."""

    owners: Int32
    heights: Float64
    marks: UInt8


@kernel
def _own_vertex(
    vertices: Int32, triangles: Int32, v: int, rule: Rule, sides: KnownBounds
) -> tuple[bool, bool]:
    """Whether any facet around a vertex passes, and whether that is certain."""
    edge = 8 * as_int64(vertices[4 * v + 3])
    while triangles[edge + 4] != v:
        edge += 1
    start = edge >> 3
    owned, final, all_certified = False, False, True
    while True:
        t = edge >> 3
        certified = facet_certified(vertices, triangles, t, sides)
        all_certified = all_certified and certified
        if facet_passes(vertices, triangles, t, rule):
            owned = True
            final = final or certified
        edge = as_int64(next_edge(as_int64(triangles[next_edge(edge)])))
        if edge >> 3 == start:
            return owned, final or all_certified


@kernel
def _own_vertices(
    mesh: Mesh,
    n_vertices: int,
    outputs: _Outputs,
    lattice: PixelCentres,
    rule: Rule,
    sides: KnownBounds,
) -> None:
    """Assign the pixels whose centre is a vertex."""
    vertices, triangles = mesh
    owners, heights, marks = outputs
    x0, y0, step, scale = lattice
    inverse = 1.0 / float(step)
    rows, columns = marks.shape
    for v in range(n_vertices):
        x = scale * as_int64(vertices[4 * v]) - x0
        column = math.floor(float(x) * inverse + 0.5)
        if column * step != x or column < 0 or column >= columns:
            continue
        y = y0 - scale * as_int64(vertices[4 * v + 1])
        row = math.floor(float(y) * inverse + 0.5)
        if row * step != y or row < 0 or row >= rows:
            continue
        owned, final = _own_vertex(vertices, triangles, as_int64(v), rule, sides)
        if owned and owners.size > 0:
            owners[row, column] = -2 - v
        if owned and heights.size > 0:
            heights[row, column] = vertices[4 * v + 2]
        if final:
            marks[row, column] = 0
        elif owned:
            marks[row, column] |= _OWNED


@kernel
def _apex_first(vertices: Int32, triangles: Int32, edge: int) -> bool:
    """Whether the vertex opposite `edge` is lexicographically smaller than the one opposite its twin."""
    own, other = triangles[edge + 4], triangles[triangles[edge] + 4]
    return lexicographic_less(
        as_int64(vertices[4 * own]),
        as_int64(vertices[4 * own + 1]),
        as_int64(vertices[4 * other]),
        as_int64(vertices[4 * other + 1]),
    )


@kernel
def _own_border(
    vertices: Int32,
    triangles: Int32,
    t: int,
    zeros: tuple[bool, bool, bool],
    within_reach: bool,
    rule: Rule,
    sides: KnownBounds,
) -> tuple[bool, bool]:
    """Whether facet `t` owns a centre on its border, and whether the owner is certain.

    `zeros` says which edges the centre lies on; `_own_vertices` handles centres on a vertex. The owner is certain if
    both facets at the edge are certified. If `t` owns the centre and the other one does not pass, it is enough that `t`
    is certified and the window extends so far that no unknown facet can pass there.
    """
    if zeros[0] + zeros[1] + zeros[2] == 2:
        return False, False
    edge = 8 * t + 2
    if zeros[0]:
        edge = 8 * t
    elif zeros[1]:
        edge = 8 * t + 1
    other = as_int64(triangles[edge]) >> 3
    passes = facet_passes(vertices, triangles, t, rule)
    other_passes = facet_passes(vertices, triangles, other, rule)
    owned = passes and (not other_passes or _apex_first(vertices, triangles, edge))
    other_final = facet_certified(vertices, triangles, other, sides) or (
        owned and within_reach and not other_passes
    )
    return owned, other_final and facet_certified(vertices, triangles, t, sides)


@kernel
def _cut(value: int, slope: int, low: int, high: int) -> tuple[int, int]:
    """Narrow the columns [low, high] to those where value + slope * (column - low) may be >= 0.

    The result is computed in float64 and one column wider on either side, because the exact
    test follows.
    """
    if slope == 0:
        return (low, low - 1) if value < 0 else (low, high)
    at = -float(value) / float(slope)
    if slope > 0:
        if at > float(high - low) + 1.0:
            return low, low - 1
        return low + max(as_int64(0), as_int64(math.floor(at)) - 1), high
    if at < -1.0:
        return low, low - 1
    return low, low + min(high - low, math.ceil(min(at, float(high - low))) + 1)


@kernel
def _own_facet(
    mesh: Mesh,
    t: int,
    outputs: _Outputs,
    box: tuple[int, int, int, int],
    lattice: PixelCentres,
    rule: Rule,
    sides: KnownBounds,
) -> None:
    """Assign the pixels of a box (top, bottom, left, right, inclusive) whose centre lies in real triangle `t`."""
    vertices, triangles = mesh
    owners, heights, marks = outputs
    x0, y0, step, scale = lattice
    top, bottom, left, right = box
    i, j, k = 4 * triangles[8 * t + 4], 4 * triangles[8 * t + 5], 4 * triangles[8 * t + 6]
    ax, ay = as_int64(vertices[i]), as_int64(vertices[i + 1])
    bx, by = as_int64(vertices[j]), as_int64(vertices[j + 1])
    cx, cy = as_int64(vertices[k]), as_int64(vertices[k + 1])
    px = x0 + left * step
    known, passes, certified = False, False, False
    plane = Plane(as_int64(0), as_int64(0), as_int64(0), 0.0, 0.0, 1.0)
    # The three edge functions change by this much from one column to the next.
    da, db, dc = (by - cy) * step, (cy - ay) * step, (ay - by) * step
    for row in range(top, bottom + 1):
        py = y0 - row * step
        ea = (cx - bx) * (py - scale * by) - (cy - by) * (px - scale * bx)
        eb = (ax - cx) * (py - scale * cy) - (ay - cy) * (px - scale * cx)
        ec = (bx - ax) * (py - scale * ay) - (by - ay) * (px - scale * ax)
        first, last = left, right
        if right - left >= _WIDE:
            first_a, last_a = _cut(ea, da, left, right)
            first_b, last_b = _cut(eb, db, left, right)
            first_c, last_c = _cut(ec, dc, left, right)
            first = as_int64(max(first_a, first_b, first_c))
            last = as_int64(min(last_a, last_b, last_c))
            ea += (first - left) * da
            eb += (first - left) * db
            ec += (first - left) * dc
        for column in range(first, last + 1):
            if (ea | eb | ec) >= 0:
                if not known:  # most facets own no pixel
                    passes = facet_passes(vertices, triangles, t, rule)
                    certified = facet_certified(vertices, triangles, t, sides)
                    plane = facet_plane(vertices, triangles, t)
                    known = True
                owned, final = passes, certified
                if ea == 0 or eb == 0 or ec == 0:
                    zeros, within_reach = (ea == 0, eb == 0, ec == 0), marks[row, column] == 0
                    owned, final = _own_border(
                        vertices, triangles, t, zeros, within_reach, rule, sides
                    )
                if owned and owners.size > 0:
                    owners[row, column] = t
                if owned and heights.size > 0:
                    heights[row, column] = height_on(plane, x0 + column * step, py, scale)
                if final:
                    marks[row, column] = 0
                elif owned:
                    marks[row, column] |= _OWNED
            ea += da
            eb += db
            ec += dc


@kernel
def scan(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    owners: Int32,
    heights: Float64,
    marks: UInt8,
    lattice: PixelCentres,
    rule: Rule,
    sides: KnownBounds,
) -> None:
    """Find the facet or vertex that owns each pixel centre, and the linear height there.

    Heights are computed in the same scan: finding the facet again for each pixel would take as
    long.

    Parameters
    ----------
    vertices, triangles, counters : int32 arrays, see `ptd.tin.triangles`
        An empty TIN, or one of collinear points, owns nothing.
    owners : int32 [rows, columns], or [0, 0] to omit it
        Output: number of the passing facet, `NO_OWNER`, or -2 - v for vertex v.
    heights : float64 [rows, columns], or [0, 0] to omit it
        Output: counts, NaN without owner.
    marks : uint8 [rows, columns]
        Output: 1 where data outside the window could change the pixel, else 0.
    lattice : PixelCentres
        Centres of the ``(rows, columns)`` pixels.
    rule : Rule
    sides : KnownBounds
    """
    rows, columns = marks.shape
    owners[:, :] = NO_OWNER
    heights[:, :] = np.nan
    _mark_near_sides(marks, lattice, rule, sides)
    if counters[N_TRIANGLES] == 0:
        _settle_marks(marks)
        return
    x0, y0, step, scale = lattice
    inverse = 1.0 / float(step)
    mesh, outputs = Mesh(vertices, triangles), _Outputs(owners, heights, marks)
    for t in range(as_int64(counters[N_TRIANGLES])):
        i, j, k = triangles[8 * t + 4], triangles[8 * t + 5], triangles[8 * t + 6]
        if (i | j | k) < 0:
            continue
        i, j, k = 4 * i, 4 * j, 4 * k
        low_x = scale * as_int64(min(vertices[i], vertices[j], vertices[k])) - x0
        high_x = scale * as_int64(max(vertices[i], vertices[j], vertices[k])) - x0
        # The quotient is rounded, so widen the box by far less than a pixel. The exact test
        # decides.
        left = max(as_int64(0), math.ceil(float(low_x) * inverse - 1e-6))
        right = min(columns - 1, math.floor(float(high_x) * inverse + 1e-6))
        if left > right:
            continue
        low_y = y0 - scale * as_int64(max(vertices[i + 1], vertices[j + 1], vertices[k + 1]))
        high_y = y0 - scale * as_int64(min(vertices[i + 1], vertices[j + 1], vertices[k + 1]))
        top = max(as_int64(0), math.ceil(float(low_y) * inverse - 1e-6))
        bottom = min(rows - 1, math.floor(float(high_y) * inverse + 1e-6))
        if top > bottom:
            continue
        box = (top, bottom, left, right)
        _own_facet(mesh, t, outputs, box, lattice, rule, sides)
    _own_vertices(mesh, counters[N_VERTICES], outputs, lattice, rule, sides)
    _settle_marks(marks)
