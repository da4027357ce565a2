"""Sheets drawn by the user (``--sheets FILE``), read and checked before the first point is read."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.drawn_sheets import DrawnSheet
from tiler.core.file_names import LONGEST, fault_of_name, folded
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.words import listed
from tiler.errors import ConfigError, InputError
from tiler.io.vector import POLYGONS, Feature
from tiler.io.vector.reading import area_in_counts
from tiler.plan.drawings import read_drawn
from tiler.plan.model import Plan

REACH = 1000 * COUNTS_PER_UNIT
"""Distance in counts around the expected extent of the points within which sheets are kept. National grids have
thousands of sheets elsewhere."""
MAX_FIELDS = 20
"""Number of fields that an error lists. Further fields are counted."""


def with_drawn_sheets(plan: Plan) -> Plan:
    """Return the plan with the sheets that the user drew, and with notes and warnings about them.

    Raises
    ------
    ConfigError
        A file is given without a field, or a field without sheets.
    InputError
        The file cannot be used, or the values of the field are not names.
    """
    config = plan.config
    file, field = config.sheet_file, config.sheet_field
    if file is None:
        return _without_file(plan)
    notes, warnings = list(plan.notes), list(plan.warnings)
    drawing = read_drawn(plan, Path(file), POLYGONS, False, notes, None)
    features = drawing.features
    titles = list(dict.fromkeys(title for f in features for title in f.attributes))
    there = f"its fields are {listed(titles, MAX_FIELDS)}" if titles else "it has no fields"
    if field is None:
        raise ConfigError(
            f"--sheets {file}: needs the field with the names of the sheets, and {there}; give --sheet-field NAME"
        )
    if field.lower() not in titles:
        raise InputError(
            f"{file}: has no field {field!r}, {there}; give one of them with --sheet-field"
        )
    areas = [area_in_counts(feature.place, [feature]) for feature in features]
    near = plan.inputs.extent.pad(REACH)
    here = [i for i, area in enumerate(areas) if area.touches(near)]
    validate_on_clouds(config, [areas[i] for i in here], plan.inputs.extent)
    names = _names([features[i] for i in here], field)
    sheets = [DrawnSheet(name, areas[i]) for name, i in zip(names, here, strict=True)]
    pixel = float(plan.frame.counts(plan.grid.resolution))
    sheets, wide = in_order(sheets, pixel)
    warnings += _overlap_warnings(file, sheets, wide)
    inputs = replace(plan.inputs, sheets=tuple(sheets))
    return replace(plan, inputs=inputs, notes=tuple(notes), warnings=tuple(warnings))


def validate_on_clouds(config: RunConfig, areas: Iterable[Area], extent: Bounds) -> None:
    """Raise InputError if no area of the drawn sheets contains a part of the clouds, with this extent in counts."""
    # Points on the outer edge of the extent make no pixel, so a sheet beyond it would be empty.
    if config.sheet_file is None or any(area.touches(extent.pad(-2)) for area in areas):
        return
    west, south, east, north = (v / COUNTS_PER_UNIT for v in extent.to_json())
    raise InputError(
        f"{config.sheet_file}: no polygon contains a part of the clouds, which lie in ({west:.10g}, {south:.10g}) to "
        f"({east:.10g}, {north:.10g}); give polygons there"
    )


def _overlap_warnings(
    file: str, sheets: Sequence[DrawnSheet], wide: Sequence[tuple[str, str]]
) -> Iterator[str]:
    """Yield warnings of pairs of sheets that overlap by more than a pixel, and of polygons that repeat."""
    if wide:
        pairs = listed([f"{a} and {b}" for a, b in wide], 2, "pairs")
        yield (
            f"{file}: sheets overlap by more than a pixel ({pairs}); pixels of both are in the one that is first in "
            "the file"
        )
    again = [sheet.name for sheet in sheets if sheet.area.key in sheet.earlier]
    if again:
        yield (
            f"{file}: no file is written for {listed(again, 2, 'sheets')}, which have the polygon of an earlier sheet; "
            "remove what is there twice"
        )


def _without_file(plan: Plan) -> Plan:
    """Return the plan without drawn sheets, with a note if the field is not used. Raise ConfigError without sheets."""
    config = plan.config
    if config.sheet_field is None:
        return plan
    if config.sheets is None:
        raise ConfigError(
            f"--sheet-field {config.sheet_field}: names the sheets of a file; give --sheets FILE as well"
        )
    note = f"the sheets are a grid, so --sheet-field {config.sheet_field} is not used"
    return replace(plan, notes=(*plan.notes, note))


def _names(features: Sequence[Feature], field: str) -> list[str]:
    """Return the names of the sheets. Raise InputError if they are missing, repeated or not valid file names."""
    places: dict[str, str] = {}
    names = []
    for feature in features:
        value = feature.attributes.get(field.lower())
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        name = "" if value is None else unicodedata.normalize("NFC", str(value))
        fault = fault_of_name(name)
        if not name.strip():
            fault = "is empty"
        elif len(name.encode()) > LONGEST:
            fault = f"has more than {LONGEST} bytes"
        elif not fault and folded(name) in places:
            where = "" if name in names else "on some disks "
            fault = f"is {where}also that of {places[folded(name)]}"
        if fault:
            raise InputError(
                f"{feature.place}: its {field} {name!r} {fault}; give each sheet a name of its own that files may have"
            )
        places[folded(name)] = feature.place.rpartition(", ")[2]
        names.append(name)
    return names


def in_order(
    sheets: Sequence[DrawnSheet], pixel: float
) -> tuple[list[DrawnSheet], list[tuple[str, str]]]:
    """Return the sheets with those before them that overlap them, and the names of pairs that share a pixel or more.

    Sheets that only share an edge do not overlap. Grids whose coordinates were rounded overlap by slivers.
    """
    import shapely

    shapes = np.array(
        [
            shapely.union_all(
                shapely.make_valid(
                    [shapely.Polygon(rings[0], rings[1:]) for rings in s.area.polygons]
                )
            )
            for s in sheets
        ],
        object,
    )
    later, earlier = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    is_pair = earlier < later
    later, earlier = later[is_pair], earlier[is_pair]
    share = shapely.relate_pattern(shapes[later], shapes[earlier], "T********")
    keys: dict[int, list[str]] = {}
    wide = []
    for second, first in sorted(
        zip(later[share].tolist(), earlier[share].tolist(), strict=True)
    ):
        keys.setdefault(second, []).append(sheets[first].area.key)
        common = shapely.intersection(shapes[first], shapes[second])
        if not shapely.buffer(common, -pixel / 2).is_empty:
            wide.append((sheets[first].name, sheets[second].name))
    ordered = [replace(s, earlier=tuple(keys.get(i, ()))) for i, s in enumerate(sheets)]
    return ordered, wide
