"""Sorting of a few hundred values inside kernels.

numba compiles its own sort again for each kernel that calls it, which takes a second or more.
"""

from __future__ import annotations

import numpy as np

from ptd.arrays import AnyArray, Int64, Integer
from ptd.kernel import inlined, kernel

GAPS = np.array(
    [227011, 100894, 44842, 19930, 8858, 3937, 1750, 701, 301, 132, 57, 23, 10, 4, 1]
)
"""Distances of the values that are compared, one after another (Ciura 2001, extended by 2.25)."""


@kernel
def sort(values: AnyArray) -> None:
    """Sort values in place, ascending. There is no NaN among them."""
    for gap in GAPS:
        for i in range(gap, values.size):
            value, j = values[i], i
            while j >= gap and values[j - gap] > value:
                values[j] = values[j - gap]
                j -= gap
            values[j] = value


@kernel
def sort_by(index: Integer, values: AnyArray) -> None:
    """Sort indices in place, so that ``values[index]`` ascends. Indices of equal values end in any order."""
    for gap in GAPS:
        for i in range(gap, index.size):
            k, j = index[i], i
            while j >= gap and values[index[j - gap]] > values[k]:
                index[j] = index[j - gap]
                j -= gap
            index[j] = k


@inlined
def sort_pairs(keys: Int64, values: Int64, first: int, end: int) -> None:
    """Sort ``keys[first:end]`` in place, ascending, and ``values[first:end]`` alike.

    Pairs with equal keys end in any order.
    """
    gap = 1
    while gap < (end - first) // 9:
        gap = 3 * gap + 1
    while gap > 0:
        for j in range(first + gap, end):
            key, value = keys[j], values[j]
            k = j
            while k >= first + gap and keys[k - gap] > key:
                keys[k], values[k] = keys[k - gap], values[k - gap]
                k -= gap
            keys[k], values[k] = key, value
        gap //= 3
