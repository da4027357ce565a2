"""Helpers of tests: the triangles of a TIN, and insertion of single points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.tin import Tin, facets
from ptd.tin.insertion import insert
from ptd.tin.triangles import is_ghost, locate


def insert_point(tin: Tin, x: int, y: int, z: int, stamp: int = 0) -> int:
    """Insert a point into a TIN that has triangles and room for it; return its vertex."""
    vertex = int(insert(tin.vertex_array, tin.triangle_array, tin.counters, x, y, z, 0, stamp))
    assert vertex >= 0
    return vertex


def triangle_at(tin: Tin, x: int, y: int) -> int:
    """The triangle that owns a position."""
    return int(locate(tin.vertex_array, tin.triangle_array, x, y, 0))


def outside(tin: Tin, triangle: int) -> bool:
    """Whether a triangle has the vertex at infinity."""
    return bool(is_ghost(tin.triangle_array, triangle))


def corners_of(tin: Tin, triangle: int) -> tuple[int, ...]:
    """Vertices of a triangle, counter-clockwise; the one at infinity is -1."""
    return tuple(tin.triangle_array[8 * triangle + 4 : 8 * triangle + 7].tolist())


def real_triangles(tin: Tin) -> npt.NDArray[np.int32]:
    """Vertices of the real triangles, int32 (m, 3), sorted by their positions."""
    real = facets.real_facets(tin.vertex_array, tin.triangle_array, tin.counters)
    rank = np.empty(tin.n_vertices, np.int32)
    rank[np.lexsort((tin.vertices[:, 1], tin.vertices[:, 0]))] = np.arange(
        tin.n_vertices, dtype=np.int32
    )
    return real[np.lexsort(rank[real].T[::-1])]
