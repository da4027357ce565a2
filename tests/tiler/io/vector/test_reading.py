"""Features of each format, their CRS, and files that are refused."""

from __future__ import annotations

import contextlib
import gzip
import hashlib
import itertools
import json
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyproj
import pytest
import shapely

from tests.scenes import journals
from tests.tiler.io.vector.files import collection, write
from tests.waiting import PATIENCE_SECONDS
from tiler.errors import InputError
from tiler.io.vector import (
    LINES,
    LINES_AND_POLYGONS,
    POLYGONS,
    geopackage,
    read_features,
    read_in_crs,
    warn_outside,
)

SQUARE = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0], [0.0, 0.0]]
HOLE = [[2.0, 2.0], [2.0, 3.0], [3.0, 3.0], [2.0, 2.0]]
FAR = [[20.0, 0.5], [30.0, 0.0], [25.0, 7.0], [20.0, 0.5]]
HOLED, TRIANGLE = shapely.Polygon(SQUARE, [HOLE]), shapely.Polygon(FAR)
BOTH = shapely.MultiPolygon([HOLED, TRIANGLE])
WALL = shapely.LineString([[1, 2, 3], [4, 5, 6]])
UTM = pyproj.CRS(25832).to_wkt()


def test_geojson(tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    multi = {
        "type": "MultiPolygon",
        "coordinates": [[SQUARE, HOLE], [[[*p, 7.5] for p in FAR]]],
    }
    content = collection({"type": "Polygon", "coordinates": [FAR]}, multi, None)
    path.write_text(json.dumps(content))
    found = read_features(path, POLYGONS)
    assert found.crs == "EPSG:4326"
    assert shapely.equals([f.geometry for f in found.features], [TRIANGLE, BOTH]).all()
    content["crs"] = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    path.write_text(json.dumps(content))
    assert read_features(path, POLYGONS).crs == "EPSG:25832"


@pytest.mark.parametrize("suffix", [".gpkg", ".shp", ".fgb"])
def test_other_formats(suffix: str, tmp_path: Path) -> None:
    """Geometry, attributes and CRS; features without a geometry are left out, and a missing CRS is noted."""
    columns = {"Action": ["void", "flat", "none"], "z": [1.5, np.nan, 2.0]}
    number = 2 if suffix == ".fgb" else 3  # FlatGeobuf has no features without a geometry
    columns = {name: values[:number] for name, values in columns.items()}
    kind = {".gpkg": "MultiPolygon", ".fgb": "Unknown", ".shp": "Polygon"}[suffix]
    path = write(tmp_path / f"a{suffix}", [HOLED, BOTH, None][:number], kind, columns=columns)
    found = read_features(path, POLYGONS)
    assert (
        pyproj.CRS(found.crs) == pyproj.CRS(25832) or pyproj.CRS(found.crs).to_epsg() == 25832
    )
    by_action = {f.attributes["action"]: f for f in found.features}  # FlatGeobuf sorts by place
    assert shapely.equals(by_action["void"].geometry, HOLED)
    assert shapely.equals(by_action["flat"].geometry, BOTH)
    assert (by_action["void"].height(), by_action["flat"].height(), len(by_action)) == (
        1.5,
        None,
        2,
    )
    assert (
        read_features(
            write(tmp_path / f"b{suffix}", [HOLED], "Polygon", crs=None), POLYGONS
        ).crs
        is None
    )


def test_polygons_are_repaired_and_features_outside_are_reported(tmp_path: Path) -> None:
    bow = shapely.Polygon([[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]])
    found = read_in_crs(
        path := write(tmp_path / "a.gpkg", [bow, TRIANGLE], "Polygon"), POLYGONS, UTM
    )
    assert found.notes == (f"{path}: 1 of 2 polygons crossed themselves and were repaired",)
    assert shapely.area(found.features[0].geometry) == 50
    assert shapely.equals_exact(found.features[1].geometry, TRIANGLE)
    assert warn_outside(path, found, (-1, -1, 15, 15)) == [
        f"{path}: 1 of 2 features lie outside the survey and have no effect, the first is l0, feature 2"
    ]
    assert warn_outside(path, found, (-1, -1, 25, 15)) == []


def test_heights_of_lines(tmp_path: Path) -> None:
    flat = shapely.force_2d(WALL)
    path = write(
        tmp_path / "a.gpkg", [WALL, flat], "LineString Z", columns={"Elev": [9.0, 7.0]}
    )
    heights = [
        shapely.get_coordinates(f.geometry, include_z=True)[:, 2].tolist()
        for f in read_in_crs(path, LINES, UTM, needs_z=True).features
    ]
    assert heights[0] == [3, 6]
    moved = read_in_crs(path, LINES, pyproj.CRS(25833).to_wkt(), needs_z=True)
    assert shapely.get_coordinates(moved.features[0].geometry, include_z=True)[
        :, 2
    ].tolist() == [3, 6]
    with pytest.raises(
        InputError, match="b.gpkg: l0, feature 1: has no heights; draw it in 3D"
    ):
        read_in_crs(write(tmp_path / "b.gpkg", [flat], "LineString"), LINES, UTM, needs_z=True)


def test_several_layers(tmp_path: Path) -> None:
    path = write(tmp_path / "a.gpkg", [TRIANGLE], "Polygon")
    write(path, [WALL], "LineString Z", layer="flow")
    assert len(read_features(path, LINES).features) == 1
    both = read_features(path, LINES_AND_POLYGONS, every_layer=True).features
    assert [f.place for f in both] == [f"{path}: l0, feature 1", f"{path}: flow, feature 1"]
    with pytest.raises(
        InputError,
        match=r"needs one layer of lines or polygons, has 2 \(l0 \(Polygon\), flow \(",
    ):
        read_features(path, LINES_AND_POLYGONS)


def polygon(*places: list[object]) -> str:
    return json.dumps(collection({"type": "Polygon", "coordinates": [places]}))


POINT = {"type": "Point", "coordinates": [1, 2]}
ODD_CRS = {**json.loads(polygon(*SQUARE)), "crs": {"properties": {"name": "no CRS"}}}
LINK = {"type": "link", "properties": {"href": "https://example.org/25832"}}
LINKED_CRS = {**ODD_CRS, "crs": LINK}
CODED_CRS = {**ODD_CRS, "crs": {"type": "EPSG", "properties": {"code": 25832}}}
VRT = "<OGRVRTDataSource><OGRVRTLayer name='a'><SrcDataSource>b.json</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "a.kml",
            "",
            r"polygons are read from .gpkg, .geojson, .json, .shp and .fgb files; convert it",
        ),
        ("a.geojson", "{", "not valid GeoJSON"),
        (
            "a.json",
            "[]",
            r"not valid GeoJSON \(not a JSON object\); write polygons as features",
        ),
        ("a.json", json.dumps(collection()), "contains no polygons"),
        (
            "a.json",
            json.dumps({**collection(), "features": [7]}),
            "feature 1 is not a GeoJSON Feature",
        ),
        ("a.json", json.dumps(collection(POINT)), r"has 0 \(a \(Point\)\)"),
        ("a.json", polygon([1, 2], [3, "x"], [5, 6]), "feature 1: its geometry is damaged"),
        ("a.json", polygon([1, 2], [3, 4]), "feature 1: has no area; draw it wider"),
        (
            "a.json",
            polygon([1, 2], [3, 4], [5, float("inf")], [1, 2]),
            "damaged|that is not a number",
        ),
        ("a.json", json.dumps(ODD_CRS), "its CRS 'no CRS' is not known"),
        (
            "a.json",
            json.dumps(LINKED_CRS),
            r"its CRS has no name \(.*'type': 'link'.*\), and links",
        ),
        (
            "a.json",
            json.dumps(CODED_CRS),
            "its CRS has no name .*; name it with `ogr2ogr -a_srs EPSG",
        ),
        ("a.gpkg", "no data base", "does not begin as a .gpkg file does"),
        ("a.gpkg", VRT, "does not begin as a .gpkg file does"),
        ("a.shp", "short", "does not begin as a .shp file does"),
        ("a!b.json", polygon(*SQUARE), "rename it"),
    ],
)
def test_wrong_vector_files_are_refused(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_in_crs(tmp_path / name, POLYGONS, pyproj.CRS(4326).to_wkt())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.geojson", "a.geojson.gz", "a.gpkg"])
def test_packed_files_are_named_and_not_unpacked(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(gzip.compress(bytes(1 << 20)))
    with pytest.raises(
        InputError, match=f"{name}: is packed with gzip; unpack it and give the"
    ):
        read_features(tmp_path / name, POLYGONS)


def test_files_that_are_not_whole(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="no such file; give a GeoPackage, GeoJSON or Shapefile with polygons"
    ):
        read_features(tmp_path / "absent.gpkg", POLYGONS)
    path = write(tmp_path / "a.shp", [TRIANGLE], "Polygon")
    path.with_suffix(".shx").unlink()
    with pytest.raises(InputError, match=r"a.shp: cannot be read \(Unable to open .*a.shx"):
        read_features(path, POLYGONS)
    path = write(tmp_path / "b.gpkg", [TRIANGLE, TRIANGLE], "Polygon")
    with sqlite3.connect(path) as base:  # drop its triggers, which need SQL functions of GDAL
        for (name,) in base.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        ).fetchall():
            base.execute(f'DROP TRIGGER "{name}"')
        base.execute("UPDATE l0 SET geom = substr(geom, 1, 60) WHERE fid = 2")
    base.close()
    found = read_features(path, POLYGONS)
    left = "1 features without a geometry, or with a damaged one, are left out"
    assert (len(found.features), found.notes) == (1, (f"{path}: l0: {left}",))


def test_written_features_are_read_back_and_have_the_same_bytes(tmp_path: Path) -> None:
    path, digests = tmp_path / "a.gpkg", set()
    for _ in range(2):
        with geopackage(path, "EPSG:25832+5783") as file:
            for row in range(2):
                columns = {"elevation": np.array([row + 0.5]), "name": np.array(["x"], object)}
                file.add("contours", "LineString Z", [WALL], columns)
            assert path.exists() == bool(digests)
        digests.add(hashlib.sha256(path.read_bytes()).hexdigest())
        with sqlite3.connect(path) as base:
            times = base.execute("SELECT last_change FROM gpkg_contents").fetchall()
            version = base.execute("PRAGMA user_version").fetchone()
        base.close()
        assert times == [("2000-01-01T00:00:00.000Z",)]
        assert version == (10200,), "GDAL of QGIS 3.22 warns of newer ones"
    assert len(digests) == 1
    found = read_features(path, LINES)
    assert found.crs == "EPSG:25832"
    assert [f.attributes for f in found.features] == [
        {"elevation": z, "name": "x"} for z in (0.5, 1.5)
    ]
    assert [p.name for p in tmp_path.iterdir()] == ["a.gpkg"]
    with contextlib.suppress(ZeroDivisionError), geopackage(path, None) as file:
        file.add("other", "LineString", [WALL], {})
        raise ZeroDivisionError
    assert hashlib.sha256(path.read_bytes()).hexdigest() in digests


def files(folder: Path) -> dict[str, tuple[bytes, int]]:
    return {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in folder.iterdir()}


def test_saved_edits_in_a_journal_are_read_and_no_file_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite would write the journal of a crashed program into the file, and remove the journal."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    path = write(tmp_path / "a.gpkg", [TRIANGLE], "Polygon", columns={"action": ["void"]})
    with contextlib.closing(journals.opened_in_gis(path)):
        left = journals.crashed(path, tmp_path / "crashed")
        link = tmp_path / "link.gpkg"
        link.symlink_to(left)
        before = files(left.parent)
        for name in (left, link, path):
            features = read_features(name, POLYGONS).features
            assert [f.attributes["action"] for f in features] == ["void", "void"]
            assert features[1].place == f"{name}: l0, feature 2"
        assert files(left.parent) == before
    assert set(before) == {"a.gpkg", "a.gpkg-wal"}
    assert not list(scratch.iterdir())


def test_unfinished_changes_are_not_read(tmp_path: Path) -> None:
    path = write(tmp_path / "a.gpkg", [TRIANGLE], "Polygon")
    with contextlib.closing(journals.in_transaction(path)):
        left = journals.crashed(path, tmp_path / "crashed")
        before = files(left.parent)
        assert set(before) == {"a.gpkg", "a.gpkg-journal"}
        for name in (left, path):
            assert len(read_features(name, POLYGONS).features) == 1
        assert files(left.parent) == before


def test_a_file_that_keeps_changing_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "a.gpkg", [TRIANGLE], "Polygon")
    with contextlib.closing(journals.opened_in_gis(path)):
        states = itertools.count()
        monkeypatch.setattr(
            "tiler.io.vector.opening.states_at", lambda places: [next(states) for _ in places]
        )
        with pytest.raises(
            InputError, match=r"a\.gpkg: a program keeps writing to it; close it"
        ):
            read_features(path, POLYGONS)


@pytest.mark.processes
def test_two_gdals_in_one_process(tmp_path: Path) -> None:
    """rasterio and pyogrio each bring a GDAL and a PROJ; both orders of import give equal results without a warning."""
    write(tmp_path / "a.gpkg", [shapely.Point(500_000, 5_400_000)], "Point")
    lines = (
        "import rasterio, rasterio.warp, numpy\n"
        "r = lambda: rasterio.warp.transform('EPSG:25832', 'EPSG:4326', [5e5], [54e5])",
        "import pyogrio.raw; p = lambda: pyogrio.raw.read('a.gpkg')[0]['crs']",
    )
    for order in (lines, lines[::-1]):
        script = "\n".join([*order, "print(p(), *numpy.round(r(), 4).ravel(), p())"])
        command = [sys.executable, "-W", "error", "-c", script]
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_SECONDS
        )
        assert (done.stdout.split(), done.stderr) == (
            ["EPSG:25832", "9.0", "48.753", "EPSG:25832"],
            "",
        )
