"""One run per OUT and per store, and what the first of them settles for all others."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from tests.invariants.forked import ended, forked
from tests.invariants.runs import do, output_digests, the_store
from tiler.errors import LockedError
from tiler.store import TileStore, create_store, locked_folder


def test_two_runs_on_one_folder_exclude_one_another(cloud: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(cloud, out, store=str(tmp_path / "one.zarr"))
    before = (out / "run.json").read_bytes()
    with (
        locked_folder(str(out)),
        pytest.raises(
            LockedError, match=re.escape(f"{out}: in use by process {os.getpid()} on")
        ),
    ):
        do(cloud, out, store=str(tmp_path / "other.zarr"), products="slope")
    assert (out / "run.json").read_bytes() == before
    assert not (tmp_path / "other.zarr").exists()
    assert do(cloud, out, store=str(tmp_path / "one.zarr")).did_nothing


def dies_at_first_state(cloud: Path, out: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TileStore, "put_state", lambda *arguments: os._exit(9))
        do(cloud, out, memory="900MiB", tile_size=None, resolution=None)


@pytest.mark.processes
def test_a_run_that_is_killed_as_it_begins_has_settled_all_or_nothing(
    cloud: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert ended(forked(dies_at_first_state, cloud, out)) == 9
    settled = the_store(out).settled
    expected = {"tile", "resolution", "memory", "thin", "workers"}
    assert expected == settled.keys()
    assert settled["memory"] == 900 << 20
    later = do(cloud, out, memory="2GiB", tile_size=None, resolution=None)
    assert later.summary["plan"]["tile_m"] == float(settled["tile"])
    do(cloud, tmp_path / "alone", memory="900MiB", tile_size=None, resolution=None)
    assert output_digests(out) == output_digests(tmp_path / "alone")


def test_a_thinned_surface_has_the_reason_that_is_true(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reasons(**changes: Any) -> list[str]:
        notes = do(cloud, tmp_path / "out", **changes).summary["notes"]
        return [note.split(", because ")[1] for note in notes if "one ground point" in note]

    with monkeypatch.context() as patch:
        for module in ("plan.model", "grid.stage"):
            patch.setattr(f"tiler.{module}.MAX_GROUND", 1000)
        (crowded,) = reasons()
        assert crowded.startswith("more than 1,000 points may lie in a part of a block")
    (settled,) = reasons(resolution="2")
    assert settled.startswith("the first run on this store decided it")
    assert not reasons(overwrite=True)


def test_it_is_settled_under_the_lock(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def made(url: str, *arguments: Any, **settings: Any) -> TileStore:
        assert (out / ".tiler-lock.json").is_file()
        assert (
            json.loads((out / "store.zarr" / "lock.json").read_text())["body"]["pid"]
            == os.getpid()
        )
        return create_store(url, *arguments, **settings)

    monkeypatch.setattr("tiler.pipeline.create_store", made)
    for overwrite in (False, True):
        assert do(cloud, out, overwrite=overwrite).exit_code == 0
    assert not list(out.rglob("*lock.json"))
