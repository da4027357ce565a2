"""Breaklines, edits and water drawn by the user, read and checked before the first point is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ptd.arrays import Float64, Int64
from tiler.core.area import Area
from tiler.core.breaklines import MAX_SEGMENT, two_heights
from tiler.core.edits import ACTIONS, FLAT, Edit
from tiler.core.lattice import COUNTS_PER_UNIT, INT32_LIMIT, Bounds
from tiler.core.review import STATUSES, is_edit, is_place
from tiler.core.water import KINDS, LAKE, RIVER, Water, lengths_along, lifted_line
from tiler.errors import ConfigError, InputError
from tiler.io.result_folder import REVIEW
from tiler.io.vector import (
    CUT,
    LINES,
    LINES_AND_POLYGONS,
    POINTS,
    POLYGONS,
    Feature,
    Features,
    Kind,
    read_in_crs,
    warn_outside,
)
from tiler.io.vector.reading import area_in_counts
from tiler.plan.model import Plan
from tiler.schedule import call_isolated

Counts = Int64

DRAWN_WATER = replace(
    LINES_AND_POLYGONS, point_layers=frozenset({"reaches"}), left_out=frozenset({"breaklines"})
)
"""Features read from a file of water: polygons, lines, and the points of the layer ``reaches``. The layer
``breaklines``, which a run writes for other programs, is left out."""
LEVEL = "level"
"""Name of the column with the height of the water, in the unit of the heights. If it is missing
or empty, the other height columns are used."""
SAME_COUNTS = 2
"""Maximum height difference in counts with which a station and a line agree."""


def with_user_features(plan: Plan) -> Plan:
    """Return the plan with the user's features, and with notes and warnings about them.

    Raises
    ------
    ConfigError
        Breaklines are given with an interpolation that ignores them.
    InputError
        A file cannot be used. The message contains the file, the feature and a remedy.
    """
    config = plan.config
    notes, warnings = list(plan.notes), list(plan.warnings)
    lines: list[Counts] = []
    if config.breaklines and config.interpolation == "idw":
        raise ConfigError("--breaklines: idw does not follow lines; use --interpolation linear")
    for name in config.breaklines:
        drawing = read_drawn(plan, Path(name), LINES_AND_POLYGONS, True, notes, warnings)
        for feature in drawing.features:
            lines += [_counts(feature, line) for line in _lines(feature)]
    if lines:
        warnings += [*_warn_two_heights(lines), *_warn_vertical(lines)]
    edits: tuple[Edit, ...] = ()
    if config.edits is not None:
        # The last places may have been removed, and the command stays the same.
        empty = Path(config.edits).name == REVIEW
        drawing = read_drawn(
            plan, Path(config.edits), POLYGONS, False, notes, warnings, may_be_empty=empty
        )
        edits = tuple(
            _edit(number, feature)
            for number, feature in enumerate(drawing.features, start=1)
            if _becomes_edit(feature)
        )
    waters: tuple[Water, ...] = ()
    if config.water_file is not None:
        drawing = read_drawn(
            plan, Path(config.water_file), DRAWN_WATER, False, notes, warnings, all_layers=True
        )
        waters = tuple(waters_of(drawing.features, plan.inputs.extent))
    inputs = replace(plan.inputs, lines=tuple(lines), edits=edits, waters=waters)
    return replace(plan, inputs=inputs, notes=tuple(notes), warnings=tuple(warnings))


def read_drawn(
    plan: Plan,
    path: Path,
    kind: Kind,
    needs_z: bool,
    notes: list[str],
    warnings: list[str] | None,
    all_layers: bool = False,
    may_be_empty: bool = False,
) -> Features:
    """Read the features of a file in the CRS of the run.

    All layers are read with ``all_layers``, or if the features need heights (``needs_z``).
    Features outside the survey cause a warning, unless ``warnings`` is None.
    """
    all_layers |= needs_z
    wkt = plan.frame.crs_wkt
    if plan.config.in_process:
        features = read_in_crs(path, kind, wkt, all_layers, needs_z, may_be_empty)
    else:
        arguments = (path, kind, wkt, all_layers, needs_z, may_be_empty)
        features = call_isolated(read_in_crs, *arguments, paths=(path,), smaller=CUT)
    notes += features.notes
    if warnings is not None:
        x0, y0, x1, y1 = (v / COUNTS_PER_UNIT for v in plan.inputs.extent.to_json())
        warnings += warn_outside(path, features, (x0, y0, x1, y1))
    return features


def _lines(feature: Feature) -> list[Float64]:
    """Return the vertices x, y, z of the lines of a feature and of the rings of its polygons."""
    import shapely

    lines = []
    for part in shapely.get_parts(feature.geometry):
        if part.geom_type == "Polygon":
            lines += list(shapely.get_rings(part))
        else:
            lines.append(part)
    return [shapely.get_coordinates(line, include_z=True) for line in lines]


def _counts(feature: Feature, line: Float64) -> Counts:
    if np.abs(line[:, 2]).max() * COUNTS_PER_UNIT > INT32_LIMIT:
        raise InputError(
            f"{feature.place}: its height {line[np.abs(line[:, 2]).argmax(), 2]:g} is not possible for terrain; "
            "check its unit"
        )
    counts = np.rint(line * COUNTS_PER_UNIT).astype(np.int64)
    longest = int(np.abs(np.diff(counts[:, :2], axis=0)).max(initial=0))
    if longest > MAX_SEGMENT:
        raise InputError(
            f"{feature.place}: two of its vertices are {longest / COUNTS_PER_UNIT:.3g} apart; "
            "give coordinates in units of its CRS"
        )
    return counts


def _warn_two_heights(lines: list[Counts]) -> list[str]:
    positions = two_heights(lines)
    if not len(positions):
        return []
    x, y, low, high = (value / COUNTS_PER_UNIT for value in positions[0].tolist())
    return [
        f"--breaklines: {len(positions)} positions have two heights, the first at ({x:.10g}, {y:.10g}): {low:g} and "
        f"{high:g}; only one of them is used; draw the top and the foot of a wall some centimetres apart"
    ]


def _warn_vertical(lines: list[Counts]) -> list[str]:
    """Warn if a line has vertical segments, since the terrain has one height per position."""
    vertical = []
    for line in lines:
        step = np.diff(line, axis=0)
        vertical.append(line[:-1][(step[:, :2] == 0).all(axis=1) & (step[:, 2] != 0)])
    starts = np.concatenate(vertical)
    if not len(starts):
        return []
    x, y, _ = (value / COUNTS_PER_UNIT for value in starts[0].tolist())
    return [
        f"--breaklines: vertical segments are left out ({len(starts)}, the first at {x:.10g}, {y:.10g}); draw the top "
        "and the foot of a wall some centimetres apart"
    ]


def _becomes_edit(feature: Feature) -> bool:
    """Return whether a feature is an edit: it is not a place to review, or one that is fixed.

    Raise InputError if it is a place to review without a known status.
    """
    columns = feature.attributes
    if not is_place(feature.layer, columns):
        return True
    if "status" not in columns:
        raise InputError(
            f"{feature.place}: is a place to review without the column `status`; add it, or give the file of the run"
        )
    status = columns["status"]
    if not is_edit(status) and str(status).strip().lower() not in STATUSES:
        raise InputError(
            f"{feature.place}: its status is {status!r}; give {', '.join(STATUSES)} in the column `status`"
        )
    return is_edit(status)


def _edit(number: int, feature: Feature) -> Edit:
    """Return the edit of a feature.

    Raise InputError if its action is unknown or its height is missing.
    """
    action: Any = feature.attributes.get("action")
    if not isinstance(action, str) or action.strip().lower() not in ACTIONS:
        fault = "has no `action`" if action is None else f"its action is {action!r}"
        raise InputError(
            f"{feature.place}: {fault}; give one of {', '.join(ACTIONS)} in the column `action`"
        )
    action = action.strip().lower()
    height = feature.height() if action == FLAT else None
    if action == FLAT and (height is None or abs(height) * COUNTS_PER_UNIT > INT32_LIMIT):
        fault = "without a height" if height is None else f"at {height:g}, which is no height"
        raise InputError(
            f"{feature.place} is flat {fault}; give one in the column `z`, in the unit of the heights"
        )
    z = None if height is None else round(height * COUNTS_PER_UNIT)
    return Edit(number, action, area_in_counts(feature.place, [feature]), z)


def waters_of(features: Sequence[Feature], extent: Bounds) -> list[Water]:
    """Return the bodies of water of a file, with heights if it has them.

    Adjacent polygons of one kind without a level form one body, because the borders of map
    sheets may divide a lake.

    Parameters
    ----------
    features : sequence of Feature
        Polygons, lines, and stations of reaches, in the CRS of the run. At a station, its level replaces the
        height of the line.
    extent : Bounds
        Extent of the points. Water outside it is left out.

    Raises
    ------
    InputError
        There are no polygons, or a kind, a level or the heights of a line cannot be used.
    """
    polygons = [f for f in features if f.geometry.geom_type in POLYGONS.types]
    if not polygons:
        file_text = features[0].place.rpartition(",")[0]
        raise InputError(
            f"{file_text}: has lines but no polygons; add polygons of the water that the lines flow through"
        )
    lines = _merged([f for f in features if f.geometry.geom_type in LINES.types])
    with_level: list[tuple[Feature, int]] = []
    without_level: dict[str, list[Feature]] = {}
    for feature in polygons:
        level = _level(feature)
        if level is None:
            without_level.setdefault(_kind(feature, lines), []).append(feature)
        else:
            with_level.append((feature, level))
    bodies = [Water(0, kind, area) for kind, area in _joined_polygons(without_level)]
    for feature, level in with_level:
        kind = _kind(feature, lines)
        bodies.append(Water(0, kind, area_in_counts(feature.place, [feature]), level))
    bodies = [_with_line(body, lines) for body in bodies if body.area.bounds.overlaps(extent)]
    stations = [f for f in features if f.geometry.geom_type in POINTS.types]
    bodies = _with_stations(bodies, stations)
    return [Water(n, b.kind, b.area, b.level, b.flow) for n, b in enumerate(bodies, start=1)]


def _joined_polygons(features_by_kind: dict[str, list[Feature]]) -> list[tuple[str, Area]]:
    """Join adjacent polygons of one kind. Return the kind and the area of each body."""
    import shapely

    kinds_and_areas = []
    for kind, features in sorted(features_by_kind.items()):
        whole = shapely.union_all([feature.geometry for feature in features])
        for part in shapely.get_parts(whole):
            if part.geom_type == "Polygon" and part.area > 0:
                kinds_and_areas.append(
                    (kind, area_in_counts(features[0].place, [Feature("", part, {})]))
                )
    return kinds_and_areas


def _kind(feature: Feature, lines: Sequence[Any]) -> str:
    """Return the kind in the column, or else river if a line flows through the polygon, or else lake.

    Raise InputError if the kind is unknown.
    """
    import shapely

    value = feature.attributes.get("kind")
    if value is None or value == "":
        return (
            RIVER
            if any(shapely.intersection(line, feature.geometry).length for line in lines)
            else LAKE
        )
    kind = KINDS.get(value.strip().lower()) if isinstance(value, str) else None
    if kind is None:
        raise InputError(
            f"{feature.place}: its kind is {value!r}; give {LAKE} or {RIVER} in the column `kind`, or leave it empty"
        )
    return kind


def _level(feature: Feature) -> int | None:
    """Return the level of a feature in counts, or None. Raise InputError if it is not a height."""
    value: Any = feature.attributes.get(LEVEL)
    value = feature.height() if value is None else value
    if value is None:
        return None
    known = isinstance(value, int | float) and not isinstance(value, bool)
    if not known or not abs(value) * COUNTS_PER_UNIT < INT32_LIMIT:
        raise InputError(
            f"{feature.place}: its level {value!r} is not a height; give a number in the unit of the heights in "
            f"the column `{LEVEL}`, or leave it empty"
        )
    height: int = round(value * COUNTS_PER_UNIT)
    return height


def _merged(features: Sequence[Feature]) -> list[Any]:
    """Return the flow lines. Lines with heights are turned downhill, and lines without heights are merged.

    Raise InputError if the heights of a line rise and fall, or are too large.
    """
    import shapely

    flat: list[Any] = []
    sloping_lines: list[Any] = []
    for feature in features:
        for line in shapely.get_parts(feature.geometry):
            z = (
                shapely.get_coordinates(line, include_z=True)[:, 2]
                if line.has_z
                else np.array([np.nan])
            )
            # Formats without 2D lines write heights of 0.
            if not np.isfinite(z).all() or not z.any():
                flat.append(shapely.force_2d(line))
                continue
            if ((np.diff(z) < 0).any() and (np.diff(z) > 0).any()) or np.abs(z).max() > 1e6:
                raise InputError(
                    f"{feature.place}: its heights rise and fall; give heights that fall along the line, or draw "
                    "it in 2D"
                )
            sloping_lines.append(shapely.reverse(line) if z[-1] > z[0] else line)
    if not flat:
        return sloping_lines
    return [
        *sloping_lines,
        *shapely.get_parts(shapely.line_merge(shapely.MultiLineString(flat))),
    ]


def _with_line(body: Water, lines: Sequence[Any]) -> Water:
    """Return a river with the line that is longest within it. Lines with heights take precedence."""
    import shapely

    if body.kind != RIVER or not lines:
        return body
    shape = shapely.union_all([_polygon(rings) for rings in body.area.polygons])
    inside = [line for line in lines if shapely.intersection(line, shape).length]
    if not inside:
        return body
    longest = max(
        inside, key=lambda line: (bool(line.has_z), shapely.intersection(line, shape).length)
    )
    vertices: Float64 = shapely.get_coordinates(longest, include_z=bool(longest.has_z))
    flow = np.rint(vertices * COUNTS_PER_UNIT).astype(np.int64)
    return Water(body.number, RIVER, body.area, None, flow)


def _polygon(rings: Sequence[Int64]) -> Any:
    import shapely

    return shapely.Polygon(
        rings[0] / COUNTS_PER_UNIT, [ring / COUNTS_PER_UNIT for ring in rings[1:]]
    )


def _with_stations(bodies: list[Water], stations: Sequence[Feature]) -> list[Water]:
    """Return the bodies of water. Stations change the levels of the river whose line is nearest.

    Raise InputError if levels along a line rise and fall.
    """
    import shapely

    rivers = [i for i, body in enumerate(bodies) if body.flow is not None]
    if not rivers or not stations:
        return bodies
    lines = [shapely.LineString(_flow(bodies[i])[:, :2] / COUNTS_PER_UNIT) for i in rivers]
    stations_by_river: dict[int, list[Feature]] = {}
    for station in stations:
        nearest = int(np.argmin([shapely.distance(line, station.geometry) for line in lines]))
        stations_by_river.setdefault(nearest, []).append(station)
    new_bodies = list(bodies)
    for nearest, river_stations in stations_by_river.items():
        new_bodies[rivers[nearest]] = _at_stations(
            bodies[rivers[nearest]], lines[nearest], river_stations
        )
    return new_bodies


def _at_stations(body: Water, line: Any, stations: Sequence[Feature]) -> Water:
    """Return a river whose line has the levels of its stations.

    Between stations the change of the heights is interpolated, so steps in the heights of the
    line remain.
    """
    import shapely

    levels = [_level(station) for station in stations]
    known = [
        (station, level)
        for station, level in zip(stations, levels, strict=True)
        if level is not None
    ]
    if not known:
        return body
    along = np.array(
        [shapely.line_locate_point(line, s.geometry) * COUNTS_PER_UNIT for s, _ in known]
    )
    station_levels = np.array([level for _, level in known], np.float64)
    order = np.argsort(along, kind="stable")
    along, station_levels = along[order], station_levels[order]
    flow = _flow(body)
    if flow.shape[1] == 2:
        lifted = lifted_line(flow, along, station_levels)
    else:
        lengths = lengths_along(flow)
        change = station_levels - np.rint(np.interp(along, lengths, flow[:, 2]))
        if (np.abs(change) <= SAME_COUNTS).all():
            return body
        positions = np.unique(np.concatenate((lengths, along)))
        heights = np.interp(positions, lengths, flow[:, 2]) + np.interp(
            positions, along, change
        )
        lifted = lifted_line(flow, positions, heights)
    if (np.diff(lifted[:, 2]) > 0).any():
        if (np.diff(lifted[:, 2]) < 0).any():
            file_text = known[int(order[0])][0].place.rpartition(",")[0]
            raise InputError(
                f"{file_text}: levels of a river rise and fall; give levels that fall along its line"
            )
        lifted = lifted[::-1].copy()
    return replace(body, level=None, flow=lifted)


def _flow(body: Water) -> Int64:
    assert body.flow is not None
    return body.flow
