"""A worker of a cluster needs the client's versions, the inputs, the store, and perhaps OUT."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from tiler.core.lattice import CoordFrame, Lattice
from tiler.errors import ConfigError
from tiler.io.locations import state_of
from tiler.schedule import Machine, cluster_check
from tiler.schedule.cluster_check import ClusterAccess
from tiler.store import StoreMeta, create_store


def here(function: Callable[..., Any], *arguments: Any) -> Any:
    """Stands for a worker: calls the function in this process."""
    return function(*arguments)


@pytest.fixture
def asked(tmp_path: Path) -> Callable[..., ClusterAccess]:
    cloud, store = tmp_path / "cloud.laz", tmp_path / "store.zarr"
    cloud.write_bytes(b"x" * 100)
    meta = StoreMeta(
        CoordFrame(origin=(0, 0)), Lattice(Fraction(10_000)), Lattice(Fraction(1000)), False
    )
    create_store(str(store), meta)

    def make(
        path: Path = cloud, size: int = 100, url: str = str(store), there: bool = True
    ) -> ClusterAccess:
        source = (str(path), replace(state_of(cloud), size=size))
        return ClusterAccess("tcp://s:1", [source], url, str(tmp_path), there)

    return make


def test_a_worker_with_access_to_everything_is_accepted(
    asked: Callable[..., ClusterAccess], tmp_path: Path
) -> None:
    look = asked()
    look(here, "tcp://w:2")
    assert look.out_seen
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud.laz", "store.zarr"]


def test_a_copy_with_another_time_of_change_is_refused(tmp_path: Path) -> None:
    cloud = tmp_path / "cloud.laz"
    cloud.write_bytes(b"x" * 100)
    look = ClusterAccess("tcp://s:1", [(str(cloud), state_of(cloud))], None, None)
    os.utime(cloud, ns=(0, 1_000_000_007))
    with pytest.raises(
        ConfigError, match=r"cloud\.laz \(the same size, but another modification time; .*cp -p"
    ):
        look(here, "tcp://w:2")


def test_a_worker_that_does_not_see_out(
    asked: Callable[..., ClusterAccess], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    look = asked()
    monkeypatch.setattr(cluster_check, "sees", lambda token: not Path(token).exists())
    look(here, "tcp://w:2")
    assert not look.out_seen
    look(here, "tcp://w:3")
    assert not look.out_seen


def test_a_worker_with_other_versions_is_refused(asked: Callable[..., ClusterAccess]) -> None:
    def old(function: Callable[..., Any], *arguments: Any) -> Any:
        return {**cluster_check.versions(), "numpy": "1.0", "Python": "3.9"}

    line = r"worker tcp://w:2 has Python 3.9, here .*; numpy 1.0, here .*; install the same"
    with pytest.raises(ConfigError, match=line):
        asked()(old, "tcp://w:2")


def test_a_worker_without_tiler_is_refused(asked: Callable[..., ClusterAccess]) -> None:
    def bare(function: Callable[..., Any], *arguments: Any) -> Any:
        raise ModuleNotFoundError("No module named 'tiler'")

    line = r"worker tcp://w:2 cannot run functions of tiler .*No module named 'tiler'.*install it there"
    with pytest.raises(ConfigError, match=line):
        asked()(bare, "tcp://w:2")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"path": Path("/nowhere/a.laz")},
            r"cannot read .nowhere.a\.laz \(.*(No such file|not f).*inputs by URL",
        ),
        ({"size": 99}, r"cannot read .*cloud.laz \(100 bytes there, 99 here\)"),
        ({"url": "/nowhere/store.zarr"}, r"cannot use .nowhere.store.zarr \(.*--store by URL"),
        (
            {"url": "nosuch://bucket"},
            r"cannot use nosuch://bucket .*check the URL and the credentials",
        ),
    ],
)
def test_a_worker_without_access_is_refused(
    asked: Callable[..., ClusterAccess], changes: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError, match=text):
        asked(**changes)(here, "tcp://w:2")


def test_the_future_place_of_a_store_is_checked(
    asked: Callable[..., ClusterAccess], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    coming = asked(url=str(tmp_path / "later/store.zarr"), there=False)
    coming(here, "tcp://w:2")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud.laz", "store.zarr"]
    monkeypatch.setattr(cluster_check, "sees", lambda token: False)
    with pytest.raises(
        ConfigError, match=r"cannot use .*later.store\.zarr \(it cannot access.*--store by URL"
    ):
        coming(here, "tcp://w:2")


def test_places_that_are_not_known_yet_are_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("sees", "unusable", "unwritable"):
        monkeypatch.setattr(cluster_check, name, lambda *_: pytest.fail("asked"))
    ClusterAccess("tcp://s:1", [], None, None)(here, "tcp://w:2")


def test_machines_with_too_little_memory_are_refused() -> None:
    look = ClusterAccess("tcp://s:1", [], None, None)
    look.validate_memory([Machine("a", 4 << 30, 2, 4), Machine("b", 1 << 30, 1, 1)], 1 << 30)
    line = r"tcp://s:1: machine b has 4,096 MiB for 5 tasks at a time of up to 1,024 MiB; start fewer"
    with pytest.raises(ConfigError, match=line):
        look.validate_memory(
            [Machine("a", 4 << 30, 2, 4), Machine("b", 4 << 30, 1, 5)], 1 << 30
        )
