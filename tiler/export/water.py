"""Bodies of water as a file that users can edit and use as an input."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from ptd.arrays import Float64
from tiler.core.lattice import COUNTS_PER_UNIT, CoordFrame
from tiler.core.water import Counts, Water, lengths_along
from tiler.export.output_files import OutFile, WaterFileRecord, new_file
from tiler.io.vector import GeoPackage, geopackage
from tiler.store import TileStore

POLYGONS, FLOW, REACHES, BREAKLINES = "water", "flow", "reaches", "breaklines"
"""Layers of the file."""
STEP_SLOPE = 1.0
"""Slope of a river's line above which a structure (a dam, a weir, a fall) is assumed to lie
across it."""

MAX_DAM_M, MIN_DAM_M = 40.0, 0.5
"""A dam between two bodies is at most this wide, and its levels differ by at least this, in
metres."""
WIDER_DAM = 2.0
"""A dam is at most this many times as wide as at its narrowest."""


def write_water(store: TileStore, *, to: OutFile, waters: str) -> WaterFileRecord:
    """Write bodies of water, which are in the store under the key ``waters``.

    Layer ``water`` has polygons with ``number``, ``kind``, ``level`` (for a river, its upper level), ``level_end``,
    ``area_m2`` and ``sure`` (confidence from 0 to 1, empty for water from a file).

    Layer ``flow`` has the line of each river, with the height of the water at each vertex.

    Layer ``reaches`` has the stations of each river in downstream order, with ``number``,
    ``along`` (distance from the first station in the unit of the CRS), ``level``, ``seen``
    (number of pixels of the water from which the level was estimated), ``left``, ``right``
    (levels estimated from the banks) and ``slope_permille`` (slope to the next one).

    Layer ``breaklines`` has shores at their level, lines of flow, and structures in 3D, with
    ``number`` and ``kind`` (shore, flow or structure). A structure is a line from bank to bank
    at a step, with the level above the step, or the upper shore at a dam between two bodies.

    Returns
    -------
    WaterFileRecord
        Record of the file.
    """
    bodies = store.all_waters(waters).bodies
    square = float(store.meta.frame.units.horizontal) ** 2
    shapes = [_shape(body) for body in bodies]
    columns = {
        "number": np.array([b.number for b in bodies], np.int64),
        "kind": np.array([b.kind for b in bodies], object),
        "level": np.array([b.range[0] for b in bodies], np.float64),
        "level_end": np.array([b.range[1] for b in bodies], np.float64),
        "area_m2": np.array([shape.area * square for shape in shapes], np.float64),
        "sure": np.array(
            [np.nan if b.confidence is None else b.confidence for b in bodies], np.float64
        ),
    }
    rivers = [(b.number, b.flow) for b in bodies if b.flow is not None]
    with new_file(to) as new, geopackage(new.path, store.meta.frame.crs_wkt) as file:
        file.add(POLYGONS, "MultiPolygon", shapes, columns)
        lines = [shapely.LineString(flow / COUNTS_PER_UNIT) for _, flow in rivers]
        file.add(
            FLOW, "LineString Z", lines, {"number": np.array([n for n, _ in rivers], np.int64)}
        )
        _add_reaches(file, bodies, store.meta.frame)
        _add_breaklines(file, bodies, store.meta.frame)
    return WaterFileRecord(**new.record.to_json(), bodies=len(bodies))


def _add_reaches(file: GeoPackage, bodies: Sequence[Water], frame: CoordFrame) -> None:
    rivers = [body for body in bodies if body.stations]
    stations = [station for body in rivers for station in body.stations]
    along, slopes = [np.empty(0)], [np.empty(0)]
    for body in rivers:
        lengths = lengths_along(np.array([station[:2] for station in body.stations]))
        fall = -np.diff([station.level for station in body.stations]) * float(frame.metres_z)
        slope = 1000 * fall / np.maximum(np.diff(lengths) * float(frame.metres_xy), 1e-9)
        along.append(lengths / COUNTS_PER_UNIT)
        slopes.append(np.append(slope, np.nan))
    z = (
        np.array([[s.level, s.left, s.right] for s in stations], np.float64).reshape(-1, 3)
        / COUNTS_PER_UNIT
    )
    numbers = [body.number for body in rivers for _ in body.stations]
    columns = {
        "number": np.array(numbers, np.int64),
        "along": np.concatenate(along),
        "level": z[:, 0],
        "seen": np.array([station.seen for station in stations], np.int64),
        "left": z[:, 1],
        "right": z[:, 2],
        "slope_permille": np.concatenate(slopes),
    }
    points = [shapely.Point(np.array([s.x, s.y, s.level]) / COUNTS_PER_UNIT) for s in stations]
    file.add(REACHES, "Point Z", points, columns)


def _add_breaklines(file: GeoPackage, bodies: Sequence[Water], frame: CoordFrame) -> None:
    """Write shores at their level, lines of flow, and structures, as layer ``breaklines``."""
    rows: list[tuple[int, str, Any]] = []
    for body, body_dams in zip(bodies, dams(bodies, frame), strict=True):
        rings = [ring for polygon in body.area.polygons for ring in polygon]
        closed = (np.concatenate((ring, ring[:1])) for ring in rings)
        rows += [(body.number, "shore", _lifted(body, ring)) for ring in closed]
        if body.flow is not None:
            rows.append((body.number, "flow", body.flow))
        rows += [(body.number, "structure", line) for line in (*structures(body), *body_dams)]
    lines = [shapely.LineString(line / COUNTS_PER_UNIT) for _, _, line in rows]
    columns = {
        "number": np.array([number for number, _, _ in rows], np.int64),
        "kind": np.array([kind for _, kind, _ in rows], object),
    }
    file.add(BREAKLINES, "LineString Z", lines, columns)


def structures(body: Water) -> list[Float64]:
    """Return lines from bank to bank across the steps of a river, float64 (2, 3) in counts.

    Their height is the level upstream of the step.
    """
    flow = body.flow
    if flow is None or flow.shape[1] < 3:
        return []
    shape, lines_across = shapely.make_valid(_shape(body)), []
    diagonal = math.hypot(*np.ptp(shapely.get_coordinates(shape), axis=0))
    falls = -np.diff(flow[:, 2]) > STEP_SLOPE * np.diff(lengths_along(flow))
    for i in np.flatnonzero(falls).tolist():
        before, after = flow[max(i - 1, 0), :2], flow[min(i + 2, len(flow) - 1), :2]
        middle, way = (
            (flow[i, :2] + flow[i + 1, :2]) / 2 / COUNTS_PER_UNIT,
            (after - before).astype(float),
        )
        aside = np.array([-way[1], way[0]]) / max(math.hypot(*way), 1.0) * diagonal
        lines = shapely.get_parts(
            shapely.LineString([middle + aside, middle - aside]).intersection(shape)
        )
        lines = lines[shapely.length(lines) > 0]
        if not len(lines):
            continue
        nearest = lines[shapely.distance(lines, shapely.Point(middle)).argmin()]
        ends = shapely.get_coordinates(nearest)[[0, -1]] * COUNTS_PER_UNIT
        lines_across.append(np.column_stack((ends, np.full(2, float(flow[i, 2])))))
    return lines_across


def dams(bodies: Sequence[Water], frame: CoordFrame) -> list[list[Float64]]:
    """Return the shores at dams to lower bodies for each body, as lines float64 (n, 3) in counts."""
    max_width = MAX_DAM_M / float(frame.units.horizontal)
    min_counts = MIN_DAM_M / float(frame.metres_z)
    shapes = [shapely.make_valid(_shape(body)) for body in bodies]
    pairs = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=max_width)
    lines: list[list[Float64]] = [[] for _ in bodies]
    for upper, lower in pairs.T.tolist():
        across = shapely.get_coordinates(shapely.shortest_line(shapes[upper], shapes[lower]))
        x, y = np.rint(across * COUNTS_PER_UNIT).astype(np.int64).T
        fall = bodies[upper].heights(x[:1], y[:1]) - bodies[lower].heights(x[1:], y[1:])
        if fall[0] < min_counts:
            continue
        width = float(np.hypot(*(across[1] - across[0])))
        near = shapely.buffer(shapes[lower], WIDER_DAM * width)
        shore = shapely.line_merge(shapely.intersection(shapely.boundary(shapes[upper]), near))
        parts = shapely.get_parts(shore)
        for part in parts[shapely.length(parts) > width]:
            lines[upper].append(
                _lifted(bodies[upper], shapely.get_coordinates(part) * COUNTS_PER_UNIT)
            )
    return lines


def _lifted(body: Water, line: Float64 | Counts) -> Float64:
    """Return a line in counts at the level of the water."""
    xy = np.rint(line).astype(np.int64)
    return np.column_stack((xy, body.heights(xy[:, 0], xy[:, 1])))


def _shape(body: Water) -> Any:
    """Return the polygons of a body in units of the CRS."""
    polygons = [[ring / COUNTS_PER_UNIT for ring in rings] for rings in body.area.polygons]
    return shapely.MultiPolygon([shapely.Polygon(outer, holes) for outer, *holes in polygons])
