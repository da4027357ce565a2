"""Polygons of the formats that are read, and what is refused."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tiler.io.vector.files import collection, geopackage, polygon_wkb, shapefile
from tiler.errors import InputError
from tiler.io.vector import read_polygons

SQUARE = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0], [0.0, 0.0]]
HOLE = [[2.0, 2.0], [2.0, 3.0], [3.0, 3.0], [2.0, 2.0]]
FAR = [[20.0, 0.5], [30.0, 0.0], [25.0, 7.0], [20.0, 0.5]]


def plain(path: Path) -> tuple[list[list[list[list[float]]]], str | None]:
    found = read_polygons(path)
    return [[ring.tolist() for ring in rings] for rings in found.rings], found.crs


def test_geojson(tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    multi = {"type": "MultiPolygon", "coordinates": [[SQUARE, HOLE], [[[*p, 7.5] for p in FAR]]]}
    content = collection({"type": "Polygon", "coordinates": [FAR]}, multi, None)
    path.write_text(json.dumps(content))
    assert plain(path) == ([[FAR], [SQUARE, HOLE], [FAR]], "EPSG:4326")
    content["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    path.write_text(json.dumps(content))
    assert read_polygons(path).crs == "urn:ogc:def:crs:EPSG::25832"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("code", "dimensions"), [(3, 2), (1003, 3), (2003, 3), (3003, 4), (0x80000003, 3), (0xC0000003, 4)]
)
def test_geopackage(tmp_path: Path, order: str, code: int, dimensions: int) -> None:
    wide = [[[*p, 1.0, 2.0][:dimensions] for p in ring] for ring in (SQUARE, HOLE)]
    one = polygon_wkb(wide, order, code)
    multi = struct.pack(f"{order}BII", order == "<", code + 3, 2) + one + polygon_wkb([wide[1]], order, code)
    path = geopackage(tmp_path / "a.gpkg", [one, None, multi])
    assert plain(path) == ([[SQUARE, HOLE], [SQUARE, HOLE], [HOLE]], "EPSG:25832")


def test_geopackage_without_crs(tmp_path: Path) -> None:
    assert plain(geopackage(tmp_path / "a.gpkg", [polygon_wkb([SQUARE])], srs=-1)) == ([[SQUARE]], None)


@pytest.mark.parametrize("kind", [5, 15, 25])
def test_shapefile(tmp_path: Path, kind: int) -> None:
    path = shapefile(tmp_path / "a.shp", [[SQUARE, HOLE], None, [FAR]], kind)
    assert plain(path) == ([[SQUARE, HOLE], [FAR]], None)
    (tmp_path / "a.prj").write_text(' PROJCS["x"]\n')
    assert plain(path)[1] == 'PROJCS["x"]'


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.kml", "", r"polygons are read from .gpkg, .geojson, .json and .shp files; convert it"),
        ("a.geojson", "{", "not valid GeoJSON"),
        ("a.json", "[]", r"not valid GeoJSON \(holds no object\); write the polygons as features"),
        ("a.json", json.dumps(collection()), "holds no polygon"),
        ("a.json", json.dumps({"type": "FeatureCollection", "features": [7]}), "its features are no objects"),
        ("a.json", json.dumps(collection({"type": "Point", "coordinates": [1, 2]})),
         "feature 1: is a 'Point', not a Polygon"),
        ("a.json", json.dumps(collection({"type": "Polygon", "coordinates": [[[1, 2], [3, "x"], [5, 6]]]})),
         "feature 1: its coordinates are damaged"),
        ("a.json", json.dumps(collection({"type": "Polygon", "coordinates": [[[1, 2], [3, 4]]]})),
         "polygon 1 has a ring of fewer than 3 places"),
        ("a.json", json.dumps(collection({"type": "Polygon", "coordinates": [[[1, 2], [3, 4], [5, float("inf")]]]})),
         "or one that is no number"),
        ("a.gpkg", "no data base", "not a GeoPackage that can be read"),
        ("a.shp", "no shapefile, though long enough for the header", "is no shapefile"),
        ("a.shp", "short", "is damaged"),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message):
        read_polygons(tmp_path / name)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="no such file; name a GeoPackage, GeoJSON or Shapefile with polygons"
    ):
        read_polygons(tmp_path / "absent.gpkg")


@pytest.mark.parametrize(
    ("blob", "message"),
    [
        (struct.pack("<BI2d", 1, 1, 1.0, 2.0), r"feature 1: is no polygon \(type 1\)"),
        (struct.pack("<BII", 1, 3, 1000), "feature 1: its geometry is damaged"),
        (struct.pack("<BIII", 1, 3, 1, 4_000_000_000), "feature 1: its geometry is damaged"),
        (struct.pack("<BIIBII", 1, 6, 1, 1, 6, 0), "is no polygon"),
    ],
)
def test_what_is_refused_of_a_geopackage(tmp_path: Path, blob: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_polygons(geopackage(tmp_path / "a.gpkg", [blob]))
    with pytest.raises(InputError, match=r"needs one layer of polygons, has 2 \(l0, l1\)"):
        read_polygons(geopackage(tmp_path / "two.gpkg", [], layers=2))


def test_a_shapefile_of_anything_else(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no polygons \(shape type 3\)"):
        read_polygons(shapefile(tmp_path / "lines.shp", [], kind=3))
    whole = shapefile(tmp_path / "a.shp", [[SQUARE]]).read_bytes()
    rng = np.random.default_rng(3)
    for number in range(60):  # whatever is cut off or changed: an answer or one line
        damaged = bytearray(whole[: rng.integers(100, len(whole))] if number % 2 else whole)
        damaged[rng.integers(32, len(damaged))] ^= 1 << rng.integers(8)
        (tmp_path / "b.shp").write_bytes(damaged)
        outcome: Any = None
        try:
            outcome = read_polygons(tmp_path / "b.shp")
        except InputError as error:
            outcome = error
        assert outcome is not None
