"""One cloud delivered in many ways is one answer: pixel, memory, rasters, labels and notes are the same."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pytest

from tests.invariants import clouds
from tests.invariants.clouds import Cloud
from tests.invariants.runs import assert_same_terrain, classes_by_point, do
from tests.scenes.copc_files import write_copc
from tests.scenes.ept_files import write_ept
from tiler.config import RunConfig
from tiler.errors import ConfigError
from tiler.plan import Plan, make_plan, projected_memory

SIDE_M, DENSITY = 100.0, 0.6
"""Points 1.3 m apart: pixels of 1.5 m."""


@pytest.fixture(scope="module")
def scene() -> Cloud:
    return clouds.city(SIDE_M, DENSITY)


def in_parts(folder: Path, scene: Cloud, owner: np.ndarray) -> Path:
    """A folder of one file for each number in ``owner``, of the points that it stands at."""
    for number in np.unique(owner):
        clouds.write(folder / f"{number}.laz", scene.take(owner == number))
    return folder


def at_random(number: int) -> Callable[[Path, Cloud], Path]:
    def write(folder: Path, scene: Cloud) -> Path:
        return in_parts(
            folder, scene, np.random.default_rng(number).integers(0, number, len(scene))
        )

    return write


def shuffled(folder: Path, scene: Cloud) -> Path:
    return in_parts(
        folder,
        scene.take(np.random.default_rng(0).permutation(len(scene))),
        np.zeros(len(scene)),
    )


def strips(folder: Path, scene: Cloud) -> Path:
    """Diagonal flight lines that overlap."""
    across = (scene.xyz[:, 0] + scene.xyz[:, 1]) / SIDE_M * 3
    owner = np.floor(across + np.random.default_rng(0).uniform(-0.3, 0.3, len(scene)))
    return in_parts(folder, scene, owner.astype(int))


def copc(folder: Path, scene: Cloud) -> Path:
    path = write_copc(
        folder / "a.copc.laz", laspy.read(clouds.write(folder / "a.laz", scene)), 1500
    )
    (folder / "a.laz").unlink()
    return path


def ept(folder: Path, scene: Cloud) -> Path:
    return write_ept(folder / "tiles", laspy.read(clouds.write(folder / "a.laz", scene)), 1500)


def vpc(folder: Path, scene: Cloud) -> Path:
    names = sorted(path.name for path in at_random(3)(folder, scene).iterdir())
    features = [
        {"type": "Feature", "assets": {"data": {"href": f"./{name}"}}} for name in names
    ]
    content = {"type": "FeatureCollection", "features": features}
    (folder / "all.vpc").write_text(json.dumps(content))
    return folder / "all.vpc"


WAYS: dict[str, Callable[[Path, Cloud], Path]] = {
    "1": at_random(1), "6": at_random(6), "40": at_random(40), "shuffled": shuffled,
    "strips": strips, "copc": copc, "ept": ept, "vpc": vpc,
}  # fmt: skip


@pytest.fixture(scope="module")
def delivered(scene: Cloud, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Way -> input of a run."""
    found = {}
    for way, write in WAYS.items():
        folder = tmp_path_factory.mktemp(way)
        found[way] = write(folder, scene)
    return found


def plan_of(path: Path, **settings: object) -> Plan:
    return make_plan(
        [str(path)],
        RunConfig.from_mapping(
            {"in_process": True, "workers": 1, "memory": "1GiB", **settings}
        ),
    )


def without_counts(texts: tuple[str, ...]) -> set[str]:
    return {re.sub(r"\d[\d,]*", "#", text) for text in texts if "octree" not in text}


def test_the_plan_is_the_same(delivered: dict[str, Path]) -> None:
    plans = {way: plan_of(path) for way, path in delivered.items()}
    whole = plans["1"]
    assert {way: float(plan.grid.resolution) for way, plan in plans.items()} == dict.fromkeys(
        plans, 1.5
    )
    for way, plan in plans.items():
        assert plan.inputs.density == pytest.approx(whole.inputs.density, rel=0.01), way
        assert plan.method.tile == whole.method.tile, way
        assert (plan.grid.bucket_m, plan.tiles) == (whole.grid.bucket_m, whole.tiles), way
        assert without_counts(plan.notes) == without_counts(whole.notes), way
        assert without_counts(plan.warnings) == without_counts(whole.warnings), way
        for stage, size in projected_memory(plan).items():
            assert size == pytest.approx(projected_memory(whole)[stage], rel=0.05), (way, stage)


def test_a_pixel_that_suits_the_points_is_not_warned_of(delivered: dict[str, Path]) -> None:
    for way, path in delivered.items():
        assert plan_of(path, resolution="1").warnings == (), way


def test_what_is_refused_is_the_same(delivered: dict[str, Path]) -> None:
    for way, path in delivered.items():
        with pytest.raises(ConfigError, match=r"use --memory 4\d\dMiB"):
            plan_of(path, memory="300MiB")
        assert plan_of(path, memory="430MiB").resources.memory == 430 << 20, way


def test_a_part_has_the_density_of_the_whole(delivered: dict[str, Path]) -> None:
    west, south = clouds.CORNER
    bounds = (west, south, west + 40, south + 40)
    settings = {"bounds": bounds, "method": "classic", "halo": "5", "max_edge": "5"}
    parts = {way: plan_of(path, **settings) for way, path in delivered.items() if way != "ept"}
    for way, part in parts.items():
        assert part.inputs.density == pytest.approx(parts["1"].inputs.density, rel=0.01), way
        assert part.grid.resolution == parts["1"].grid.resolution, way


@pytest.mark.parametrize(
    "way",
    [
        "40",
        "ept",
        *(pytest.param(way, marks=pytest.mark.slow) for way in ("6", "strips", "copc", "vpc")),
    ],
)
def test_results_are_the_same(way: str, delivered: dict[str, Path], tmp_path: Path) -> None:
    found, how = {}, {"resolution": None, "tile_size": None, "halo": None, "water": "auto"}
    for name in ("1", way):
        found[name] = do(delivered[name], tmp_path / name, **how)
    assert_same_terrain(tmp_path / way, tmp_path / "1")
    assert np.array_equal(classes_by_point(tmp_path / way), classes_by_point(tmp_path / "1"))
    texts = [without_counts((*result.notes, *result.warnings)) for result in found.values()]
    assert texts[0] == texts[1]


def test_files_mostly_void_are_not_thinned_out_over_their_bounds(tmp_path: Path) -> None:
    """A diagonal strip, whose bounds are ten times as wide as it is."""
    random = np.random.default_rng(3)
    along, across = np.sort(random.uniform(0, 1000, 160_000)), random.uniform(0, 40, 160_000)
    xyz = np.stack([along - across, along + across, 0 * along], axis=1) / np.sqrt(2)
    strip = Cloud(np.round(xyz, 3), np.ones(len(xyz), np.uint8))
    for way in ("1", "6", "40", "shuffled"):
        plan = plan_of(WAYS[way](tmp_path / way, strip), method="classic")
        assert plan.grid.resolution == 1, way
        assert 1 < plan.inputs.density < 8, way
        assert any("mostly void" in text for text in plan.notes), way
