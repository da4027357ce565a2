"""Points of GeoJSON (RFC 7946) and GeoPackage (OGC 12-128r19) files, with the standard library alone."""

from __future__ import annotations

import json
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

from tiler.check.points import GEOJSON_CRS, Row, row_of
from tiler.errors import InputError

_ENVELOPE_BYTES = (0, 32, 48, 48, 64)
_POINT = 1


def geojson_rows(path: Path) -> tuple[list[Row], str]:
    """The points of a GeoJSON file, and their CRS; raises InputError."""
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not valid GeoJSON ({error})") from error
    if not isinstance(content, dict) or content.get("type") != "FeatureCollection":
        raise InputError(f"{path}: no GeoJSON FeatureCollection; write the checkpoints as features")
    rows = []
    for number, feature in enumerate(content.get("features") or (), start=1):
        place = f"{path}: feature {number}"
        geometry = feature.get("geometry") or {}
        if geometry.get("type") != "Point":
            raise InputError(f"{place}: is a {geometry.get('type') or 'feature without place'}, not a Point")
        rows.append(_row(geometry.get("coordinates") or (), feature.get("properties") or {}, place))
    # Before RFC 7946 a member named the CRS, which is still what most programs write.
    named = (content.get("crs") or {}).get("properties", {}).get("name")
    return rows, str(named) if named else GEOJSON_CRS


def _row(coordinates: Any, properties: dict[str, Any], place: str) -> Row:
    """A row from a point; its third coordinate is the height, else a property is."""
    values = {str(name).lower(): value for name, value in properties.items()}
    values |= dict(zip(("x", "y", "z"), coordinates, strict=False))
    return row_of(values, place)


def geopackage_rows(path: Path) -> tuple[list[Row], str | None]:
    """The points of the one layer of points of a GeoPackage, and their CRS; raises InputError."""
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
            base.row_factory = sqlite3.Row
            return _layer(path, base)
    except sqlite3.Error as error:
        raise InputError(f"{path}: not a GeoPackage that can be read ({error})") from error


def _layer(path: Path, base: sqlite3.Connection) -> tuple[list[Row], str | None]:
    layers = base.execute(
        "SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns "
        "WHERE upper(geometry_type_name) = 'POINT'"
    ).fetchall()
    if len(layers) != 1:
        names = ", ".join(layer["table_name"] for layer in layers) or "none"
        raise InputError(
            f"{path}: needs one layer of points, has {len(layers)} ({names}); "
            "write one with `ogr2ogr points.gpkg FILE LAYER`"
        )
    table, column, srs = layers[0]
    rows: list[Row] = []
    for record in base.execute(f'SELECT * FROM "{_quoted(table)}"'):
        place = f"{path}: {table}, feature {len(rows) + 1}"
        properties = {name: record[name] for name in record.keys() if name != column}  # noqa: SIM118 - a Row
        rows.append(_row(_point(record[column], place), properties, place))
    found = base.execute(
        "SELECT organization, organization_coordsys_id, definition FROM gpkg_spatial_ref_sys WHERE srs_id = ?",
        (srs,),
    ).fetchone()
    if found is None or srs in (-1, 0):
        return rows, None
    if str(found["organization"]).upper() in ("NONE", ""):
        return rows, str(found["definition"])
    return rows, f"{found['organization']}:{found['organization_coordsys_id']}"


def _quoted(name: str) -> str:
    return name.replace('"', '""')


def _point(blob: Any, place: str) -> tuple[float, ...]:
    """Coordinates of a GeoPackage geometry (OGC 12-128r19, 2.1.3): a header, then well-known binary."""
    if not isinstance(blob, bytes) or blob[:2] != b"GP":
        raise InputError(f"{place}: has no GeoPackage geometry")
    try:
        start = 8 + _ENVELOPE_BYTES[(blob[3] >> 1) & 7]
        order = "<" if blob[start] else ">"
        (kind,) = struct.unpack_from(f"{order}I", blob, start + 1)
        # ISO: 1001 is a point with z, 2001 one with a measure; the older form sets the highest bits.
        has_z = kind // 1000 in (1, 3) or bool(kind & 0x80000000)
        if kind & 0x0FFFFFFF != _POINT and kind % 1000 != _POINT:
            raise InputError(f"{place}: is no point (type {kind})")
        return struct.unpack_from(f"{order}{3 if has_z else 2}d", blob, start + 5)
    except (struct.error, IndexError) as error:
        raise InputError(f"{place}: its geometry is damaged ({error})") from error
