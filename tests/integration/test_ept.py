"""Entwine point tiles (ept.json) as an input: whole, in windows, over HTTP; damaged ones are one line."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.runs import do, dtm
from tests.scenes.ept_files import write_ept
from tests.tiler.servers import http_server
from tiler.apps.info import describe
from tiler.config import RunConfig
from tiler.errors import ConfigError, InputError
from tiler.ingest import find_inputs, read_point_tiles
from tiler.plan import make_plan, tiles_of_points

SETTINGS = {"method": "classic", "halo": "8", "max_edge": "5"}
WINDOW = {**SETTINGS, "bounds": (500002.0, 5400002.0, 500012.0, 5400012.0)}


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> laspy.LasData:
    """A city of 60 m."""
    return laspy.read(clouds.write(tmp_path_factory.mktemp("city") / "city.laz", clouds.city(60.0, 2.0)))


@pytest.fixture(scope="module")
def ept(city: laspy.LasData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """It in nodes of at most 1,500 points."""
    return write_ept(tmp_path_factory.mktemp("ept") / "city", city, 1500)


def test_its_points_give_the_terrain_of_the_cloud(city: laspy.LasData, ept: Path, tmp_path: Path) -> None:
    city.write(tmp_path / "city.laz")
    tiles = do(ept, tmp_path / "tiles", **SETTINGS)
    do(tmp_path / "city.laz", tmp_path / "cloud", **SETTINGS)
    assert tiles.summary["counts"]["read"] == len(city.points)
    np.testing.assert_array_equal(dtm(tmp_path / "tiles")[0], dtm(tmp_path / "cloud")[0])
    written = sorted(p.name for p in (tmp_path / "tiles/classified/ept-data").iterdir())
    assert written == sorted(p.name for p in (ept.parent / "ept-data").iterdir())


def test_it_is_described_by_its_hierarchy(city: laspy.LasData, ept: Path) -> None:
    facts = describe(str(ept))
    assert (facts["kind"], facts["format"], facts["points"]) == ("cloud", "EPT", len(city.points))
    assert facts["nodes"] == len(list((ept.parent / "ept-data").iterdir()))
    x0, y0, x1, y1 = facts["bounds"]
    assert x0 <= city.x.min() < city.x.max() <= x1
    assert y0 <= city.y.min() < city.y.max() <= y1
    assert "UTM zone 32N" in facts["crs"]


def test_a_window_over_http_reads_the_nodes_near_it(
    ept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("aiohttp", reason="no http: aiohttp is not installed")
    do(ept, tmp_path / "whole", **WINDOW)
    monkeypatch.setattr(tiles_of_points, "NEAR_M", 0)
    with http_server(ept.parent.parent) as url:
        part = do([f"{url}/city/ept.json"], tmp_path / "part", **WINDOW)  # type: ignore[list-item]
    size = sum(path.stat().st_size for path in (ept.parent / "ept-data").iterdir())
    assert 0 < part.summary["fetched"]["points"] < size * 0.8
    np.testing.assert_array_equal(dtm(tmp_path / "part")[0], dtm(tmp_path / "whole")[0])
    with pytest.raises(ConfigError, match="no points near the area"):
        make_plan([str(ept)], RunConfig(in_process=True, bounds=(0.0, 0.0, 10.0, 10.0)))


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("ept.json", {"dataType": "binary"}, "of the type 'binary', laszip can be read"),
        ("ept.json", {"dataType": "laszip", "bounds": [0, 0, 0]}, "no cube"),
        ("ept.json", {"dataType": "laszip", "bounds": [0, 0, 0, 10**400, 1, 1]}, "no cube"),
        ("ept.json", {"dataType": "laszip", "bounds": [-1.7e308, 0, 0, 1.7e308, 1, 1]}, "no cube"),
        ("ept.json", "[]", "holds no object"),
        ("ept-hierarchy/0-0-0-0.json", {"0-0-0-0": 5, "1-7-0-0": 3}, "says '1-7-0-0: 3'"),
        ("ept-hierarchy/0-0-0-0.json", {"0-0-0-0": -1}, "does not say how many"),
        ("ept-hierarchy/0-0-0-0.json", {"0-0-0-0": 5, "2-0-0-0": -1}, "2-0-0-0.json cannot be read"),
        ("ept-hierarchy/0-0-0-0.json", {"0-0-0-0": 0}, "names no points"),
        ("ept-hierarchy/0-0-0-0.json", "{", "0-0-0-0.json: Expecting"),
    ],
)
def test_what_is_damaged_is_one_line(
    city: laspy.LasData, tmp_path: Path, file: str, content: object, reason: str
) -> None:
    city.points = city.points[:10]
    path = write_ept(tmp_path / "ept", city, 100)
    (path.parent / file).write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(InputError) as refused:
        find_inputs([str(path)])
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_crs_of_half_a_character_is_none(city: laspy.LasData, tmp_path: Path) -> None:
    path = write_ept(tmp_path / "ept", city, 100_000, srs={"wkt": "\ud800"})
    assert read_point_tiles(str(path)).wkt is None
