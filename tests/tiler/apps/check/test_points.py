"""Checkpoints in all formats, and refusals."""

from __future__ import annotations

import gzip
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


@pytest.mark.parametrize(
    "head",
    [
        "E,N,H", "X;Y;Z;", " Easting , Northing , Elevation ", "Rechtswert;Hochwert;Höhe", "x   y z",
        "Longitude\tLatitude\tAlt", "//X,Y,Z", "POINT_X,POINT_Y,POINT_Z", "E [m],N [m],Height (m)",
    ],
)  # fmt: skip
def test_names_and_separators_of_columns(tmp_path: Path, head: str) -> None:
    separator = next(s for s in (";", "\t", ",", "  ") if s in head)
    row = separator.join((" 500000.5", "5400000.25 ", "312.5"))
    points = read_checkpoints(text(tmp_path / "p.csv", f"{head}\n{row}\n"))
    assert (points.xy.tolist(), points.z.tolist()) == ([[500000.5], [5400000.25]], [312.5])


@pytest.mark.parametrize(
    ("row", "order", "name", "kind"),
    [
        ("P1 500000 5400000.5 312", "name, x, y, z", "P1", "NVA"),
        ("7,500000,5400000.5,312.0", "name, x, y, z", "7", "NVA"),
        ("500000;5400000.5;312;VVA;grass", "x, y, z, type, cover", "1", "VVA"),
    ],
)
def test_orders_of_columns_without_a_header(
    tmp_path: Path, row: str, order: str, name: str, kind: str
) -> None:
    points = read_checkpoints(text(tmp_path / "p.csv", row + "\n"))
    assert (points.xy.tolist(), points.z.tolist()) == ([[500000], [5400000.5]], [312])
    assert (points.names, points.kinds) == ((name,), (kind,))
    assert points.notes[0] == f"p.csv has no header line: its columns are read as {order}"


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", "   ", " ; "])
def test_csv_without_a_header(tmp_path: Path, delimiter: str) -> None:
    points = read_checkpoints(text(tmp_path / "p.txt", delimiter.join(("1", "2", "3")) + "\n"))
    assert (points.xy.tolist(), points.z.tolist(), points.names) == ([[1], [2]], [3], ("1",))
    assert points.notes == (
        "p.txt has no header line: its columns are read as x, y, z",
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
    depth = write(tmp_path / f"r{suffix}", [shapely.Point(1, 2)], "Point", columns={"d": [7.5]})
    with pytest.raises(InputError, match=r"has no height \(attributes found: .*d.*; give"):
        read_checkpoints(depth)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("p.csv", "x,y,z\n1,2,high\n", r"line 2: z 'high' is not a number"),
        (
            "p.csv",
            "E,N,name\n1,2,a\n",
            r"p.csv: needs a column of heights \(columns found: E, N, name\); name one z, h, height or elevation$",
        ),
        (
            "p.csv",
            "a\n1\n",
            "needs a column of eastings and a column of northings and a column of h",
        ),
        ("p.csv", "x,y,z,Z\n1,2,3,4\n", "several columns of heights .* name only one z"),
        ("p.csv", "x,y,z\n1,2\n", "line 2: z is missing"),
        (
            "p.csv",
            "x,y,z\n500,000,5400,3\n",
            "line 2: has 4 values, but the table has 3 columns",
        ),
        ("p.csv", "id name x y z\na 1 2 3\n", "line 2: has 4 values, but the table has 5"),
        (
            "p.csv",
            "500000,5400000,312,1\n",
            r"no header line, and the order .* \(first values found: 500000, 5400000, 312, 1\); add",
        ),
        ("p.csv", "1.5,2.5\n", "no header line, and the order of its columns is not clear"),
        ("p.csv", "1,5;2,5;3,5\n", r"line 1: x '1,5' is not a number \(1234.5, with a point\)"),
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
            "line 3 .* table .unexpected end of data",
        ),
        (
            "p.csv",
            f"x,y,z\n1,2,{'9' * 200_000}\n",
            "line 2 .* table .field larger than field limit",
        ),
        ("p.csv", f"x,y,z\n1,2,{'9' * 400}\n", r"line 2: z '9+\.\.\. is not a number"),
        ("p.gpkg", "no data base", "does not begin as a .gpkg file does"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_checkpoints(text(tmp_path / name, content))


def test_tables_that_are_packed_or_too_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed, long = tmp_path / "packed.csv", tmp_path / "long.csv"
    packed.write_bytes(gzip.compress(b"x,y,z\n1,2,3\n"))
    with pytest.raises(InputError, match="packed.csv: is packed with gzip; unpack it"):
        read_checkpoints(packed)
    monkeypatch.setattr("tiler.apps.check.points.MAX_TABLE_BYTES", 1 << 20)
    long.write_bytes(b"x,y,z\n" + b"1,2,3\n" * (1 << 18))
    with pytest.raises(InputError, match="long.csv: has more than 1 MiB; divide it"):
        read_checkpoints(long)


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
    with pytest.raises(
        InputError, match="^https://host/x.csv: this file is not read from a URL"
    ):
        read_checkpoints(Path("https://host/x.csv"))
