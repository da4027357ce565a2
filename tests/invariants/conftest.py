"""Scenes as files, and buckets small enough for small scenes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.invariants import clouds
from tests.invariants.clouds import Cloud
from tests.invariants.runs import do
from tests.scenes.small_stores import small_stores


@pytest.fixture(autouse=True)
def small_buckets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Buckets of 32 m, so that a scene has dozens of them."""
    small_stores(monkeypatch)


@pytest.fixture(scope="session")
def city() -> Cloud:
    return clouds.city()


@pytest.fixture(scope="session")
def city_file(city: Cloud, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clouds.write(tmp_path_factory.mktemp("clouds") / "city.laz", city)


@pytest.fixture(scope="session")
def quarter_files(city: Cloud, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("quarters")
    names = ("sw", "se", "nw", "ne")
    return [
        clouds.write(folder / f"{n}.laz", q)
        for n, q in zip(names, clouds.quarters(city), strict=True)
    ]


@pytest.fixture(scope="session")
def finished(quarter_files: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OUT of an undisturbed run of four files in this process: what all others are compared with. Not to be changed."""
    out = tmp_path_factory.mktemp("finished") / "out"
    with pytest.MonkeyPatch.context() as patch:
        small_stores(patch)
        do(quarter_files, out)
    return out
