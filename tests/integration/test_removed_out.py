"""OUT or the store is removed while the run goes on: that is what is said, and not that an input is to blame."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.invariants.runs import do
from tests.waiting import wait_until
from tiler.errors import ProcessingError
from tiler.export.tasks import files as file_tasks
from tiler.filter.tasks import passes
from tiler.grid.tasks import terrain
from tiler.ingest.tasks import points as ingest_tasks
from tiler.store import TileStore, open_store

WORKS = {
    "spool_piece": ingest_tasks,
    "assemble_buckets": ingest_tasks,
    "filter_tile": passes,
    "grid_block": terrain,
    "write_cog": file_tasks,
    "write_classified": file_tasks,
}


def remove_at(name: str, place: Path, early: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove a folder before a worker begins a task of this kind, or after the first one is done."""
    work = getattr(WORKS[name], name)

    def removing(store: TileStore, **values: Any) -> dict[str, Any]:
        if early:
            shutil.rmtree(place, ignore_errors=True)
            store = open_store(store.url)  # as a worker does before the work
        record: dict[str, Any] = work(store, **values)
        shutil.rmtree(place, ignore_errors=True)
        return record

    monkeypatch.setattr(WORKS[name], name, removing)


@pytest.mark.parametrize(
    ("what", "name", "early"),
    [
        pytest.param(
            what, name, early, marks=() if what and early == (n % 2 == 0) else pytest.mark.slow
        )
        for what in ("", "store.zarr")
        for early in (True, False)
        for n, name in enumerate(WORKS)
    ],
)
def test_what_was_removed_is_named(
    what: str,
    name: str,
    early: bool,
    cloud: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out"
    remove_at(name, out / what, early, monkeypatch)
    with pytest.raises(ProcessingError) as caught:
        do(cloud, out)
    assert str(caught.value).startswith(f"{out / what}: was removed during the run; run again")
    monkeypatch.undo()
    assert do(cloud, out).exit_code == 0


def test_nothing_is_written_after_out_was_removed(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The code of the CRS is worked out beside the tasks that write; it comes after the removal here."""
    out = tmp_path / "out"

    def late(wkt: str) -> None:
        wait_until(lambda: not out.exists())

    monkeypatch.setattr("tiler.export.stage.horizontal_code", late)
    remove_at("write_cog", out, True, monkeypatch)
    with pytest.raises(ProcessingError, match="was removed during the run"):
        do(cloud, out)
    assert not (out / "store.zarr").exists()


@pytest.mark.parametrize("name", ["write_cog", "write_classified"])
def test_a_run_is_not_done_without_its_results(
    name: str, cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    remove_at(name, out, False, monkeypatch)
    with pytest.raises(
        ProcessingError, match=r"out(/.*)?: (was removed|removed|cannot be written)"
    ):
        do(cloud, out, store=str(tmp_path / "store"))
    monkeypatch.undo()
    assert do(cloud, out, store=str(tmp_path / "store")).exit_code == 0
    assert (out / "dtm.tif").is_file()
