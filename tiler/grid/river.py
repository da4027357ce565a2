"""Line along which a river flows, through the middle of its polygon, and the level of the river along it.

Levels are robust at stations, the profile between them falls, and it has steps at dams. A station uses pixels within
half a spacing along the line: pixels of the water with returns, and of both banks. Returns of the water give the
level if they are smooth. Banks give it if no station with smooth returns is near. The profile is the isotonic
regression of the levels, weighted by evidence, in the direction that fits better.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy
import shapely
from affine import Affine
from rasterio.features import rasterize

from ptd.arrays import Bool, Float64, Int64
from tiler.core.area import Area
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.water import Counts, Station, lengths_along, lifted_line, places_along

MAX_CELLS = 1_000_000
"""Largest number of cells of the raster for the search of the line."""
CELLS_ACROSS = 8
"""Cells of that raster across the mean width of the river, unless these are too many cells."""


def polygon_of(area: Area) -> Any:
    """Return the polygons of an area as one shape in absolute counts, by the even-odd rule."""
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
    outer = sum(shapely.length(shapely.get_exterior_ring(p)) for p in shapely.get_parts(shape))
    return float(2 * shape.area / outer) if outer else 0.0


def centreline(shape: Any) -> Float64 | None:
    """Return the line through the middle of a polygon, float64 (n, 2), or None if the polygon is too small."""
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
    vertices: Float64 = shapely.get_coordinates(line)
    return vertices


def _graph(wet: Bool, shore_distance: Float64) -> tuple[Any, Any, Any]:
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


BANK_PERCENT = 10
"""The level of the water is estimated as this percentile of the heights of a bank."""
MIN_PIXELS = 5
"""Fewest heights of a bank, or of the water itself, from which a level is estimated."""
SMOOTH_M = 0.3
"""Largest interquartile range of the water's heights at which their median is the level."""
BANK_WEIGHT = 0.05
"""Weight of a pixel of a bank. A pixel of the water itself has weight 1."""
NEAR_STATIONS = 3
"""Banks are not used at stations up to this far from a station with returns of the water, in
stations."""
LEVEL_M = 0.1
"""Total fall below which a river is level: a tenth of a metre between its ends is within the
errors of both."""
STEP_M = 0.4
"""A fall between two stations is a step at one position if it is more than this and steeper
than `STEEPEST`."""
STEEPEST = 1 / 30
"""Steepest slope of water without a step."""


class Scale(NamedTuple):
    """Number of counts per metre, in plan and of heights."""

    xy: float = float(COUNTS_PER_UNIT)
    z: float = float(COUNTS_PER_UNIT)


MILLIMETRES = Scale()


class Profile(NamedTuple):
    """Line of a river with the height of the water, int64 (n, 3), and its stations, both in downstream order."""

    flow: Counts
    stations: tuple[Station, ...]


def profile_along(
    line: Float64, shore: Counts, water: Counts, spacing: float, scale: Scale = MILLIMETRES
) -> Profile:
    """Estimate the level of a river along its line. The level never rises downstream.

    Parameters
    ----------
    line : float64 (n, 2)
        Line of the river in absolute counts.
    shore, water : int64 (3, n)
        Positions and heights of the terrain next to the water, and of the water itself where it has returns.
    spacing : float
        Distance of stations in counts.
    scale : Scale
    """
    along, stations, weights = _stations(line, shore, water, spacing, scale)
    if not len(stations):
        level = bank_level(shore[2]) if shore.shape[1] else float(np.median(water[2]))
        return Profile(lifted_line(line, np.zeros(1), np.array([level])), ())
    levels = np.array([station.level for station in stations])
    fits = [
        scipy.optimize.isotonic_regression(levels, weights=weights, increasing=up).x
        for up in (False, True)
    ]
    errors = [float((weights * (fit - levels) ** 2).sum()) for fit in fits]
    downstream = errors[0] <= errors[1]
    fit = fits[0 if downstream else 1]
    if np.ptp(fit) < LEVEL_M * scale.z:
        fit = np.full_like(fit, _weighted_median(levels, weights))
    stations = [
        s._replace(level=round(float(level))) for s, level in zip(stations, fit, strict=True)
    ]
    distances, heights = _with_steps(along, fit, line, water, scale)
    flow = lifted_line(line, distances, heights)
    if downstream:
        return Profile(flow, tuple(stations))
    turned = tuple(s._replace(left=s.right, right=s.left) for s in reversed(stations))
    return Profile(flow[::-1].copy(), turned)


def bank_level(heights: Int64) -> float:
    """Return the water level below a bank."""
    return float(np.percentile(heights, BANK_PERCENT))


def water_level(heights: Int64, scale: Scale) -> float | None:
    """Return the level of water from its own heights, or None if they are too few or not smooth.

    If heights differ by more than waves do, for example between strips flown at different water
    levels, the lower level counts.
    """
    if len(heights) < MIN_PIXELS:
        return None
    low, middle, high = np.percentile(heights, (25, 50, 75))
    if high - low > 2 * SMOOTH_M * scale.z:
        return None
    return float(low if high - low > SMOOTH_M * scale.z else middle)


def _stations(
    line: Float64, shore: Counts, water: Counts, spacing: float, scale: Scale
) -> tuple[Float64, list[Station], Float64]:
    """Return the stations to use: distances along the line in counts, stations, and weights."""
    shape = shapely.LineString(line)
    shore_along, water_along = (places_along(line, xyz[0], xyz[1]) for xyz in (shore, water))
    left = _left_of(line, shore, shore_along)
    distances = np.concatenate((shore_along, water_along))
    if not len(distances):
        return np.empty(0), [], np.empty(0)
    low, high = float(distances.min()), float(distances.max())
    steps = round((high - low) / spacing)
    along = np.linspace(low, high, steps + 1) if steps else np.array([(low + high) / 2])
    stations: list[Station | None] = []
    weights = np.zeros(len(along))
    for i, distance in enumerate(along):
        near = np.abs(shore_along - distance) <= spacing / 2
        water_heights = water[2][np.abs(water_along - distance) <= spacing / 2]
        banks = [shore[2][near & side] for side in (left, ~left)]
        x, y = shapely.get_coordinates(shape.interpolate(distance))[0]
        station, weights[i] = _station(round(x), round(y), water_heights, banks, scale)
        stations.append(station)
    keep = _decisive(stations)
    return (
        along[keep],
        [s for s, kept in zip(stations, keep, strict=True) if kept and s is not None],
        weights[keep],
    )


def _station(
    x: int, y: int, own: Int64, banks: list[Int64], scale: Scale
) -> tuple[Station | None, float]:
    """Return a station and the weight of its level, or None and 0 without evidence."""
    levels = [round(bank_level(bank)) if len(bank) >= MIN_PIXELS else None for bank in banks]
    water_height = water_level(own, scale)
    known = [level for level in levels if level is not None]
    if water_height is not None:
        return Station(x, y, round(water_height), len(own), levels[0], levels[1]), float(
            len(own)
        )
    if known:
        return Station(x, y, min(known), 0, levels[0], levels[1]), BANK_WEIGHT * sum(
            map(len, banks)
        )
    return None, 0.0


def _decisive(found: list[Station | None]) -> Bool:
    """Return a mask of the stations to use: stations with returns of the water, and others far from them."""
    has_returns = np.array([station is not None and station.seen > 0 for station in found])
    near = has_returns
    if has_returns.any():
        near = scipy.ndimage.binary_dilation(has_returns, iterations=NEAR_STATIONS)
    known = np.array([station is not None for station in found])
    return np.asarray(has_returns | (known & ~near))


def _left_of(line: Float64, xyz: Counts, along: Float64) -> Bool:
    """Return a mask of the points to the left of a line. ``along`` is the distance of each point along the line."""
    lengths = lengths_along(line)
    segment = np.clip(np.searchsorted(lengths, along, side="right") - 1, 0, len(line) - 2)
    start, step = line[segment], line[segment + 1] - line[segment]
    return np.asarray(
        step[:, 0] * (xyz[1] - start[:, 1]) - step[:, 1] * (xyz[0] - start[:, 0]) > 0
    )


def _weighted_median(values: Float64, weights: Float64) -> float:
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, cumulative[-1] / 2)])


def _with_steps(
    along: Float64, levels: Float64, line: Float64, water: Counts, scale: Scale
) -> tuple[Float64, Float64]:
    """Return distances along the line and levels, with two of each where the water has a step."""
    distances, heights = [along[:1]], [levels[:1]]
    inside = shapely.line_locate_point(
        shapely.LineString(line), shapely.points(water[0], water[1])
    )
    for i in range(len(along) - 1):
        fall, length = (
            abs(levels[i + 1] - levels[i]) / scale.z,
            (along[i + 1] - along[i]) / scale.xy,
        )
        if fall > STEP_M and fall > STEEPEST * length:
            step = _step_at(along[i], along[i + 1], levels[i], levels[i + 1], inside, water[2])
            distances.append(np.array([step - 0.05 * scale.xy, step + 0.05 * scale.xy]))
            heights.append(levels[i : i + 2])
        distances.append(along[i + 1 : i + 2])
        heights.append(levels[i + 1 : i + 2])
    return np.concatenate(distances), np.concatenate(heights)


def _step_at(
    start: float,
    end: float,
    before: float,
    after: float,
    inside: Float64,
    z: Int64,
) -> float:
    """Return the distance along the line at which the water's heights change from one level to the other."""
    here = np.flatnonzero((inside > start) & (inside < end))
    here = here[np.argsort(inside[here], kind="stable")]
    if not len(here):
        return (start + end) / 2
    is_before = np.abs(z[here] - before) <= np.abs(z[here] - after)
    wrong = np.concatenate(([0], np.cumsum(~is_before))) + np.concatenate(
        (np.cumsum(is_before[::-1])[::-1], [0])
    )
    cut = int(np.argmin(wrong))
    edges = np.concatenate(([start], inside[here], [end]))
    return float(edges[cut] + edges[cut + 1]) / 2
