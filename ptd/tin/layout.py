"""Memory layout of a TIN: three flat int32 arrays, and the kernels that read them.

``vertices`` (4 int32 per vertex)
    ``vertices[4 * v + 0 .. 2]`` are x, y, z in counts, ``vertices[4 * v + 3]`` is one incident triangle (-1
    as long as all vertices are collinear and there is no triangle at all).

``triangles`` (8 int32 per triangle)
    ``triangles[8 * t + 0 .. 2]`` are the twins of its three half-edges, ``[8 * t + 3]`` the stamp of its
    last change, ``[8 * t + 4 .. 6]`` its vertices counter-clockwise, ``[8 * t + 7]`` is 0 and
    makes a row 32 bytes long.

    A *half-edge* is the number ``h = 8 * t + j``, j = 0, 1, 2. It lies opposite vertex j of triangle t, so
    ``triangles[h]`` is its twin (again a half-edge number), ``triangles[h + 4]`` the vertex opposite, ``h
    >> 3`` its triangle; no search for the mirror index is ever needed.

``counters`` (int32)
    The first `HEADER` entries are named below, the rest is scratch for insertion.

The *ghost* vertex (-1) lies at infinity. Each edge a -> b of the counter-clockwise hull has a
ghost triangle with the vertices b, a, ghost in cyclic order, so each half-edge has a twin. A
TIN of n vertices that are not all collinear has 2 n - 2 triangles, which need 16 + 64 = 80
bytes per vertex.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.kernel import kernel

Int32Array = npt.NDArray[np.int32]

GHOST = -1
STAMP = 3  # column of a triangle
VERTEX = 4  # first vertex column of a triangle

N_VERTICES = 0  # entries of `counters`
N_TRIANGLES = 1
HEADER = 8

MAX_VERTICES = 2**27  # half-edge numbers have to fit int32
_SCRATCH = 4 * 256


class Mesh(NamedTuple):
    """The arrays of a TIN, as one argument of kernels that only read it."""

    vertices: Int32Array
    triangles: Int32Array


def vertices_array(max_vertices: int) -> Int32Array:
    """Room for `max_vertices` vertices: int32 [4 * max_vertices]."""
    return np.empty(4 * max_vertices, np.int32)


def triangles_array(max_vertices: int) -> Int32Array:
    """Room for the triangles of `max_vertices` vertices: int32 [16 * max_vertices]."""
    return np.empty(16 * max_vertices, np.int32)


def counters_array() -> Int32Array:
    """Counters of an empty TIN, with scratch for cavities of ordinary size: int32 [HEADER + 1024]."""
    return np.zeros(HEADER + _SCRATCH, np.int32)


@kernel
def next_edge(edge: int) -> int:
    """Half-edge that follows `edge` counter-clockwise in its triangle."""
    return edge - 2 if (edge & 3) == 2 else edge + 1


@kernel
def previous_edge(edge: int) -> int:
    """Half-edge that precedes `edge` counter-clockwise in its triangle."""
    return edge + 2 if (edge & 3) == 0 else edge - 1


@kernel
def is_ghost(triangles: Int32Array, triangle: int) -> bool:
    """Whether `triangle` has the vertex at infinity, that is, lies outside the hull."""
    row = 8 * triangle
    return bool((triangles[row + 4] | triangles[row + 5] | triangles[row + 6]) < 0)


@kernel
def real_neighbour(triangles: Int32Array, triangle: int) -> int:
    """`triangle` itself if it is real, otherwise the real triangle on the other side of its hull edge."""
    row = 8 * triangle
    if triangles[row + 4] < 0:
        return int(triangles[row] >> 3)
    if triangles[row + 5] < 0:
        return int(triangles[row + 1] >> 3)
    if triangles[row + 6] < 0:
        return int(triangles[row + 2] >> 3)
    return triangle
