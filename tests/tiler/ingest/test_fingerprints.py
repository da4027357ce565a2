"""Digests of the inputs: all bytes, once, whoever reads them; what cannot be read costs that file."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.tiler.conftest import MakeCloud
from tiler.config import RunConfig
from tiler.errors import InputError
from tiler.ingest.tasks import fingerprints
from tiler.inputs import inspect
from tiler.observe.events import ignore_events
from tiler.runs import file_digests
from tiler.runs.found import Source
from tiler.runs.record import RunRecord
from tiler.schedule import SerialExecutor
from tiler.store import TileStore


@pytest.fixture
def paths(make_cloud: MakeCloud) -> list[Path]:
    """Ten small files."""
    return [make_cloud(f"{i}.las", n=30, seed=i) for i in range(10)]


def register_sources(
    paths: list[Path], store: TileStore, **settings: Any
) -> tuple[list[Source], Any]:
    """The sources, and what stood for the run."""
    plan = SimpleNamespace(
        inputs=SimpleNamespace(sources=[inspect(path) for path in paths]),
        config=RunConfig(**settings),
        method=SimpleNamespace(title_of=str),
    )
    executors = SimpleNamespace(choose=lambda writes_out: SerialExecutor())
    job: Any = SimpleNamespace(
        plan=plan, store=store, executors=executors, listener=ignore_events, record=RunRecord()
    )
    return fingerprints.register_sources(job), job


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Number of files of each task that is done."""
    found: list[int] = []
    read = file_digests.read_files

    def count(store: TileStore, **values: Any) -> Any:
        found.append(len(values["files"]))
        return read(store, **values)

    monkeypatch.setattr(file_digests, "read_files", count)
    return found


def test_all_bytes_once_and_again_where_something_changed(
    paths: list[Path], small_store: TileStore, seen: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_digests, "GROUP_FILES", 4)
    sources, _ = register_sources(paths, small_store)
    contents = [
        hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest() for path in paths
    ]
    assert [(s.number, s.content) for s in sources] == list(enumerate(contents))
    assert seen == [4, 4, 2]
    assert register_sources(paths, small_store)[0] == sources
    assert seen == [4, 4, 2]
    # a touch may leave the time as it was, which goes on in steps
    os.utime(paths[3], ns=(0, 1_000_000_007))
    again, _ = register_sources(paths[2:], small_store)
    assert [(s.number, s.content) for s in again] == list(enumerate(contents))[2:]
    assert seen == [4, 4, 2, 1]
    register_sources(paths, small_store, verify=True)
    assert seen == [4, 4, 2, 1, 4, 4, 2]


def test_large_files_are_read_alone(
    paths: list[Path], small_store: TileStore, seen: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_digests, "GROUP_BYTES", 100)
    register_sources(paths, small_store)
    assert seen == [1] * 10


def grow_while_it_is_read(monkeypatch: pytest.MonkeyPatch, *places: Path) -> None:
    read = file_digests.read_files

    def grow(store: TileStore, **values: Any) -> Any:
        for place in places:
            place.write_bytes(place.read_bytes() + b"more")
        return read(store, **values)

    monkeypatch.setattr(file_digests, "read_files", grow)


def test_a_file_that_changes_meanwhile_is_left_out(
    paths: list[Path], small_store: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    grow_while_it_is_read(monkeypatch, paths[4])
    sources, job = register_sources(paths, small_store)
    assert [s.number for s in sources] == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    (left_out,) = job.record.quarantined
    assert left_out.path == paths[4].as_posix()
    assert "during the run (" in left_out.error
    monkeypatch.undo()
    assert [s.number for s in register_sources(paths, small_store)[0]] == list(range(10))


@pytest.mark.parametrize(
    ("grown", "settings", "text"),
    [
        (
            [4],
            {"on_error": "stop"},
            r"4\.las: was replaced or .* \(.* bytes before, .* now\); run",
        ),
        (range(10), {}, r"no input could be read; the first error: .*0\.las: "),
    ],
)
def test_what_ends_the_run(
    grown: list[int],
    settings: dict[str, Any],
    text: str,
    paths: list[Path],
    small_store: TileStore,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    grow_while_it_is_read(monkeypatch, *(paths[i] for i in grown))
    with pytest.raises(InputError, match=text):
        register_sources(paths, small_store, **settings)
