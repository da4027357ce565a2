"""The real triangles of a TIN as a list."""

import numpy as np

from ptd.kernel import kernel
from ptd.tin.interpolation import canonical_facet
from ptd.tin.layout import N_TRIANGLES, Int32Array, is_ghost


@kernel
def real_facets(vertices: Int32Array, triangles: Int32Array, counters: Int32Array) -> Int32Array:
    """Vertex numbers of the real triangles in the order in which they are stored: int32 [m, 3].

    Each counter-clockwise, its lexicographically smallest vertex in (x, y) first.
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
