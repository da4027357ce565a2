"""Vector files that are damaged or meant to do harm: what they hold, or one line that names them, and nothing else."""

from __future__ import annotations

import json
import random
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyproj
import pytest

from tests.tiler.apps.check.rasters import tilted, write_surface
from tests.tiler.junk import spoilt
from tiler.apps.check import PointOptions, check_dtm, read_checkpoints
from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.io.vector import read_polygons
from tiler.plan.area import area_of

Read = Callable[[Path], Any]

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 0]]
GEOMETRIES: dict[Read, tuple[dict[str, Any], bytes, str]] = {
    read_polygons: (
        {"type": "MultiPolygon", "coordinates": [[SQUARE]]},
        struct.pack("<BIII8d", 1, 3, 1, 4, *(v for place in SQUARE for v in place)),
        "POLYGON",
    ),
    read_checkpoints: (
        {"type": "Point", "coordinates": [0, 0, 5]},
        struct.pack("<BI3d", 1, 1001, 1, 2, 3),
        "POINT",
    ),
}
readers = pytest.mark.parametrize("read", GEOMETRIES, ids=lambda read: read.__name__)


def one_line_at_most(read: Read, path: Path) -> str:
    """What the reader says of the file; empty where it reads it."""
    said = ""
    try:
        read(path)
    except InputError as error:
        said = str(error)
    assert said.startswith(str(path)) or not said
    assert "\n" not in said
    assert len(said) < len(str(path)) + 300
    return said


@readers
def test_geojson_with_junk_anywhere(read: Read, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    feature = {"type": "Feature", "properties": {"type": "NVA", "id": 1}, "geometry": GEOMETRIES[read][0]}
    crs = {"type": "name", "properties": {"name": "EPSG:25832"}}
    document = {"type": "FeatureCollection", "crs": crs, "features": [feature]}
    path.write_text(json.dumps(document))
    assert one_line_at_most(read, path) == ""
    for changed in spoilt(document):
        path.write_text(json.dumps(changed))
        one_line_at_most(read, path)


@readers
@pytest.mark.parametrize(
    "content",
    ["[" * 200_000, '{"a":' * 100_000, '{"type":"FeatureCollection","features":[' + "[" * 100_000, "1" * 5000, "\0",
     '{"type": "FeatureCollection", "features": [{"geometry": {"coordinates": [' + "9" * 5000 + "]}}]}"],
    ids=["lists", "objects", "features", "number", "nothing", "digits"],
)  # fmt: skip
def test_geojson_that_is_none(read: Read, content: str, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    path.write_text(content)
    assert one_line_at_most(read, path)


def geopackage(path: Path, kind: str, blob: Any, *changes: str) -> Path:
    path.unlink(missing_ok=True)
    base = sqlite3.connect(path)
    base.executescript(
        "PRAGMA synchronous = OFF;"
        "CREATE TABLE gpkg_geometry_columns (table_name, column_name, geometry_type_name, srs_id);"
        "CREATE TABLE gpkg_spatial_ref_sys (srs_id, organization, organization_coordsys_id, definition);"
        "INSERT INTO gpkg_spatial_ref_sys VALUES (25832, 'EPSG', 25832, 'PROJCS[]');"
        f"INSERT INTO gpkg_geometry_columns VALUES ('t', 'geom', '{kind}', 25832);"
        "CREATE TABLE t (id INTEGER, z REAL, type TEXT, geom BLOB)"
    )
    base.execute("INSERT INTO t (id, geom) VALUES (1, ?)", (blob,))
    for change in changes:
        base.execute(change)
    base.commit()
    base.close()
    return path


def blob_of(geometry: bytes) -> bytes:
    return b"GP\0\1" + struct.pack("<i", 25832) + geometry


COLUMNS, SYSTEMS = "UPDATE gpkg_geometry_columns SET ", "UPDATE gpkg_spatial_ref_sys SET "


@readers
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("ALTER TABLE t RENAME COLUMN geom TO place", "layer t has no column 'geom', which should hold its"),
        (f"{COLUMNS} column_name = NULL", "layer t has no column None"),
        (f"{COLUMNS} column_name = x'ff'", r"layer t has no column b'\xff'"),
        (f"{COLUMNS} column_name = 'GEOM'", ""),
        (f"{COLUMNS} table_name = NULL", "no such table: None"),
        (f"{COLUMNS} table_name = 5", "no such table: 5"),
        (
            f"{COLUMNS} table_name = 'gpkg_geometry_columns', column_name = 'srs_id'",
            "has no GeoPackage geometry",
        ),
        (f"{COLUMNS} table_name = 'a\nb'", "no such table"),
        ("DROP TABLE t", "no such table: t"),
        ("DROP TABLE gpkg_spatial_ref_sys", "no such table: gpkg_spatial_ref_sys"),
        ("ALTER TABLE gpkg_spatial_ref_sys RENAME COLUMN organization TO q", "no such column: organization"),
        (f"{SYSTEMS} organization = cast(x'ff' AS TEXT)", ""),
        ("UPDATE t SET type = cast(x'ff80' AS TEXT)", None),
        ('ALTER TABLE t ADD COLUMN "x\ny"', ""),
    ],
)
def test_geopackage_without_what_it_should_have(
    read: Read, change: str, message: str | None, tmp_path: Path
) -> None:
    _, geometry, kind = GEOMETRIES[read]
    said = one_line_at_most(read, geopackage(tmp_path / "a.gpkg", kind, blob_of(geometry), change))
    if message is not None:
        assert message in said
        assert bool(message) == bool(said)


@readers
def test_geopackage_with_damaged_geometries(read: Read, tmp_path: Path) -> None:
    _, geometry, kind = GEOMETRIES[read]
    whole, path = blob_of(geometry), tmp_path / "a.gpkg"
    blobs: list[Any] = [None, b"", "text", 5, 1.5, *(whole[:n] for n in range(len(whole)))]
    for position in range(len(whole)):
        blobs += [whole[:position] + bytes([value]) + whole[position + 1 :] for value in (0, 3, 6, 127, 255)]
    for blob in random.Random(1).sample(blobs, 100):
        one_line_at_most(read, geopackage(path, kind, blob))


@readers
def test_geopackage_with_damaged_pages(read: Read, tmp_path: Path) -> None:
    chance, path = random.Random(2), tmp_path / "a.gpkg"
    whole = geopackage(path, GEOMETRIES[read][2], blob_of(GEOMETRIES[read][1])).read_bytes()
    for _ in range(400):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 6)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        path.write_bytes(data)
        one_line_at_most(read, path)


def test_tables_with_damaged_lines(tmp_path: Path) -> None:
    chance, path = random.Random(3), tmp_path / "a.csv"
    whole = b"x,y,z,type,cover,id\n1.5,2.5,3.5,NVA,grass,a\n4,5,6,VVA,,b\n"
    pieces = [b'"', b"\n", b'""', b",", b"\r", b";", b"\t", b"\0", b"\xff", b"\xe2\x80\xa8", b"\x1c", b"#"]
    for _ in range(800):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            place = chance.randrange(len(data))
            data[place : place + chance.randint(0, 1)] = chance.choice(pieces)
        path.write_bytes(data)
        one_line_at_most(read_checkpoints, path)


def write_feature(path: Path, geometry: dict[str, Any], crs: str) -> None:
    system = {"type": "name", "properties": {"name": crs}}
    path.write_text(
        json.dumps({"type": "FeatureCollection", "features": [{"geometry": geometry}], "crs": system})
    )


def use(read: Read, path: Path, dtm: Path) -> None:
    """What a command does with such a file."""
    if read is read_polygons:
        area_of(RunConfig(aoi=str(path)), pyproj.CRS(25832).to_wkt(), [])
    else:
        check_dtm(dtm, read_checkpoints(path), PointOptions())


STRANGE = ["\ud800", '{"a":' * 20_000, "x" * 100_000, "IAU_2015:30100", "EPSG:5773"]
"""Half a character, nesting, length, the Moon, heights alone."""


@pytest.mark.parametrize("crs", STRANGE, ids=["half", "nested", "long", "moon", "heights"])
def test_a_crs_that_is_none_or_leads_nowhere(crs: str, tmp_path: Path) -> None:
    dtm, path = write_surface(tmp_path / "dtm.tif", tilted), tmp_path / "a.geojson"
    for read, (geometry, _, _) in GEOMETRIES.items():
        write_feature(path, geometry, crs)
        with pytest.raises((InputError, ConfigError)) as caught:
            use(read, path, dtm)
        assert len(str(caught.value)) < 300


@pytest.mark.parametrize("far", [9e12, 1e18, 1e300])
def test_places_beyond_all_others(far: float, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    for geometry in (
        {"type": "Polygon", "coordinates": [[[0, 0], [far, 0], [far, far]]]},
        {"type": "Point", "coordinates": [0, 0, far]},
    ):
        write_feature(path, geometry, "EPSG:25832")
        read: Read = read_polygons if geometry["type"] == "Polygon" else read_checkpoints
        with pytest.raises(InputError, match=r"farther (away )?than 9e\+12"):
            use(read, path, tmp_path)
