"""The TIN as a Python object: checked arguments and growing arrays around the kernels, and a raster of triangles.

From the triangles of this raster (`Locator`) the location of points starts, so they may come in any order.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from ptd.arrays import Float64, Int32
from ptd.cells import quotient
from ptd.kernel import as_int64, inlined, kernel
from ptd.tin import bulk, facets
from ptd.tin.triangles import (
    MAX_VERTICES,
    N_TRIANGLES,
    N_VERTICES,
    Mesh,
    counters_array,
    triangles_array,
    vertices_array,
)

MAX_EXTENT = 2**26  # counts; differences of x and of y within one TIN stay below it

_INT32 = np.iinfo(np.int32)


class Tin:
    """Delaunay triangulation of points with integer coordinates, unique for a set of points.

    It depends neither on the order of insertion nor on a translation: predicates are exact, and
    cocircular points are distinguished by a symbolic perturbation in the lexicographic order of
    (x, y). Among points with equal (x, y) the lowest z stays.

    The flat arrays that the kernels work on are the attributes `vertex_array`, `triangle_array` and
    `counters` (layout: `ptd.tin.triangles`).

    Parameters
    ----------
    max_vertices : int
        Room for vertices.

    Raises
    ------
    ValueError
        If `max_vertices` is not in 1 .. 2**27.
    """

    def __init__(self, max_vertices: int) -> None:
        if not 1 <= max_vertices <= MAX_VERTICES:
            raise ValueError(f"max_vertices is {max_vertices}, must be in 1 .. {MAX_VERTICES}")
        self.vertex_array = vertices_array(max_vertices)
        self.triangle_array = triangles_array(max_vertices)
        self.counters = counters_array()
        self._box = (0, 0, 0, 0)  # west, east, south, north of the points given to `build`

    @classmethod
    def build(
        cls,
        x: npt.ArrayLike,
        y: npt.ArrayLike,
        z: npt.ArrayLike,
        *,
        max_vertices: int = 1,
        stamp: int = 0,
    ) -> Self:
        """Triangulate many points at once.

        Parameters
        ----------
        x, y, z : int [n]
            Positions in counts, in any order; any integer dtype whose values fit int32.
        max_vertices : int
            Room for later insertions, if that is more than the points need.
        stamp : int
            Written to each triangle.

        Raises
        ------
        ValueError
            If the arrays differ in length, are not one-dimensional integers, do not fit int32, or extend
            over 2**26 counts or more in x or y.
        """
        px, py, pz = _points(x, y, z)
        if px.size == 0:
            return cls(max_vertices)
        box = _validate_width(px, py)
        # before the arrays exist, which can then reuse its memory
        order = bulk.insertion_order(px, py)
        tin = cls(max(px.size, max_vertices))
        tin._box = box
        bulk.build(tin.vertex_array, tin.triangle_array, tin.counters, px, py, pz, order, stamp)
        return tin

    @property
    def mesh(self) -> Mesh:
        """Arrays of the TIN for kernels that only read them, valid until the next insertion."""
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
    def vertices(self) -> Int32:
        """Coordinates x, y, z in counts by vertex number: int32 [n_vertices, 3], a read-only view."""
        view = self.vertex_array[: 4 * self.n_vertices].reshape(-1, 4)[:, :3]
        view.flags.writeable = False
        return view

    def heights(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float64:
        """Linear interpolation at positions in counts: float64 [n], counts, NaN outside the hull.

        Raises
        ------
        ValueError
            If the arrays are unfit (see `build`), or a position is 2**26 counts or more from a vertex.
        """
        px, py, _ = _points(x, y, np.zeros(np.shape(x), np.int32))
        if self.n_triangles == 0 or px.size == 0:
            return np.full(px.size, np.nan)
        _validate_width(np.append(px, self._box[:2]), np.append(py, self._box[2:]))
        return facets.heights(self.vertex_array, self.triangle_array, px, py)


def _validate_width(x: Int32, y: Int32) -> tuple[int, int, int, int]:
    """Least and greatest x and y. Raises ValueError if predicates would not be exact over this extent."""
    west, east, south, north = int(x.min()), int(x.max()), int(y.min()), int(y.max())
    for name, low, high in (("x", west, east), ("y", south, north)):
        if high - low >= MAX_EXTENT:
            raise ValueError(
                f"{name} extends from {low} to {high}, {high - low} counts; the TIN holds less than"
                f" {MAX_EXTENT}: use a smaller window or coarser counts"
            )
    return west, east, south, north


def _points(x: npt.ArrayLike, y: npt.ArrayLike, z: npt.ArrayLike) -> tuple[Int32, Int32, Int32]:
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
                raise ValueError(
                    f"{name} reaches from {low} to {high}, which does not fit int32"
                )
        out.append(np.ascontiguousarray(column, np.int32))
    if not out[0].size == out[1].size == out[2].size:
        raise ValueError(
            f"x, y, z have {out[0].size}, {out[1].size}, {out[2].size} values, must be equal"
        )
    return out[0], out[1], out[2]


GRID_CELLS_PER_VERTEX = 2


@kernel
def _fill(row: Int32) -> bool:
    """Give empty cells (-1) of a row the value of the nearest filled one, and return False if none is filled."""
    before, start = -1, 0
    for k in range(row.size + 1):
        if k < row.size and row[k] < 0:
            continue
        if k == row.size and before < 0:
            return False
        for empty in range(start, k):
            nearer = before < 0 or (k < row.size and k - empty < empty - before)
            row[empty] = row[k if nearer else before]
        before, start = k, k + 1
    return True


@kernel
def _start_grid(
    vertices: Int32, n: int, west: int, south: int, cell: int, height: int, width: int
) -> Int32:
    """A triangle near each cell of a raster: int32 [height * width], row by row from the south-west."""
    grid, inverse = np.full(height * width, -1, np.int32), 1.0 / cell
    for v in range(n):
        row = quotient(vertices[4 * v + 1] - south, cell, inverse)
        column = quotient(vertices[4 * v] - west, cell, inverse)
        grid[row * width + column] = max(vertices[4 * v + 3], 0)
    for row in range(height):
        if not _fill(grid[row * width : (row + 1) * width]):
            grid[row * width : (row + 1) * width] = grid[(row - 1) * width : row * width]
    return grid


class Locator(NamedTuple):
    """Raster of triangles from which a point location starts, so that points may come in any order.

    Attributes
    ----------
    grid : int32 [height * width]
        A triangle near each cell of a raster, row by row from the south-west.
    west, south : int
        South-west corner of the raster, local counts.
    cell : int
        Size of a cell, counts.
    inverse : float
        1 / cell.
    width, height : int
    """

    grid: Int32
    west: int
    south: int
    cell: int
    inverse: float
    width: int
    height: int

    @classmethod
    def of(cls, tin: Tin) -> Locator:
        """Raster of start triangles of a TIN in its present state."""
        n = int(tin.counters[N_VERTICES])
        xy = tin.vertex_array[: 4 * n].reshape(-1, 4)
        west, south = int(xy[:, 0].min()), int(xy[:, 1].min())
        across, high = int(xy[:, 0].max()) - west + 1, int(xy[:, 1].max()) - south + 1
        cell = max(
            int(np.sqrt(across * high / (GRID_CELLS_PER_VERTEX * n))),
            (across + high) // (8 * n + 64) + 1,
        )
        width, height = across // cell + 1, high // cell + 1
        grid = _start_grid(tin.vertex_array, n, west, south, cell, height, width)
        return cls(grid, west, south, cell, 1.0 / cell, width, height)


@inlined
def start_near(locator: Locator, x: int, y: int) -> int:
    """A triangle near (x, y), from which `ptd.tin.triangles.locate` walks."""
    column = quotient(as_int64(x) - locator.west, locator.cell, locator.inverse)
    row = quotient(as_int64(y) - locator.south, locator.cell, locator.inverse)
    column = min(max(column, 0), locator.width - 1)
    row = min(max(row, 0), locator.height - 1)
    return as_int64(locator.grid[row * locator.width + column])
