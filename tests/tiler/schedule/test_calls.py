"""Calls of functions of the store: a worker gets the values, and the digest has those that change the result."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from tiler.core.lattice import Bounds, CoordFrame, Lattice
from tiler.core.records import NOT_IN_DIGEST
from tiler.schedule import Task, calling
from tiler.schedule.worker import compute, run_task
from tiler.store import StoreMeta, TileStore, create_store, open_store


@dataclass(frozen=True)
class Part:
    """A value with a field that does not change the result."""

    name: str
    threads: int = field(default=1, metadata=NOT_IN_DIGEST)


def tell(store: TileStore, *, part: Part, size: Fraction, note: str = "") -> dict[str, Any]:
    return {"buckets": str(store.meta.bucket.size), "part": part.name, "note": note}


def digest(*held: Any, aside: tuple[str, ...] = (), **values: Any) -> str:
    given = {"part": Part("a"), "size": Fraction(1, 3), **values}
    return Task.of("s", "k", calling(tell, **given).without(*aside), *held).digest


@pytest.mark.parametrize("run", [run_task, compute])
def test_the_work_gets_the_store_and_the_values(run: Any, tmp_path: Path) -> None:
    url = str(tmp_path / "store.zarr")
    create_store(
        url, StoreMeta(CoordFrame(), Lattice(Fraction(50_000)), Lattice(Fraction(500)), False)
    )
    call = calling(tell, part=Part("a"), size=Fraction(2), note="n")
    task = Task.of("s", "k", call, points=7, bounds=Bounds(0, 1, 2, 3))
    outcome = run(url, pickle.loads(pickle.dumps(task)))
    assert outcome.record == {"buckets": "50000", "part": "a", "note": "n"}
    assert (outcome.task.points, outcome.task.bounds) == (7, Bounds(0, 1, 2, 3))
    committed = open_store(url).committed("s")
    expected = {"k": (task.digest, outcome.record)} if run is run_task else {}
    assert {key: tuple(commit) for key, commit in committed.items()} == expected


def test_the_digest_follows_from_values_and_what_is_read() -> None:
    usual = digest("read")
    assert digest("read") == usual
    different = [
        digest("other"),
        digest("read", part=Part("b")),
        digest("read", size=Fraction(2, 3)),
        digest("read", note="n"),
    ]
    assert len({usual, *different}) == 1 + len(different)


def test_values_that_do_not_change_the_result_are_not_in_the_digest() -> None:
    assert digest(part=Part("a", threads=8)) == digest(part=Part("a"))
    assert digest(aside=("note",), note="n") == digest(aside=("note",), note="m")
    assert digest(aside=("note",), note="n") != digest(note="n")
