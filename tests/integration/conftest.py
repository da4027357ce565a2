"""A small simulated city in four files, and a finished run on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.invariants.runs import settings
from tiler.pipeline import RunResult, run
from tiler.simulate import AlsSensor, DemoScene, demo_city

SIDE_M = 200.0


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> DemoScene:
    return demo_city(tmp_path_factory.mktemp("demo"), seed=5, side_m=SIDE_M, sensor=AlsSensor(density=1.5))


@pytest.fixture
def small_buckets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiler.plan.sizes.BUCKET_POINTS", 1000)


@pytest.fixture(scope="session")
def finished_run(demo: DemoScene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunResult]:
    """OUT and result of the whole job by the Python API, with a method of one pass. Not to be changed."""
    out = tmp_path_factory.mktemp("run") / "out"
    return out, run([str(path) for path in demo.paths], out, settings(tile_size="128"))


@pytest.fixture(scope="session")
def default_run(demo: DemoScene, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RunResult]:
    """The same with the default method."""
    out = tmp_path_factory.mktemp("default") / "out"
    return out, run([str(path) for path in demo.paths], out, settings(tile_size="128", method="auto"))
