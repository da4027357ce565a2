"""Checkpoints in all formats, and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pyproj
import pytest
import shapely

from tests.tiler.io.vector.files import write
from tiler.apps.check import read_checkpoints
from tiler.errors import InputError


def text(path: Path, content: str) -> Path:
    path.write_text(content, encoding="utf-8")
    return path


def test_csv_with_a_heading(tmp_path: Path) -> None:
    head = "\ufeff# surveyed\nID;Northing;Easting;Height;Type;Land_Cover\n"
    rows = "a;20;10;5.5;nva;asphalt\n\nb;21;11;6.5;VVA;tall grass\n"
    points = read_checkpoints(text(tmp_path / "p.csv", head + rows))
    assert points.xy.tolist() == [[10, 11], [20, 21]]
    assert points.z.tolist() == [5.5, 6.5]
    assert (points.kinds, points.covers) == (("NVA", "VVA"), ("asphalt", "tall grass"))
    assert points.names == ("a", "b")
    assert (points.crs, points.notes, points.has_types) == (None, (), True)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_csv_without_a_heading(tmp_path: Path, delimiter: str) -> None:
    points = read_checkpoints(text(tmp_path / "p.txt", delimiter.join(("1", "2", "3")) + "\n"))
    assert (points.xy.tolist(), points.z.tolist(), points.names) == ([[1], [2]], [3], ("1",))
    assert points.notes == (
        "no column contains NVA or VVA: all checkpoints are assumed to be non-vegetated (NVA)",
    )
    assert not points.has_types


def test_checkpoints_without_a_type_among_others_are_counted(tmp_path: Path) -> None:
    points = read_checkpoints(text(tmp_path / "p.csv", "x,y,z,type\n1,2,3,VVA\n4,5,6,\n"))
    assert points.kinds == ("VVA", "NVA")
    assert points.notes == ("1 checkpoint without a type assumed to be non-vegetated (NVA)",)
    assert not points.has_types


def feature(coordinates: list[float], **properties: object) -> dict[str, object]:
    geometry = {"type": "Point", "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def test_geojson(tmp_path: Path) -> None:
    content = {
        "type": "FeatureCollection",
        "features": [
            feature([9.0, 48.0, 7.25], Type="VVA", name="t1"),
            feature([9.1, 48.1], Height=8),
        ],
    }
    points = read_checkpoints(text(tmp_path / "p.geojson", json.dumps(content)))
    assert (points.xy.tolist(), points.z.tolist()) == ([[9.0, 9.1], [48.0, 48.1]], [7.25, 8])
    assert (points.kinds, points.names, points.crs) == (
        ("VVA", "NVA"),
        ("t1", "2"),
        "EPSG:4979",
    )
    content["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    assert read_checkpoints(text(tmp_path / "q.json", json.dumps(content))).crs == "EPSG:25832"


@pytest.mark.parametrize("suffix", [".gpkg", ".shp"])
def test_geometries_of_other_formats(suffix: str, tmp_path: Path) -> None:
    places = [shapely.Point(1, 2, 3), shapely.Point(4, 5, 6)]
    path = write(tmp_path / f"p{suffix}", places, "Point Z", columns={"cover": ["gravel"] * 2})
    points = read_checkpoints(path)
    assert (points.xy.tolist(), points.z.tolist()) == ([[1, 4], [2, 5]], [3, 6])
    assert (points.covers, points.names) == (("gravel", "gravel"), ("1", "2"))
    assert points.crs is not None
    assert pyproj.CRS(points.crs).to_epsg() == 25832
    flat = write(
        tmp_path / f"q{suffix}", [shapely.Point(1, 2)], "Point", columns={"Elev": [7.5]}
    )
    assert read_checkpoints(flat).z.tolist() == [7.5]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("p.csv", "x,y,z\n1,2,high\n", r"line 2: z 'high' is not a number"),
        ("p.csv", "x,y\n1,2\n", r"line 2: z is missing"),
        (
            "p.csv",
            "x;y;z\n1;2;3,5\n",
            r"line 2: z '3,5' is not a number \(1234.5, with a point\)",
        ),
        ("p.csv", "x,y,z\n1,2,inf\n", r"line 2: z 'inf' is not a number"),
        (
            "p.csv",
            "x,y,z,type\n1,2,3,forest\n",
            r"type 'forest' is neither NVA nor VVA; give land cover",
        ),
        ("p.csv", "x,y,z\n", "holds no checkpoint"),
        ("p.csv", "", "holds no checkpoint"),
        ("p.shp", "", r"does not begin as a .shp file does"),
        ("p.geojson", "{", "not valid GeoJSON"),
        ("p.geojson", "[]", r"not valid GeoJSON \(not a JSON object\)"),
        ("p.geojson", "{}", "not a GeoJSON FeatureCollection"),
        (
            "p.csv",
            "x,y,z,id\n1,2,3,'a'\n1,2,3,\"b\n4,5,6,c\n",
            "line 3: .* table .unexpected end of data",
        ),
        (
            "p.csv",
            f"x,y,z\n1,2,{'9' * 200_000}\n",
            "line 2: .* table .field larger than field limit",
        ),
        ("p.csv", f"x,y,z\n1,2,{'9' * 400}\n", r"line 2: z '9+\.\.\. is not a number"),
        ("p.gpkg", "no data base", "does not begin as a .gpkg file does"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_checkpoints(text(tmp_path / name, content))


def test_unfit_geopackages_are_refused(tmp_path: Path) -> None:
    square = write(tmp_path / "a.gpkg", [shapely.box(0, 0, 1, 1)])
    with pytest.raises(InputError, match="l0, feature 1 is a Polygon; checkpoints are needed"):
        read_checkpoints(square)
    write(square, [shapely.Point(1, 2, 3)], "Point Z", layer="l1")
    with pytest.raises(
        InputError, match=r"needs one layer of checkpoints, has 2 \(l0 \(Unknown\), l1 \("
    ):
        read_checkpoints(square)
    with pytest.raises(InputError, match="no such file"):
        read_checkpoints(tmp_path / "absent.csv")
