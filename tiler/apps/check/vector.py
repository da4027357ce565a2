"""Checkpoints of GeoJSON and GeoPackage files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from tiler.apps.check.checkpoint_row import Row, row_of
from tiler.errors import InputError
from tiler.io.json_text import excerpt, member
from tiler.io.vector import geometry_of, read_features, read_layer

_POINT = 1


def geojson_rows(path: Path) -> tuple[list[Row], str]:
    """The points of a GeoJSON file, and their CRS; raises InputError."""
    features, crs = read_features(path, "the checkpoints")
    rows = []
    for number, feature in enumerate(features, start=1):
        place = f"{path}: feature {number}"
        geometry = member(feature, "geometry")
        kind, coordinates = geometry.get("type"), geometry.get("coordinates")
        if kind != "Point":
            raise InputError(
                f"{place}: is a {excerpt(kind) if kind else 'feature without place'}, not a Point"
            )
        if not isinstance(coordinates, list):
            raise InputError(f"{place}: its coordinates are {excerpt(coordinates)}, not [x, y, z]")
        rows.append(_row(coordinates, member(feature, "properties"), place))
    return rows, crs


def _row(coordinates: Any, properties: dict[str, Any], place: str) -> Row:
    """A row from a point; its third coordinate is the height, else a property is."""
    values = {str(name).lower(): value for name, value in properties.items()}
    values |= dict(zip(("x", "y", "z"), coordinates, strict=False))
    return row_of(values, place)


def geopackage_rows(path: Path) -> tuple[list[Row], str | None]:
    """The points of the one layer of points of a GeoPackage, and their CRS; raises InputError."""
    layer = read_layer(path, ("POINT",), "points")
    rows: list[Row] = []
    for blob, properties in layer.records:
        place = f"{path}: {layer.name}, feature {len(rows) + 1}"
        rows.append(_row(_point(geometry_of(blob, place), place), properties, place))
    return rows, layer.crs


def _point(geometry: bytes, place: str) -> tuple[float, ...]:
    """Coordinates of a point in well-known binary."""
    try:
        order = "<" if geometry[0] else ">"
        (kind,) = struct.unpack_from(f"{order}I", geometry, 1)
        # ISO: 1001 is a point with z, 2001 one with a measure; the older form sets the highest bits.
        has_z = kind // 1000 in (1, 3) or bool(kind & 0x80000000)
        if kind & 0x0FFFFFFF != _POINT and kind % 1000 != _POINT:
            raise InputError(f"{place}: is no point (type {kind})")
        return struct.unpack_from(f"{order}{3 if has_z else 2}d", geometry, 5)
    except (struct.error, IndexError) as error:
        raise InputError(f"{place}: its geometry is damaged ({error})") from error
