"""Small vector files, written by the letter of their formats."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Ring = Sequence[Sequence[float]]


def collection(*geometries: dict[str, Any] | None) -> dict[str, Any]:
    """A GeoJSON FeatureCollection."""
    features = [{"type": "Feature", "properties": {}, "geometry": geometry} for geometry in geometries]
    return {"type": "FeatureCollection", "features": features}


def polygon_wkb(rings: Sequence[Ring], order: str = "<", code: int = 3) -> bytes:
    """Well-known binary of a polygon."""
    parts = [struct.pack(f"{order}BII", order == "<", code, len(rings))]
    for ring in rings:
        parts.append(struct.pack(f"{order}I", len(ring)))
        parts += [struct.pack(f"{order}{len(place)}d", *place) for place in ring]
    return b"".join(parts)


def geopackage(path: Path, geometries: Sequence[bytes | None], layers: int = 1, srs: int = 25832) -> Path:
    """A GeoPackage as far as its polygons go (OGC 12-128r19)."""
    with sqlite3.connect(path) as base:
        base.executescript(
            "PRAGMA synchronous = OFF;"
            "CREATE TABLE gpkg_geometry_columns (table_name, column_name, geometry_type_name, srs_id, z, m);"
            "CREATE TABLE gpkg_spatial_ref_sys (srs_name, srs_id, organization, organization_coordsys_id, definition);"
            "INSERT INTO gpkg_spatial_ref_sys VALUES ('utm', 25832, 'EPSG', 25832, 'PROJCS[]'),"
            " ('unknown', -1, 'NONE', -1, 'undefined');"
        )
        for layer in range(layers):
            row = (f"l{layer}", "geom", "MultiPolygon", srs, 2, 2)
            base.execute("INSERT INTO gpkg_geometry_columns VALUES (?, ?, ?, ?, ?, ?)", row)
            base.execute(f"CREATE TABLE l{layer} (fid INTEGER PRIMARY KEY, geom BLOB)")
            blobs = [None if g is None else b"GP\0\1" + struct.pack("<i", srs) + g for g in geometries]
            base.executemany(f"INSERT INTO l{layer} (geom) VALUES (?)", [(b,) for b in blobs])
    base.close()
    return path


def shapefile(path: Path, polygons: Sequence[Sequence[Ring] | None], kind: int = 5) -> Path:
    """A shapefile of polygons, None for a null shape, without the index and table beside it."""
    records = []
    for number, rings in enumerate(polygons, start=1):
        content = struct.pack("<i", 0)
        if rings is not None:
            places = [place for ring in rings for place in ring]
            firsts = [sum(len(r) for r in rings[:n]) for n in range(len(rings))]
            xs, ys = zip(*places, strict=True)
            content = struct.pack("<i4d2i", kind, min(xs), min(ys), max(xs), max(ys), len(rings), len(places))
            content += struct.pack(f"<{len(rings)}i", *firsts)
            content += b"".join(struct.pack("<2d", *place) for place in places)
        records.append(struct.pack(">2i", number, len(content) // 2) + content)
    body = b"".join(records)
    head = struct.pack(">7i", 9994, 0, 0, 0, 0, 0, (100 + len(body)) // 2) + struct.pack(
        "<2i8d", 1000, kind, *[0.0] * 8
    )
    path.write_bytes(head + body)
    return path
