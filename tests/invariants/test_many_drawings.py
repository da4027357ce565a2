"""Thousands of corrections: as many tasks as buckets, each polygon with what it had alone, and little time."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import shapely

from tests.invariants.clouds import SIDE_M, Cloud, write
from tests.invariants.runs import do
from tests.scenes.drawings import Features, draw
from tests.scenes.small_stores import small_stores
from tiler.errors import InputError

SECONDS_OF_2000 = 6.0
"""CPU time that they may take on a slow machine; a task for each of them took 40."""
ACTIONS = ("not_ground", "ground", "void", "flat")


def spots(number: int, size: float) -> Features:
    """Octagons at random places, of all actions in turn."""
    places = np.random.default_rng(3).random((number, 2)) * SIDE_M
    shapes = shapely.buffer(shapely.points(places), size, quad_segs=2)
    return [(shape, {"action": ACTIONS[i % 4], "z": 120.0}) for i, shape in enumerate(shapes)]


@pytest.fixture(scope="module")
def half_classified(city: Cloud, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The input calls the ground of the western half ground, so that polygons differ in what they take."""
    classes = np.where((city.truth == 2) & (city.xyz[:, 0] < SIDE_M / 2), 2, 1).astype(np.uint8)
    return write(tmp_path_factory.mktemp("half") / "city.laz", city, classes=classes)


def test_what_a_correction_does_is_that_of_it_alone_whatever_the_buckets(
    half_classified: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = spots(60, 12.0)
    edits = draw(tmp_path / "e.json", drawn)
    small = do(half_classified, tmp_path / "small", edits=edits, water="none").summary
    small_stores(monkeypatch, 100_000)
    large = do(
        half_classified, tmp_path / "large", edits=edits, tile_size="200", water="none"
    ).summary
    assert small["stages"]["edits"]["tasks"] > 20 > large["stages"]["edits"]["tasks"]
    same = ("number", "action", "points", "ground_before", "by", "bounds")
    for one, other in zip(small["edits"], large["edits"], strict=True):
        assert [one.get(name) for name in same] == [other.get(name) for name in same]
    taken = [fact["by"] for fact in small["edits"] if fact["action"] == "ground"]
    assert set(taken) == {"classes", "lowest points"}
    chosen = (1, 21, 29)
    for i in chosen:
        alone = draw(tmp_path / f"{i}.json", [drawn[i]])
        (fact,) = do(
            half_classified, tmp_path / "large", edits=alone, tile_size="200", water="none"
        ).summary["edits"]
        assert {**fact, "number": i + 1} == large["edits"][i]


@pytest.mark.parametrize("number", [2000, pytest.param(20_000, marks=pytest.mark.slow)])
def test_thousands_take_seconds(
    number: int, half_classified: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_stores(monkeypatch, 10_000)

    def seconds(**how: str) -> float:
        start = time.process_time()
        stages = do(half_classified, tmp_path / "out", until="grid", **how).summary["stages"]
        assert ("edits" in stages) == ("edits" in how)
        assert stages.get("edits", {"tasks": 0})["tasks"] <= 9  # buckets
        return time.process_time() - start

    none = seconds()
    some = seconds(edits=draw(tmp_path / "e.json", spots(number, 1.0)))
    assert some - none < SECONDS_OF_2000 * max(number / 4000, 1)


@pytest.mark.parametrize("crossing", [False, True])
def test_a_polygon_of_spikes_is_refused_with_the_remedy(
    crossing: bool, city_file: Path, tmp_path: Path
) -> None:
    number = 100_000
    angles = np.arange(number) * (2 * np.pi / number)
    angles = np.random.default_rng(1).permutation(angles) if crossing else angles
    radius = np.where(np.arange(number) % 2, 90.0, 5.0)
    ring = np.stack((95 + radius * np.cos(angles), 95 + radius * np.sin(angles)), axis=1)
    edits = draw(tmp_path / "star.json", [(shapely.Polygon(ring), {"action": "void"})])
    start = time.process_time()
    with pytest.raises(
        InputError, match=r"feature 1: its outline of 100,001 vertices runs .* simplify it"
    ):
        do(city_file, tmp_path / "out", edits=edits)
    assert time.process_time() - start < 10
