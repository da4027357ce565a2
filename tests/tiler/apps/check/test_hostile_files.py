"""Damaged or malicious vector files give their content, or one line that names them, and nothing else."""

from __future__ import annotations

import contextlib
import json
import random
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyproj
import pytest
import shapely

from tests.tiler.apps.check.rasters import tilted, write_surface
from tests.tiler.io.vector.files import collection, write
from tests.tiler.junk import spoilt
from tiler.apps.check import PointOptions, check_dtm, read_checkpoints
from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.io.vector import POLYGONS, read_features
from tiler.plan.area import area_of
from tiler.schedule import ChildDiedError, ChildProcess

Read = Callable[[Path], Any]

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 0]]


def read_polygons(path: Path) -> Any:
    return read_features(path, POLYGONS)


GEOMETRIES: dict[Read, tuple[dict[str, Any], Any, str]] = {
    read_polygons: (
        {"type": "MultiPolygon", "coordinates": [[SQUARE]]},
        shapely.Polygon(SQUARE),
        "Polygon",
    ),
    read_checkpoints: (
        {"type": "Point", "coordinates": [0, 0, 5]},
        shapely.Point(1, 2, 3),
        "Point Z",
    ),
}
readers = pytest.mark.parametrize("read", GEOMETRIES, ids=lambda read: read.__name__)


def one_line_at_most(read: Read, path: Path) -> str:
    """The error line of the reader; empty if it reads the file."""
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
    feature = {
        "type": "Feature",
        "properties": {"type": "NVA", "id": 1},
        "geometry": GEOMETRIES[read][0],
    }
    crs = {"type": "name", "properties": {"name": "EPSG:25832"}}
    document = {**collection(), "crs": crs, "features": [feature]}
    path.write_text(json.dumps(document))
    assert one_line_at_most(read, path) == ""
    for changed in spoilt(document):
        path.write_text(json.dumps(changed))
        one_line_at_most(read, path)


@readers
@pytest.mark.parametrize(
    "content",
    [
        "[" * 200_000,
        '{"a":' * 100_000,
        '{"type":"FeatureCollection","features":[' + "[" * 100_000,
        "1" * 5000,
        "\0",
        '{"type": "FeatureCollection", "features": [{"geometry": {"coordinates": ['
        + "9" * 5000
        + "]}}]}",
    ],
    ids=["lists", "objects", "features", "number", "nothing", "digits"],
)
def test_invalid_geojson(read: Read, content: str, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    path.write_text(content)
    assert one_line_at_most(read, path)


@pytest.fixture
def package(read: Read, tmp_path: Path) -> Path:
    _, geometry, kind = GEOMETRIES[read]
    return write(tmp_path / "a.gpkg", [geometry], kind, columns={"z": [1.5], "type": ["NVA"]})


def change(path: Path, *changes: tuple[str, tuple[Any, ...]]) -> None:
    base = sqlite3.connect(path)
    for (name,) in base.execute(
        "SELECT name FROM sqlite_master WHERE type = 'trigger'"
    ).fetchall():
        base.execute(f'DROP TRIGGER "{name}"')  # they need functions of GDAL
    for statement, values in changes:
        base.execute(statement, values)
    base.commit()
    base.close()


COLUMNS, SYSTEMS = "UPDATE gpkg_geometry_columns SET ", "UPDATE gpkg_spatial_ref_sys SET "


@readers
@pytest.mark.parametrize(
    "statement",
    [
        "ALTER TABLE l0 RENAME COLUMN geom TO place",
        f"{COLUMNS} column_name = x'ff'",
        f"{COLUMNS} table_name = 'gpkg_geometry_columns', column_name = 'srs_id'",
        "UPDATE gpkg_contents SET table_name = 'a\nb'",
        "DROP TABLE l0",
        "DROP TABLE gpkg_spatial_ref_sys",
        "ALTER TABLE gpkg_spatial_ref_sys RENAME COLUMN organization TO q",
        f"{SYSTEMS} organization = cast(x'ff' AS TEXT)",
        f"{SYSTEMS} definition = 'PROJCS['",
        "UPDATE l0 SET type = cast(x'ff80' AS TEXT)",
        'ALTER TABLE l0 ADD COLUMN "x\ny"',
    ],
)
def test_geopackage_with_missing_parts(read: Read, statement: str, package: Path) -> None:
    with contextlib.suppress(sqlite3.Error):  # some SQLite checks its schema
        change(package, ("PRAGMA foreign_keys = OFF", ()), (statement, ()))
    one_line_at_most(read, package)


@readers
def test_geopackage_with_damaged_geometries(read: Read, package: Path) -> None:
    base = sqlite3.connect(package)
    (whole,) = base.execute("SELECT geom FROM l0").fetchone()
    base.close()
    blobs: list[Any] = [None, b"", "text", 5, 1.5, *(whole[:n] for n in range(len(whole)))]
    for position in range(len(whole)):
        blobs += [
            whole[:position] + bytes([value]) + whole[position + 1 :]
            for value in (0, 3, 6, 127, 255)
        ]
    for blob in random.Random(1).sample(blobs, 20):
        change(package, ("UPDATE l0 SET geom = ?", (blob,)))
        one_line_at_most(read, package)


@readers
def test_geopackage_with_damaged_pages(read: Read, package: Path) -> None:
    """A child reads the file, as in commands, because GDAL may crash or loop."""
    chance, whole = random.Random(2), package.read_bytes()
    with ChildProcess() as guard:
        for _ in range(20):
            data = bytearray(whole)
            for _ in range(chance.randint(1, 6)):
                data[chance.randrange(len(data))] = chance.randrange(256)
            package.write_bytes(data)
            said = ""
            with contextlib.suppress(ChildDiedError):
                said = guard.call(one_line_at_most, read, package, seconds=20)
            assert isinstance(said, str)


def test_tables_with_damaged_lines(tmp_path: Path) -> None:
    chance, path = random.Random(3), tmp_path / "a.csv"
    whole = b"x,y,z,type,cover,id\n1.5,2.5,3.5,NVA,grass,a\n4,5,6,VVA,,b\n"
    pieces = [
        b'"',
        b"\n",
        b'""',
        b",",
        b"\r",
        b";",
        b"\t",
        b"\0",
        b"\xff",
        b"\xe2\x80\xa8",
        b"\x1c",
        b"#",
    ]
    for _ in range(800):
        data = bytearray(whole)
        for _ in range(chance.randint(1, 4)):
            place = chance.randrange(len(data))
            data[place : place + chance.randint(0, 1)] = chance.choice(pieces)
        path.write_bytes(data)
        one_line_at_most(read_checkpoints, path)


def write_feature(path: Path, geometry: dict[str, Any], crs: str) -> None:
    content = collection(geometry) | {"crs": {"type": "name", "properties": {"name": crs}}}
    path.write_text(json.dumps(content))


def use(read: Read, path: Path, dtm: Path) -> None:
    """The use that a command makes of such a file."""
    if read is read_polygons:
        area_of(RunConfig(aoi=str(path)), pyproj.CRS(25832).to_wkt(), [])
    else:
        check_dtm(dtm, read_checkpoints(path), PointOptions())


STRANGE = ["\ud800", '{"a":' * 20_000, "x" * 100_000, "IAU_2015:30100", "EPSG:5773"]
"""Half a character, nesting, length, the Moon, heights alone."""


@pytest.mark.parametrize("crs", STRANGE, ids=["half", "nested", "long", "moon", "heights"])
def test_an_invalid_or_unusable_crs(crs: str, tmp_path: Path) -> None:
    dtm, path = write_surface(tmp_path / "dtm.tif", tilted), tmp_path / "a.geojson"
    for read, (geometry, _, _) in GEOMETRIES.items():
        write_feature(path, geometry, crs)
        with pytest.raises((InputError, ConfigError)) as caught:
            use(read, path, dtm)
        assert len(str(caught.value)) < 300


@pytest.mark.parametrize("far", [9e12, 1e18, 1e300])
def test_places_at_extreme_coordinates(far: float, tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    for geometry in (
        {"type": "Polygon", "coordinates": [[[0, 0], [far, 0], [far, far]]]},
        {"type": "Point", "coordinates": [0, 0, far]},
    ):
        write_feature(path, geometry, "EPSG:25832")
        read: Read = read_polygons if geometry["type"] == "Polygon" else read_checkpoints
        with pytest.raises(InputError, match=r"(farther than|beyond) 9e\+12"):
            use(read, path, tmp_path)
