"""Bulk construction: gather the points in a coarse-to-fine order, then insert one after another."""

import numpy as np

from ptd.kernel import as_int64, kernel
from ptd.tin.cavity import link_vertex
from ptd.tin.insertion import lower_vertex, start_triangulation
from ptd.tin.layout import N_VERTICES, Int32Array
from ptd.tin.location import coincident_vertex, walk
from ptd.tin.order import curve_order, round_order, sorted_by_key
from ptd.tin.predicates import cross_at


@kernel
def _seeds(vertices: Int32Array, n: int) -> tuple[int, int]:
    """Rows j < k of the first points that make a triangle with row 0, or (-1, -1) if all are collinear."""
    j = 1
    while j < n and vertices[4 * j] == vertices[0] and vertices[4 * j + 1] == vertices[1]:
        j += 1
    for k in range(j + 1, n):
        if (
            cross_at(
                vertices[4 * k],
                vertices[4 * k + 1],
                vertices[0],
                vertices[1],
                vertices[4 * j],
                vertices[4 * j + 1],
            )
            != 0
        ):
            return j, k
    return -1, -1


@kernel
def _swap_rows(vertices: Int32Array, i: int, j: int) -> None:
    for column in range(4):
        kept = vertices[4 * i + column]
        vertices[4 * i + column] = vertices[4 * j + column]
        vertices[4 * j + column] = kept


@kernel
def _keep_distinct(vertices: Int32Array, n: int) -> int:
    """Sort rows of collinear points by (x, y), keep the lowest z of each position, and return their number."""
    keys = np.empty(n, np.uint64)
    for i in range(n):
        keys[i] = np.uint64((as_int64(vertices[4 * i + 1]) + (1 << 31)) << 32 | i)
    keys = sorted_by_key(keys)
    for rank in range(n):
        i = as_int64(keys[rank] & np.uint64(0xFFFFFFFF))
        keys[rank] = np.uint64((as_int64(vertices[4 * i]) + (1 << 31)) << 32 | i)
    keys = sorted_by_key(keys)
    rows = vertices[: 4 * n].copy()
    kept = 0
    for rank in range(n):
        i = 4 * as_int64(keys[rank] & np.uint64(0xFFFFFFFF))
        last = 4 * kept - 4
        if kept > 0 and rows[i] == vertices[last] and rows[i + 1] == vertices[last + 1]:
            vertices[last + 2] = min(vertices[last + 2], rows[i + 2])
            continue
        for column in range(3):
            vertices[last + 4 + column] = rows[i + column]
        vertices[last + 7] = -1
        kept += 1
    return kept


@kernel
def insertion_order(x: Int32Array, y: Int32Array) -> Int32Array:
    """The order in which `build` inserts points: int32 [n]."""
    return round_order(curve_order(x, y))


@kernel
def build(
    vertices: Int32Array,
    triangles: Int32Array,
    counters: Int32Array,
    x: Int32Array,
    y: Int32Array,
    z: Int32Array,
    order: Int32Array,
    stamp: int,
) -> None:
    """Triangulate all points at once.

    Parameters
    ----------
    vertices, triangles, counters : int32 arrays, see `ptd.tin.layout`
        Arrays of an empty TIN, with room for a vertex per point, repeated positions included.
    x, y, z : int32 [n]
        Positions in counts, in any order. Differences of x and of y have to stay below 2**26: not checked
        here.
    order : int32 [n]
        Indices of the points in the order of insertion, fast if it is that of `insertion_order`.
    stamp : int
        Written to each triangle.
    """
    n = x.size
    for i in range(n):
        vertices[4 * i] = x[order[i]]
        vertices[4 * i + 1] = y[order[i]]
        vertices[4 * i + 2] = z[order[i]]
    j, k = _seeds(vertices, n)
    if k < 0:
        counters[N_VERTICES] = _keep_distinct(vertices, n)
        return
    # Other callers pass int64 numbers. With int32 numbers the kernels would be compiled again.
    _swap_rows(vertices, as_int64(1), j)
    _swap_rows(vertices, as_int64(2), k)
    start_triangulation(
        vertices, triangles, counters, as_int64(0), as_int64(1), as_int64(2), stamp
    )
    # Rows are read ahead of where they are kept, so repeated positions leave no holes.
    kept = as_int64(3)
    hint = as_int64(0)
    for i in range(3, n):
        px, py, pz = (
            as_int64(vertices[4 * i]),
            as_int64(vertices[4 * i + 1]),
            as_int64(vertices[4 * i + 2]),
        )
        first = walk(vertices, triangles, px, py, hint)
        v = coincident_vertex(vertices, triangles, px, py, first)
        if v >= 0:
            lower_vertex(vertices, triangles, v, pz, stamp)
            hint = first
            continue
        vertices[4 * kept] = px
        vertices[4 * kept + 1] = py
        vertices[4 * kept + 2] = pz
        link_vertex(vertices, triangles, counters, kept, first, stamp)
        hint = as_int64(vertices[4 * kept + 3])
        kept += 1
    counters[N_VERTICES] = kept
