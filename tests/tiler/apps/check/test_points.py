"""Checkpoints of the formats that are read, and what is refused."""

from __future__ import annotations

import json
import sqlite3
import struct
from pathlib import Path

import pytest

from tiler.apps.check import read_checkpoints
from tiler.errors import InputError


def text(path: Path, content: str) -> Path:
    path.write_text(content, encoding="utf-8")
    return path


def test_csv_with_a_heading(tmp_path: Path) -> None:
    path = text(tmp_path / "p.csv", (
        "\ufeff# surveyed\nID;Northing;Easting;Height;Type;Land_Cover\n"
        "a;20;10;5.5;nva;asphalt\n\nb;21;11;6.5;VVA;tall grass\n"
    ))  # fmt: skip
    points = read_checkpoints(path)
    assert points.xy.tolist() == [[10, 11], [20, 21]]
    assert points.z.tolist() == [5.5, 6.5]
    assert (points.kinds, points.covers, points.names) == (
        ("NVA", "VVA"),
        ("asphalt", "tall grass"),
        ("a", "b"),
    )
    assert (points.crs, points.notes) == (None, ())


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_csv_without_a_heading(tmp_path: Path, delimiter: str) -> None:
    points = read_checkpoints(text(tmp_path / "p.txt", delimiter.join(("1", "2", "3")) + "\n"))
    assert (points.xy.tolist(), points.z.tolist(), points.names) == ([[1], [2]], [3], ("1",))
    assert points.notes == ("no column says NVA or VVA: all checkpoints count as non-vegetated (NVA)",)


def feature(coordinates: list[float], **properties: object) -> dict[str, object]:
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": coordinates},
        "properties": properties,
    }


def test_geojson(tmp_path: Path) -> None:
    content = {
        "type": "FeatureCollection",
        "features": [feature([9.0, 48.0, 7.25], Type="VVA", name="t1"), feature([9.1, 48.1], Height=8)],
    }
    points = read_checkpoints(text(tmp_path / "p.geojson", json.dumps(content)))
    assert (points.xy.tolist(), points.z.tolist()) == ([[9.0, 9.1], [48.0, 48.1]], [7.25, 8])
    assert (points.kinds, points.names, points.crs) == (("VVA", "NVA"), ("t1", "2"), "EPSG:4326")
    content["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    assert (
        read_checkpoints(text(tmp_path / "q.json", json.dumps(content))).crs == "urn:ogc:def:crs:EPSG::25832"
    )


def geopackage(path: Path, blobs: list[bytes], layers: int = 1) -> Path:
    """A GeoPackage as far as its points go (OGC 12-128r19)."""
    with sqlite3.connect(path) as base:
        base.executescript(
            "CREATE TABLE gpkg_geometry_columns (table_name, column_name, geometry_type_name, srs_id, z, m);"
            "CREATE TABLE gpkg_spatial_ref_sys (srs_name, srs_id, organization, organization_coordsys_id, definition);"
            "INSERT INTO gpkg_spatial_ref_sys VALUES ('utm', 25832, 'EPSG', 25832, 'PROJCS[]');"
        )
        for layer in range(layers):
            base.execute(
                f"INSERT INTO gpkg_geometry_columns VALUES ('l{layer}', 'geom', 'POINT', 25832, 1, 0)"
            )
            base.execute(f"CREATE TABLE l{layer} (fid INTEGER PRIMARY KEY, geom BLOB, cover TEXT)")
            base.executemany(
                f"INSERT INTO l{layer} (geom, cover) VALUES (?, 'gravel')", [(b,) for b in blobs]
            )
    base.close()
    return path


def test_geopackage(tmp_path: Path) -> None:
    plain = b"GP\0\1" + struct.pack("<iBI3d", 25832, 1, 1001, 1.0, 2.0, 3.0)
    boxed = (
        b"GP\0\2"
        + struct.pack(">i4d", 25832, 4, 4, 5, 5)
        + struct.pack(">BI3d", 0, 0x80000001, 4.0, 5.0, 6.0)
    )
    points = read_checkpoints(geopackage(tmp_path / "p.gpkg", [plain, boxed]))
    assert (points.xy.tolist(), points.z.tolist()) == ([[1, 4], [2, 5]], [3, 6])
    assert (points.crs, points.covers, points.names) == ("EPSG:25832", ("gravel", "gravel"), ("1", "2"))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("p.csv", "x,y,z\n1,2,high\n", r"line 2: z 'high' is no number"),
        ("p.csv", "x,y\n1,2\n", r"line 2: z is missing"),
        ("p.csv", "x;y;z\n1;2;3,5\n", r"line 2: z '3,5' is no number \(1234.5, with a point\)"),
        ("p.csv", "x,y,z\n1,2,inf\n", r"line 2: z 'inf' is no number"),
        ("p.csv", "x,y,z,type\n1,2,3,forest\n", r"type 'forest' is neither NVA nor VVA; name land cover"),
        ("p.csv", "x,y,z\n", "holds no checkpoint"),
        ("p.csv", "", "holds no checkpoint"),
        ("p.shp", "", r"convert it, for example with `ogr2ogr points.gpkg FILE`"),
        ("p.geojson", "{", "not valid GeoJSON"),
        ("p.geojson", "[]", r"not valid GeoJSON \(holds no object\)"),
        ("p.geojson", "{}", "no GeoJSON FeatureCollection"),
        ("p.csv", "x,y,z,id\n1,2,3,'a'\n1,2,3,\"b\n4,5,6,c\n", "line 3: is no line of a table .unexpected end of data"),
        ("p.csv", f"x,y,z\n1,2,{'9' * 200_000}\n", "line 2: is no line of a table .field larger than field limit"),
        ("p.csv", f"x,y,z\n1,2,{'9' * 400}\n", r"line 2: z '9+\.\.\. is no number"),
        ("p.geojson", '{"type": "FeatureCollection", "features": [{"geometry": {"type": "Polygon"}}]}',
         "feature 1: is a 'Polygon', not a Point"),
        ("p.gpkg", "no data base", "not a GeoPackage that can be read"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_checkpoints(text(tmp_path / name, content))


def test_what_is_refused_of_a_geopackage(tmp_path: Path) -> None:
    polygon = b"GP\0\1" + struct.pack("<iBI3d", 25832, 1, 1003, 1.0, 2.0, 3.0)
    for name, blob, message in (
        ("a", polygon, "no point"),
        ("b", b"GP\0\1", "damaged"),
        ("c", b"", "no GeoPackage"),
    ):
        with pytest.raises(InputError, match=message):
            read_checkpoints(geopackage(tmp_path / f"{name}.gpkg", [blob]))
    with pytest.raises(InputError, match=r"needs one layer of points, has 2 \(l0, l1\)"):
        read_checkpoints(geopackage(tmp_path / "two.gpkg", [], layers=2))
    with pytest.raises(InputError, match="no such file"):
        read_checkpoints(tmp_path / "absent.csv")
