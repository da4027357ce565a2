"""Bulk construction: points are inserted one after another, coarse to fine along a space-filling curve.

Inserting along a curve alone keeps each walk short but makes slivers that are replaced again
and again; a random order makes long walks. Taking every 4**k-th point of the curve, then the
three points between each two of these, and so on, has neither fault. The idea is that of the
biased randomized insertion order (Amenta, Choi and Rote, Incremental constructions con BRIO,
2003), here without random numbers.
"""

import numpy as np

from ptd.arrays import Int32, UInt64
from ptd.kernel import as_int64, kernel
from ptd.tin.insertion import link_vertex, lower_vertex, start_triangulation
from ptd.tin.triangles import N_VERTICES, coincident_vertex, cross_at, walk

_KEY_BITS = 16  # bits of each coordinate in the sort key; both leave 32 bits for the index
_DIGIT_BITS = 11  # bits sorted in one pass: 2048 counters fit the first-level cache
_RATIO_BITS = 2  # each round multiplies the number of inserted points by 2**_RATIO_BITS


def _hilbert_table() -> Int32:
    """Four levels of the Hilbert curve at once: int32 [4 * 256], position | next state << 8.

    The index is state << 8 | four bits of x << 4 | four bits of y; in a state, 1 swaps x and y,
    and 2 inverts both.
    """
    table = np.empty(4 * 256, np.int32)
    for index in range(4 * 256):
        state, x, y, position = index >> 8, (index >> 4) & 15, index & 15, 0
        for level in (3, 2, 1, 0):
            bits = [(x >> level) & 1, (y >> level) & 1]
            if state & 1:
                bits.reverse()
            rx, ry = bits[0] ^ (state >> 1), bits[1] ^ (state >> 1)
            position = position << 2 | (3 * rx) ^ ry
            if ry == 0:
                state ^= 1 | rx << 1
        table[index] = position | state << 8
    return table


_TABLE = _hilbert_table()


@kernel
def _curve_keys(x: Int32, y: Int32) -> UInt64:
    """Sort key of each point: its position along the Hilbert curve of the bounding square, then its index."""
    low_x, high_x, low_y, high_y = x[0], x[0], y[0], y[0]
    for i in range(x.size):
        low_x, high_x = min(low_x, x[i]), max(high_x, x[i])
        low_y, high_y = min(low_y, y[i]), max(high_y, y[i])
    extent = max(high_x - low_x, high_y - low_y)
    shift = 0
    while extent >> shift >= 1 << _KEY_BITS:
        shift += 1
    keys = np.empty(x.size, np.uint64)
    for i in range(x.size):
        cx, cy = (x[i] - low_x) >> shift, (y[i] - low_y) >> shift
        key, state = 0, 0
        for level in (12, 8, 4, 0):
            entry = _TABLE[state | ((cx >> level) & 15) << 4 | ((cy >> level) & 15)]
            key = key << 8 | (entry & 255)
            state = entry & 0x300
        keys[i] = np.uint64(key << 32 | i)
    return keys


@kernel
def _sorted_by_key(keys: UInt64) -> UInt64:
    """Sort `keys` (overwritten) by their upper 32 bits with a stable radix sort, and return the sorted array."""
    other = np.empty_like(keys)
    count = np.empty(1 << _DIGIT_BITS, np.int64)
    mask = np.uint64((1 << _DIGIT_BITS) - 1)
    for shift in range(32, 64, _DIGIT_BITS):
        low = np.uint64(shift)
        count[:] = 0
        for i in range(keys.size):
            count[(keys[i] >> low) & mask] += 1
        total = 0
        for d in range(count.size):
            here = count[d]
            count[d] = total
            total += here
        for i in range(keys.size):
            digit = (keys[i] >> low) & mask
            other[count[digit]] = keys[i]
            count[digit] += 1
        keys, other = other, keys
    return keys


@kernel
def curve_order(x: Int32, y: Int32) -> Int32:
    """Sort the points along a Hilbert curve, equal cells in input order.

    Parameters
    ----------
    x, y : int32 [n]
        Positions in counts; extents below 2**31.

    Returns
    -------
    int32 [n]
    """
    order = np.empty(x.size, np.int32)
    if x.size == 0:
        return order
    keys = _sorted_by_key(_curve_keys(x, y))
    for i in range(x.size):
        order[i] = keys[i] & np.uint64(0xFFFFFFFF)
    return order


@kernel
def round_order(order: Int32) -> Int32:
    """Rearrange an order along a curve from coarse to fine, where each round follows the curve.

    Parameters
    ----------
    order : int32 [n]

    Returns
    -------
    int32 [n]
        ``order[0]``, then in each round the elements at multiples of the round's stride that are not multiples of the
        previous stride.
    """
    n = order.size
    out = np.empty(n, np.int32)
    if n == 0:
        return out
    out[0] = order[0]
    done = 1
    shift = 0
    while n >> shift > 0:
        shift += _RATIO_BITS
    while shift > 0:
        shift -= _RATIO_BITS
        stride = 1 << shift
        mask = (1 << (shift + _RATIO_BITS)) - 1
        for i in range(stride, n, stride):
            if i & mask:
                out[done] = order[i]
                done += 1
    return out


@kernel
def _seeds(vertices: Int32, n: int) -> tuple[int, int]:
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
def _swap_rows(vertices: Int32, i: int, j: int) -> None:
    for column in range(4):
        kept = vertices[4 * i + column]
        vertices[4 * i + column] = vertices[4 * j + column]
        vertices[4 * j + column] = kept


@kernel
def _keep_distinct(vertices: Int32, n: int) -> int:
    """Sort rows of collinear points by (x, y), keep the lowest z of each position, and return their number."""
    keys = np.empty(n, np.uint64)
    for i in range(n):
        keys[i] = np.uint64((as_int64(vertices[4 * i + 1]) + (1 << 31)) << 32 | i)
    keys = _sorted_by_key(keys)
    for rank in range(n):
        i = as_int64(keys[rank] & np.uint64(0xFFFFFFFF))
        keys[rank] = np.uint64((as_int64(vertices[4 * i]) + (1 << 31)) << 32 | i)
    keys = _sorted_by_key(keys)
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
def insertion_order(x: Int32, y: Int32) -> Int32:
    """The order in which `build` inserts points: int32 [n]."""
    return round_order(curve_order(x, y))


@kernel
def build(
    vertices: Int32,
    triangles: Int32,
    counters: Int32,
    x: Int32,
    y: Int32,
    z: Int32,
    order: Int32,
    stamp: int,
) -> None:
    """Triangulate all points at once.

    Parameters
    ----------
    vertices, triangles, counters : int32 arrays, see `ptd.tin.triangles`
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
