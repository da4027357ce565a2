"""Breaklines, edits and water drawn by the user, read and checked before the first point is read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.breaklines import MAX_SEGMENT, two_heights
from tiler.core.edits import ACTIONS, FLAT, Edit
from tiler.core.lattice import COUNTS_PER_UNIT, INT32_LIMIT
from tiler.core.water import Water
from tiler.errors import ConfigError, InputError
from tiler.io.vector import (
    CUT,
    LINES_AND_POLYGONS,
    POLYGONS,
    Feature,
    Features,
    Kind,
    read_in_crs,
    warn_outside,
)
from tiler.io.vector.reading import area_in_counts
from tiler.plan.model import Plan
from tiler.plan.waters import DRAWN_WATER, waters_of
from tiler.schedule import call_isolated

Counts = npt.NDArray[np.int64]


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
        drawing = _read(plan, Path(name), LINES_AND_POLYGONS, True, notes, warnings)
        for feature in drawing.features:
            lines += [_counts(feature, line) for line in _lines(feature)]
    if lines:
        warnings += [*_warn_two_heights(lines), *_warn_vertical(lines)]
    edits: tuple[Edit, ...] = ()
    if config.edits is not None:
        drawing = _read(plan, Path(config.edits), POLYGONS, False, notes, warnings)
        edits = tuple(
            _edit(number, feature) for number, feature in enumerate(drawing.features, start=1)
        )
    waters: tuple[Water, ...] = ()
    if config.water_file is not None:
        drawing = _read(
            plan, Path(config.water_file), DRAWN_WATER, False, notes, warnings, all_layers=True
        )
        waters = tuple(waters_of(drawing.features, plan.inputs.extent))
    inputs = replace(plan.inputs, lines=tuple(lines), edits=edits, waters=waters)
    return replace(plan, inputs=inputs, notes=tuple(notes), warnings=tuple(warnings))


def _warn_two_heights(lines: list[Counts]) -> list[str]:
    """Warn if breaklines have two heights at a position."""
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


def _read(
    plan: Plan,
    path: Path,
    kind: Kind,
    needs_z: bool,
    notes: list[str],
    warnings: list[str],
    all_layers: bool = False,
) -> Features:
    """Read the features of a file in the CRS of the run.

    All layers are read with ``all_layers``, or if the features need heights (``needs_z``).
    """
    all_layers |= needs_z
    wkt = plan.frame.crs_wkt
    if plan.config.in_process:
        features = read_in_crs(path, kind, wkt, all_layers, needs_z)
    else:
        features = call_isolated(
            read_in_crs, path, kind, wkt, all_layers, needs_z, paths=(path,), smaller=CUT
        )
    notes += features.notes
    x0, y0, x1, y1 = (v / COUNTS_PER_UNIT for v in plan.inputs.extent.to_json())
    warnings += warn_outside(path, features, (x0, y0, x1, y1))
    return features


def _lines(feature: Feature) -> list[npt.NDArray[np.float64]]:
    """Return the vertices x, y, z of the lines of a feature and of the rings of its polygons."""
    import shapely

    lines = []
    for part in shapely.get_parts(feature.geometry):
        if part.geom_type == "Polygon":
            lines += list(shapely.get_rings(part))
        else:
            lines.append(part)
    return [shapely.get_coordinates(line, include_z=True) for line in lines]


def _counts(feature: Feature, line: npt.NDArray[np.float64]) -> Counts:
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
        raise InputError(
            f"{feature.place} is flat without a height; give it in the column `z`, in the unit of the heights"
        )
    z = None if height is None else round(height * COUNTS_PER_UNIT)
    return Edit(number, action, area_in_counts(feature.place, [feature]), z)
