"""Coarse-to-fine insertion order along a space-filling curve.

Inserting along a curve alone keeps each walk short but makes slivers that are replaced again
and again; a random order makes long walks. Taking every 4**k-th point of the curve, then the
three points between each two of these, and so on, has neither fault. The idea is that of the
biased randomized insertion order (Amenta, Choi and Rote, Incremental constructions con BRIO,
2003), here without random numbers.
"""

import numpy as np
import numpy.typing as npt

from ptd.kernel import kernel
from ptd.tin.layout import Int32Array

UInt64Array = npt.NDArray[np.uint64]

_KEY_BITS = 16  # bits of each coordinate in the sort key; both leave 32 bits for the index
_DIGIT_BITS = 11  # bits sorted in one pass: 2048 counters fit the first-level cache
_RATIO_BITS = 2  # each round multiplies the number of inserted points by 2**_RATIO_BITS


def _hilbert_table() -> Int32Array:
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
def _curve_keys(x: Int32Array, y: Int32Array) -> UInt64Array:
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
def sorted_by_key(keys: UInt64Array) -> UInt64Array:
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
def curve_order(x: Int32Array, y: Int32Array) -> Int32Array:
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
    keys = sorted_by_key(_curve_keys(x, y))
    for i in range(x.size):
        order[i] = keys[i] & np.uint64(0xFFFFFFFF)
    return order


@kernel
def round_order(order: Int32Array) -> Int32Array:
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
