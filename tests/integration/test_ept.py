"""Entwine point tiles (ept.json) as an input: whole, in windows, over HTTP; damaged ones are one line."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS

from tests.invariants import clouds
from tests.invariants.runs import do, dtm
from tests.scenes.ept_files import write_ept
from tests.tiler.servers import http_server
from tiler.apps.info import describe
from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.inputs import find_inputs, read_point_tiles
from tiler.plan import make_plan

SETTINGS = {"method": "classic", "halo": "8", "max_edge": "5"}
WINDOW = {**SETTINGS, "bounds": (500002.0, 5400002.0, 500012.0, 5400012.0)}


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> laspy.LasData:
    """A city of 60 m."""
    return laspy.read(
        clouds.write(tmp_path_factory.mktemp("city") / "city.laz", clouds.city(60.0, 2.0))
    )


@pytest.fixture(scope="module")
def ept(city: laspy.LasData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """It in nodes of at most 1,500 points."""
    return write_ept(tmp_path_factory.mktemp("ept") / "city", city, 1500)


def test_its_points_give_the_terrain_of_the_cloud(
    city: laspy.LasData, ept: Path, tmp_path: Path
) -> None:
    city.write(tmp_path / "city.laz")
    tiles = do(ept, tmp_path / "tiles", **SETTINGS)
    do(tmp_path / "city.laz", tmp_path / "cloud", **SETTINGS)
    assert tiles.summary["counts"]["read"] == len(city.points)
    np.testing.assert_array_equal(dtm(tmp_path / "tiles")[0], dtm(tmp_path / "cloud")[0])
    written = sorted(p.name for p in (tmp_path / "tiles/classified/ept-data").iterdir())
    assert written == sorted(p.name for p in (ept.parent / "ept-data").iterdir())
    for path in (tmp_path / "tiles/classified/ept-data").iterdir():
        assert laspy.read(path).header.parse_crs() == city.header.parse_crs()


def test_it_is_described_by_its_hierarchy(city: laspy.LasData, ept: Path) -> None:
    facts = describe(str(ept))
    assert (facts["kind"], facts["format"], facts["points"]) == (
        "cloud",
        "EPT",
        len(city.points),
    )
    assert facts["nodes"] == len(list((ept.parent / "ept-data").iterdir()))
    x0, y0, x1, y1 = facts["bounds"]
    assert x0 <= city.x.min() < city.x.max() <= x1
    assert y0 <= city.y.min() < city.y.max() <= y1
    assert "UTM zone 32N" in facts["crs"]
    assert facts["notes"] == []


def test_a_window_over_http_reads_the_nodes_near_it(
    ept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("aiohttp", reason="no http: aiohttp is not installed")
    do(ept, tmp_path / "whole", **WINDOW)
    monkeypatch.setattr("tiler.plan.area.NEAR_M", 0)
    with http_server(ept.parent.parent) as url:
        part = do([f"{url}/city/ept.json"], tmp_path / "part", **WINDOW)  # type: ignore[list-item]
    size = sum(path.stat().st_size for path in (ept.parent / "ept-data").iterdir())
    assert 0 < part.summary["fetched"]["points"] < size * 0.8
    np.testing.assert_array_equal(dtm(tmp_path / "part")[0], dtm(tmp_path / "whole")[0])
    with pytest.raises(ConfigError, match="no points near the requested area"):
        make_plan([str(ept)], RunConfig(in_process=True, bounds=(0.0, 0.0, 10.0, 10.0)))


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        (
            "ept.json",
            {"dataType": "binary"},
            "of the type 'binary', but only laszip can be read",
        ),
        ("ept.json", {"dataType": "laszip", "bounds": [0, 0, 0]}, "no cube"),
        ("ept.json", {"dataType": "laszip", "bounds": [0, 0, 0, 10**400, 1, 1]}, "no cube"),
        (
            "ept.json",
            {"dataType": "laszip", "bounds": [-1.7e308, 0, 0, 1.7e308, 1, 1]},
            "no cube",
        ),
        ("ept.json", "[]", "not a JSON object"),
        ("ept-hierarchy/0-0-0-0.json", {"0-0-0-0": 5, "1-7-0-0": 3}, "says '1-7-0-0: 3'"),
        ("ept-hierarchy/0-0-0-0.json", {"0-0-0-0": -1}, "has no number of points"),
        (
            "ept-hierarchy/0-0-0-0.json",
            {"0-0-0-0": 5, "2-0-0-0": -1},
            "2-0-0-0.json cannot be read",
        ),
        ("ept-hierarchy/0-0-0-0.json", {"0-0-0-0": 0}, "names no points"),
        ("ept-hierarchy/0-0-0-0.json", "{", "0-0-0-0.json: Expecting"),
    ],
)
def test_what_is_damaged_is_one_line(
    city: laspy.LasData, tmp_path: Path, file: str, content: object, reason: str
) -> None:
    path = write_ept(tmp_path / "ept", laspy.LasData(city.header, city.points[:10]), 100)
    (path.parent / file).write_text(
        content if isinstance(content, str) else json.dumps(content)
    )
    with pytest.raises(InputError) as refused:
        find_inputs([str(path)])
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_crs_of_half_a_character_is_none(city: laspy.LasData, tmp_path: Path) -> None:
    path = write_ept(tmp_path / "ept", city, 100_000, srs={"wkt": "\ud800"})
    assert read_point_tiles(str(path)).wkt is None


def told(path: Path, **changes: object) -> list[str]:
    """What the plan says of point tiles."""
    plan = make_plan([str(path)], RunConfig(in_process=True, method="keep", **changes))  # type: ignore[arg-type]
    return [note for note in plan.notes if note.startswith(str(path))]


SCHEMA = [
    {"name": axis, "type": "signed", "size": 4, "scale": 0.001, "offset": 0} for axis in "XYZ"
]


def test_what_is_true_is_not_told(ept: Path, city: laspy.LasData, tmp_path: Path) -> None:
    assert told(ept) == []
    assert told(write_ept(tmp_path / "ept", city, 1500, schema=SCHEMA)) == []


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"points": 7}, ("says 7 points, its hierarchy ",)),
        (
            {"bounds": [500000.0, 5400100.0, 0.0, 500060.0, 5400160.0, 60.0]},
            (
                "its bounds place the node in 500000 5400100 500060 5400160, but points lie in",
                "in 0-0-0-0.laz (",
            ),
        ),
        (
            {"schema": [{**entry, "scale": 0.01} for entry in SCHEMA]},
            (
                "its schema has scales (0.01, 0.01, 0.01), but they are (0.001, 0.001, 0.001) in 0-0-0-0.laz",
            ),
        ),
        (
            {"schema": [{"name": n} for n in ("X", "Red", "Green", "Blue")]},
            ("its schema has colours, but there are none in 0-0-0-0.laz",),
        ),
    ],
)
def test_what_the_files_do_not_say_is_told(
    changes: dict[str, object], parts: tuple[str, ...], city: laspy.LasData, tmp_path: Path
) -> None:
    (note,) = told(write_ept(tmp_path / "ept", city, 1500, **changes))
    for part in (*parts, "; the values in the files are used; create ept.json again"):
        assert part in note
    assert "\n" not in note


def test_a_node_of_other_points_and_another_crs_is_told(
    city: laspy.LasData, tmp_path: Path
) -> None:
    path = write_ept(tmp_path / "ept", city, 1500)
    node = path.parent / "ept-data/0-0-0-0.laz"
    las = laspy.read(node)
    las.points = las.points[:-5]
    las.header.add_crs(CRS("EPSG:32632"), keep_compatibility=False)
    las.write(node)
    (note,) = told(path)
    nodes = len(list(node.parent.iterdir()))
    count = len(las.points)
    line = f"its hierarchy lists {count + 5} points, but there are {count} in 0-0-0-0.laz (1 of {nodes} files)"
    assert line in note
    content = json.loads(path.read_text())
    content["srs"] = {"authority": "EPSG", "horizontal": "25833"}
    path.write_text(json.dumps(content))
    for other in node.parent.iterdir():
        las = laspy.read(other)
        las.header.add_crs(CRS("EPSG:32632"), keep_compatibility=False)
        las.write(other)
    notes = told(path)
    (srs,) = [note for note in notes if "srs" in note]
    assert (
        "its srs is ETRS89 / UTM zone 33N, but the CRS is WGS 84 / UTM zone 32N in 0-0-0-0.laz"
        in srs
    )
    assert len(told(path, bounds=(500002.0, 5400002.0, 500012.0, 5400012.0))) == 2, (
        "also of a part"
    )
