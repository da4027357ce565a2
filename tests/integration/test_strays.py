"""One stray point must not make a run for an area without points; an island far away is data, in any file."""

from __future__ import annotations

import json
from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import CORNER, Cloud
from tests.invariants.runs import assert_same_terrain, classes_by_point, do, the_store

HERE = 160.0


@pytest.fixture(scope="module")
def city() -> Cloud:
    return clouds.city(HERE, 1.0)


@pytest.fixture(scope="module")
def alone(city: Cloud, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("alone")
    do(clouds.write(folder / "in.laz", city), folder / "out")
    return folder / "out"


def moved(cloud: Cloud, *offset: float) -> Cloud:
    return Cloud(cloud.xyz + offset, cloud.truth)


def together(*parts: Cloud) -> Cloud:
    return Cloud(
        np.concatenate([p.xyz for p in parts]), np.concatenate([p.truth for p in parts])
    )


@pytest.mark.parametrize("away_m", [3_000.0, 400_000.0])
def test_a_stray_point_is_written_back_and_listed(
    away_m: float, city: Cloud, alone: Path, tmp_path: Path
) -> None:
    stray = moved(city.take(np.arange(len(city.xyz)) < 1), away_m, -away_m, 50.0)
    middle = len(city.xyz) // 3  # not where a sample would find it
    parts = (
        city.take(np.arange(len(city.xyz)) < middle),
        city.take(np.arange(len(city.xyz)) >= middle),
    )
    path = clouds.write(tmp_path / "in.laz", together(parts[0], stray, parts[1]))
    result = do(path, tmp_path / "out")
    assert result.exit_code == 0
    (listed,) = result.summary["strays"]
    assert (listed["path"], listed["point"]) == (path.as_posix(), middle)
    found = [listed[axis] for axis in "xyz"]
    np.testing.assert_allclose(found, stray.xyz[0] + (*CORNER, 0.0), atol=0.01)
    assert result.summary["counts"]["strays"] == 1
    assert result.summary["counts"]["stored"] == len(city.xyz) + 1
    before, after = laspy.read(path), laspy.read(tmp_path / "out" / "classified" / "in.laz")
    assert after.classification[middle] == before.classification[middle]
    assert_same_terrain(tmp_path / "out", alone)
    others = np.arange(len(before)) != middle
    truth = laspy.read(alone / "classified" / "in.laz").classification
    assert np.array_equal(np.asarray(after.classification)[others], np.asarray(truth))
    assert "far from all others" in (tmp_path / "out" / "events.jsonl").read_text()


@pytest.mark.parametrize(
    "cut", ["a file of its own", "in both files", "as far as the other file"]
)
def test_strays_of_a_cut_cloud_are_those_of_the_uncut_one(
    cut: str, city: Cloud, alone: Path, tmp_path: Path
) -> None:
    """Points in two files count once. Points near another file are no strays, however far from their own."""
    stray = moved(city.take(np.arange(len(city.xyz)) < 6), 3_000.0, 0.0, 0.0)
    west = city.xyz[:, 0] < np.median(city.xyz[:, 0])
    parts = {
        "a file of its own": (city, stray),
        "in both files": (together(city.take(west), stray), together(city.take(~west), stray)),
        "as far as the other file": (together(city, stray), moved(city, 3_000.0, 200.0, 0.0)),
    }[cut]
    paths = [clouds.write(tmp_path / f"{i}.laz", part) for i, part in enumerate(parts)]
    result = do(paths, tmp_path / "out")
    if cut == "as far as the other file":
        assert result.summary["strays"] == []
        return
    assert len({(s["x"], s["y"], s["z"]) for s in result.summary["strays"]}) == 6
    assert_same_terrain(tmp_path / "out", alone)


def test_a_point_outside_of_the_bounds_of_a_header_is_a_stray(
    city: Cloud, tmp_path: Path
) -> None:
    first = np.arange(len(city.xyz)) < 4000
    stray = moved(city.take(np.arange(len(city.xyz)) < 1), -300.0, 0.0, 0.0)
    path = clouds.write(
        tmp_path / "in.las", together(city.take(first), stray, city.take(~first))
    )
    x, y = (city.xyz[:, axis] + CORNER[axis] for axis in (0, 1))
    data = bytearray(path.read_bytes())
    data[179:211] = np.array([x.max(), x.min(), y.max(), y.min()]).tobytes()
    path.write_bytes(data)
    result = do(path, tmp_path / "out", until="ingest")
    assert [s["point"] for s in result.summary["strays"]] == [4000]


@pytest.mark.parametrize("in_one_file", [True, False])
def test_an_island_far_away_is_data(in_one_file: bool, city: Cloud, tmp_path: Path) -> None:
    island = moved(
        city.take(city.xyz[:, 0] < city.xyz[:, 0].min() + 60), 12_000.0, 9_000.0, 0.0
    )
    if in_one_file:
        paths = [clouds.write(tmp_path / "in.laz", together(city, island))]
    else:
        paths = [
            clouds.write(tmp_path / "a.laz", city),
            clouds.write(tmp_path / "b.laz", island),
        ]
    result = do(paths, tmp_path / "out", until="filter")
    assert result.summary["strays"] == []
    assert result.summary["counts"]["participating"] > 0.99 * (len(city.xyz) + len(island.xyz))
    bounds = [
        b
        for _, r in the_store(tmp_path / "out").committed("assemble").values()
        for b in r["buckets"]
    ]
    assert (
        max(b["bounds"][2] for b in bounds) - min(b["bounds"][0] for b in bounds) > 12_000_000
    )


SHAPES = {
    "one point": lambda n: np.zeros((1, 3)),
    "two points": lambda n: np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    "one spot": lambda n: np.zeros((n, 3)),
    "a pile": lambda n: np.stack([np.zeros(n), np.zeros(n), np.arange(n) / 100], axis=1),
    "a line east": lambda n: np.stack([np.arange(n) / 10, np.zeros(n), np.zeros(n)], axis=1),
    "a slanted line": lambda n: np.stack(
        [np.arange(n) / 10, np.arange(n) / 10, np.arange(n) / 50], axis=1
    ),
    "each twice": lambda n: np.tile(
        np.random.default_rng(1).uniform(0, 30, (n // 2, 3)).round(2), (2, 1)
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_degenerate_clouds_end_well(shape: str, tmp_path: Path) -> None:
    xyz = SHAPES[shape](2000) + (0.0, 0.0, 100.0)
    result = do(
        clouds.write(tmp_path / "in.laz", Cloud(xyz, np.ones(len(xyz), np.uint8))),
        tmp_path / "out",
    )
    assert result.exit_code == 0
    assert len(classes_by_point(tmp_path / "out")) == len(xyz)
    assert json.loads((tmp_path / "out" / "run.json").read_text())["state"] == "done"
