"""The TIN as a Python object: checked arguments and growing arrays around the kernels."""

from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from ptd.tin import bulk, insertion, interpolation, listing
from ptd.tin.layout import (
    EVENT,
    EVENT_FULL,
    EVENT_KEPT,
    MAX_VERTICES,
    N_TRIANGLES,
    N_VERTICES,
    Int32Array,
    Mesh,
    counters_array,
    is_ghost,
    triangle_vertices,
    triangles_array,
    vertices_array,
)
from ptd.tin.location import locate

__all__ = ["MAX_EXTENT", "Inserted", "Tin"]

MAX_EXTENT = 2**26  # counts; differences of x and of y within one TIN stay below it

_INT32 = np.iinfo(np.int32)


class Inserted(NamedTuple):
    """What `Tin.insert` did: the vertex at the position, and whether the TIN changed."""

    vertex: int
    changed: bool


class Tin:
    """Delaunay triangulation of points with integer coordinates, unique for a set of points.

    It depends neither on the order of insertion nor on a translation: predicates are exact, and cocircular
    points are told apart by a symbolic perturbation in the lexicographic order of (x, y). Of points
    with equal (x, y) the lowest z stays.

    The flat arrays that the kernels work on are the attributes `vertex_array`, `triangle_array` and
    `counters` (layout: `ptd.tin.layout`); growing replaces the first two.

    Parameters
    ----------
    max_vertices : int
        Room to begin with; it doubles when needed.

    Raises
    ------
    ValueError
        If `max_vertices` is not in 1 .. 2**27.
    """

    def __init__(self, max_vertices: int = 1024) -> None:
        if not 1 <= max_vertices <= MAX_VERTICES:
            raise ValueError(f"max_vertices is {max_vertices}, must be in 1 .. {MAX_VERTICES}")
        self.vertex_array = vertices_array(max_vertices)
        self.triangle_array = triangles_array(max_vertices)
        self.counters = counters_array()
        self._hint = 0
        self._low = (0, 0)  # bounding box of all points ever given, valid if there is one
        self._high = (0, 0)

    @classmethod
    def build(
        cls,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        z: npt.ArrayLike,
        *,
        max_vertices: int | None = None,
        stamp: int = 0,
    ) -> Self:
        """Triangulate many points at once.

        Parameters
        ----------
        x, y, z : int [n]
            Positions in counts, in any order; any integer dtype whose values fit int32.
        max_vertices : int, optional
            Room for later insertions; by default just enough for the points.
        stamp : int
            Written to each triangle.

        Raises
        ------
        ValueError
            If the arrays differ in length, are not one-dimensional integers, do not fit int32, or extend
            over 2**26 counts or more in x or y.
        """
        px, py, pz = _points(x, y, z)
        tin = cls(max(px.size, max_vertices or 1, 1))
        if px.size:
            tin._cover(int(px.min()), int(py.min()), int(px.max()), int(py.max()))
            bulk.build(tin.vertex_array, tin.triangle_array, tin.counters, px, py, pz, stamp)
        return tin

    @property
    def mesh(self) -> Mesh:
        """The arrays of the TIN, for kernels that only read them; valid until the next insertion."""
        return Mesh(self.vertex_array, self.triangle_array)

    @property
    def n_vertices(self) -> int:
        """Number of vertices."""
        return int(self.counters[N_VERTICES])

    @property
    def n_triangles(self) -> int:
        """Number of triangles, ghosts included: 2 n - 2, or 0 if all vertices are collinear."""
        return int(self.counters[N_TRIANGLES])

    @property
    def vertices(self) -> Int32Array:
        """Coordinates x, y, z in counts by vertex number: int32 [n_vertices, 3], a read-only view."""
        view = self.vertex_array[: 4 * self.n_vertices].reshape(-1, 4)[:, :3]
        view.flags.writeable = False
        return view

    def insert(self, x: int, y: int, z: int, *, stamp: int = 0) -> Inserted:
        """Insert one point.

        Parameters
        ----------
        x, y, z : int
            Position in counts.
        stamp : int
            Written to each triangle that is created or changed.

        Raises
        ------
        ValueError
            If a coordinate does not fit int32 or the extent in x or y would reach 2**26 counts.
        """
        for name, value in (("x", x), ("y", y), ("z", z)):
            if not _INT32.min <= value <= _INT32.max:
                raise ValueError(f"{name} is {value}, which does not fit int32")
        self._cover(x, y, x, y)
        while True:
            vertex = insertion.insert(
                self.vertex_array, self.triangle_array, self.counters, x, y, z, self._hint, stamp
            )
            event = int(self.counters[EVENT])
            if event != EVENT_FULL:
                break
            self._grow()
        self._hint = max(0, int(self.vertex_array[4 * vertex + 3]))
        return Inserted(vertex, event != EVENT_KEPT)

    def locate(self, x: int, y: int) -> int:
        """Find the triangle that owns the position (x, y): `ptd.tin.location.locate` tells about edges.

        Raises
        ------
        ValueError
            If there is no triangle yet, or (x, y) is 2**26 counts or more from a vertex.
        """
        if self.n_triangles == 0:
            raise ValueError(f"no triangle: the {self.n_vertices} vertices are collinear")
        self._reachable(x, y, x, y)
        self._hint = int(locate(self.vertex_array, self.triangle_array, x, y, self._hint))
        return self._hint

    def is_ghost(self, triangle: int) -> bool:
        """Whether `triangle` lies outside the hull (has the vertex at infinity)."""
        self._check_triangle(triangle)
        return bool(is_ghost(self.triangle_array, triangle))

    def triangle(self, triangle: int) -> tuple[int, int, int]:
        """Vertex numbers of `triangle`, counter-clockwise; the vertex at infinity is -1."""
        self._check_triangle(triangle)
        return triangle_vertices(self.triangle_array, triangle)

    def facets(self) -> Int32Array:
        """Real triangles as vertex numbers: int32 [m, 3].

        Each counter-clockwise, its lexicographically smallest vertex in (x, y) first; sorted by the positions
        of the three vertices. So for equal sets of points ``tin.vertices[tin.facets()]`` is equal.
        """
        facets = listing.real_facets(self.vertex_array, self.triangle_array, self.counters)
        rank = np.empty(self.n_vertices, np.int32)
        xy = self.vertices
        rank[np.lexsort((xy[:, 1], xy[:, 0]))] = np.arange(self.n_vertices, dtype=np.int32)
        ranks = rank[facets]
        return facets[np.lexsort((ranks[:, 2], ranks[:, 1], ranks[:, 0]))]

    def heights(self, x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Linear interpolation at positions in counts: float64 [n], counts, NaN outside the hull.

        Raises
        ------
        ValueError
            As `build` for the arrays, and if a position is 2**26 counts or more from a vertex.
        """
        px, py, _ = _points(x, y, np.zeros(np.shape(x), np.int32))
        if self.n_triangles == 0 or px.size == 0:
            return np.full(px.size, np.nan)
        self._reachable(int(px.min()), int(py.min()), int(px.max()), int(py.max()))
        return interpolation.heights(self.vertex_array, self.triangle_array, px, py)

    def _check_triangle(self, triangle: int) -> None:
        if not 0 <= triangle < self.n_triangles:
            raise ValueError(f"triangle is {triangle}, must be in 0 .. {self.n_triangles - 1}")

    def _reachable(self, west: int, south: int, east: int, north: int) -> tuple[int, int, int, int]:
        """Join the box to that of the points; refuse one on which the predicates would not be exact."""
        if self.n_vertices:
            west, south = min(west, self._low[0]), min(south, self._low[1])
            east, north = max(east, self._high[0]), max(north, self._high[1])
        for name, low, high in (("x", west, east), ("y", south, north)):
            if high - low >= MAX_EXTENT:
                raise ValueError(
                    f"{name} extends from {low} to {high}, {high - low} counts; the TIN holds less than"
                    f" {MAX_EXTENT}: use a smaller window or coarser counts"
                )
        return west, south, east, north

    def _cover(self, west: int, south: int, east: int, north: int) -> None:
        west, south, east, north = self._reachable(west, south, east, north)
        self._low, self._high = (west, south), (east, north)

    def _grow(self) -> None:
        size = self.vertex_array.size // 4
        if size == MAX_VERTICES:
            raise ValueError(f"the TIN holds {MAX_VERTICES} vertices at most")
        size = min(2 * size, MAX_VERTICES)
        vertices, triangles = vertices_array(size), triangles_array(size)
        vertices[: 4 * self.n_vertices] = self.vertex_array[: 4 * self.n_vertices]
        triangles[: 8 * self.n_triangles] = self.triangle_array[: 8 * self.n_triangles]
        self.vertex_array, self.triangle_array = vertices, triangles


def _points(
    x: npt.ArrayLike, y: npt.ArrayLike, z: npt.ArrayLike
) -> tuple[Int32Array, Int32Array, Int32Array]:
    """Check the coordinates and give them as contiguous int32 arrays of one length."""
    out = []
    for name, values in (("x", x), ("y", y), ("z", z)):
        column = np.asarray(values)
        if column.ndim != 1:
            raise ValueError(f"{name} has {column.ndim} dimensions, must have 1")
        if column.size == 0:
            column = column.astype(np.int32)
        if column.dtype.kind not in "iu":
            raise ValueError(f"{name} is {column.dtype}, must be integer counts")
        if column.dtype != np.int32 and column.size:
            low, high = int(column.min()), int(column.max())
            if low < _INT32.min or high > _INT32.max:
                raise ValueError(f"{name} reaches from {low} to {high}, which does not fit int32")
        out.append(np.ascontiguousarray(column, np.int32))
    if not out[0].size == out[1].size == out[2].size:
        raise ValueError(f"x, y, z have {out[0].size}, {out[1].size}, {out[2].size} values, must be equal")
    return out[0], out[1], out[2]
