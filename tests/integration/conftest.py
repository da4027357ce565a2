"""A small cloud; a simulated city in four files, and finished runs on it; an object store."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.cloud import BUCKET, object_store
from tests.invariants import clouds
from tests.invariants.runs import do, settings
from tiler.pipeline import RunResult, run
from tiler.simulate import AlsSensor, DemoScene, demo_city

SIDE_M = 200.0


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    """A file of 60 m of a city; modules that run often on one have their own."""
    return clouds.write(tmp_path / "hill.laz", clouds.city(60.0, 1.0))


@pytest.fixture(scope="session")
def city(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 150 m of a city."""
    return clouds.write(tmp_path_factory.mktemp("cloud") / "city.laz", clouds.city(150.0, 1.5))


@pytest.fixture(scope="session")
def city_run(city: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of a run on the city. Not to be changed."""
    out = tmp_path_factory.mktemp("whole") / "out"
    do(city, out)
    return out


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> DemoScene:
    return demo_city(
        tmp_path_factory.mktemp("demo"), seed=5, side_m=SIDE_M, sensor=AlsSensor(density=1.5)
    )


@pytest.fixture
def small_buckets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiler.plan.sizes.BUCKET_POINTS", 1000)


@pytest.fixture(scope="session")
def finished_run(
    demo: DemoScene, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, RunResult]:
    """OUT and result of the whole job by the Python API, with a method of one pass. Not to be changed."""
    out = tmp_path_factory.mktemp("run") / "out"
    return out, run(
        [str(path) for path in demo.paths], out, settings(tile_size="128", water="auto")
    )


@pytest.fixture(scope="session")
def default_run(
    demo: DemoScene, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, RunResult]:
    """The same with the default method."""
    out = tmp_path_factory.mktemp("default") / "out"
    return out, run(
        [str(path) for path in demo.paths],
        out,
        settings(tile_size="128", method="auto", water="auto"),
    )


@pytest.fixture(scope="module")
def bucket() -> Iterator[Any]:
    """The file system of an S3 server whose variables are those of this process."""
    pytest.importorskip("moto.server", reason="no S3 server: moto is not installed")
    pytest.importorskip("upath")
    s3fs = pytest.importorskip("s3fs")
    with object_store() as variables, pytest.MonkeyPatch.context() as patch:
        for name, value in variables.items():
            patch.setenv(name, value)
        system = s3fs.S3FileSystem(use_listings_cache=False)
        system.mkdir(BUCKET)
        yield system
        s3fs.S3FileSystem.clear_instance_cache()


class Here:
    """Instead of `tiler.schedule.ChildProcess`: what is called is done in this process."""

    def __init__(self, memory_bytes: int) -> None:
        """Limit nothing."""

    def __enter__(self) -> Here:
        return self

    def __exit__(self, *error: object) -> None:
        """End nothing."""

    kill = leave = __exit__

    def call(self, function: Any, *arguments: Any, seconds: float) -> Any:
        return function(*arguments)


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands that start a process for what they read do it here: hundreds would take minutes."""

    def here(guard: Any, function: Any, *arguments: Any, **named: Any) -> Any:
        return function(*arguments, **named)

    monkeypatch.setattr("tiler.schedule.guarded_calls.ChildProcess", Here)
    for module in ("tiler.apps.preview", "tiler.apps.classify"):
        monkeypatch.setattr(f"{module}.read_in_child", here)
    for module in ("classify", "preview", "evaluate"):
        command = f"cli.commands.{module}.read_config"
        read = __import__(f"cli.commands.{module}", fromlist=["read_config"]).read_config
        monkeypatch.setattr(command, functools.partial(_in_process, read))


def _in_process(read: Any, *arguments: Any) -> Any:
    return read(*arguments).updated(in_process=True)
