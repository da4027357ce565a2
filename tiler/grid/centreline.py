"""Line along which a river flows: through the middle of its polygon, from end to end."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.area import Area

Floats = npt.NDArray[np.float64]

MAX_CELLS = 1_000_000
"""Largest number of cells of the raster for the search of the line."""
CELLS_ACROSS = 8
"""Cells of that raster across the mean width of the river, unless these are too many cells."""


def polygon_of(area: Area) -> Any:
    """Return the polygons of an area as one shape in absolute counts, by the even-odd rule."""
    import shapely

    shapes = []
    for rings in area.polygons:
        shape = shapely.Polygon()
        for ring in rings:
            shape = shapely.symmetric_difference(
                shape, shapely.make_valid(shapely.Polygon(ring))
            )
        shapes.append(shape)
    return shapely.union_all(shapes)


def area_of(shape: Any) -> Area:
    """Return the polygons of a shape as an `Area` with coordinates rounded to counts."""
    import shapely

    polygons = []
    for part in shapely.get_parts(shapely.make_valid(shape)):
        if part.geom_type == "Polygon":
            rings = (part.exterior, *part.interiors)
            polygons.append(
                tuple(np.rint(shapely.get_coordinates(r)[:-1]).astype(np.int64) for r in rings)
            )
    return Area(tuple(polygons))


def mean_width(shape: Any) -> float:
    """Return twice the area per outer perimeter: the width of a long ribbon, or the radius of a disk."""
    import shapely

    outer = sum(shapely.length(shapely.get_exterior_ring(p)) for p in shapely.get_parts(shape))
    return float(2 * shape.area / outer) if outer else 0.0


def centreline(shape: Any) -> Floats | None:
    """Return the line through the middle of a polygon, float64 (n, 2), or None if the polygon is too small."""
    import shapely
    from affine import Affine
    from rasterio.features import rasterize

    west, south, east, north = shape.bounds
    cell = max(
        mean_width(shape) / CELLS_ACROSS,
        math.sqrt((east - west) * (north - south) / MAX_CELLS),
        1.0,
    )
    height, width = math.ceil((north - south) / cell) + 2, math.ceil((east - west) / cell) + 2
    to_cells = Affine(cell, 0, west - cell, 0, -cell, north + cell)
    wet = (
        rasterize(
            [(shape, 1)], (height, width), transform=to_cells, all_touched=True, dtype="uint8"
        )
        > 0
    )
    parts, number = scipy.ndimage.label(wet, np.ones((3, 3), np.bool_))
    if number == 0:
        return None
    wet = parts == np.bincount(parts.ravel())[1:].argmax() + 1
    shore_distance = scipy.ndimage.distance_transform_edt(np.pad(wet, 1))[1:-1, 1:-1]
    cells, plain, central = _graph(wet, shore_distance)
    start = _farthest(plain, _farthest(plain, 0))
    end = _farthest(plain, start)
    _, predecessors = scipy.sparse.csgraph.dijkstra(
        central, directed=False, indices=np.array([start]), return_predecessors=True
    )
    way = [end]
    while way[-1] != start:
        way.append(int(predecessors[0, way[-1]]))
    half_width = float(np.median(shore_distance[wet.nonzero()[0][way], wet.nonzero()[1][way]]))
    trim = min(round(half_width), max((len(way) - 3) // 2, 0))
    rows, cols = (axis[way][trim : len(way) - trim] for axis in cells)
    if len(rows) < 3:
        return None
    smooth = [
        scipy.ndimage.gaussian_filter1d(axis.astype(np.float64), half_width, mode="nearest")
        for axis in (cols, rows)
    ]
    x, y = west - cell + (smooth[0] + 0.5) * cell, north + cell - (smooth[1] + 0.5) * cell
    line = shapely.simplify(shapely.LineString(np.stack((x, y), axis=1)), cell / 2)
    vertices: Floats = shapely.get_coordinates(line)
    return vertices


def _graph(wet: npt.NDArray[np.bool_], shore_distance: Floats) -> tuple[Any, Any, Any]:
    """Return rows and columns of cells, and two graphs of neighbouring cells.

    The first graph has the lengths of steps. In the second graph, steps near the shore cost
    more.
    """
    cells = np.nonzero(wet)
    number = np.full(wet.shape, -1, np.int32)  # scipy before 1.15 needs int32 indices in graphs
    number[cells] = np.arange(len(cells[0]), dtype=np.int32)
    one, other, lengths = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        near = number[down:, max(right, 0) : wet.shape[1] + min(right, 0)]
        here = number[: wet.shape[0] - down, max(-right, 0) : wet.shape[1] - max(right, 0)]
        both = (here >= 0) & (near >= 0)
        one.append(here[both])
        other.append(near[both])
        lengths.append(np.full(int(both.sum()), math.hypot(down, right)))
    a, b, length = np.concatenate(one), np.concatenate(other), np.concatenate(lengths)
    depth = shore_distance[cells]
    size = (len(depth), len(depth))
    plain = scipy.sparse.csr_array((length, (a, b)), size)
    central = scipy.sparse.csr_array((length / (depth[a] * depth[b]), (a, b)), size)
    return cells, plain, central


def _farthest(graph: Any, start: int) -> int:
    distance = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=np.array([start]))[
        0
    ]
    return int(np.where(np.isfinite(distance), distance, -1.0).argmax())
