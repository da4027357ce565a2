"""Blocks that are made from one TIN: each is in one task, none is too full, and what fails is done one by one."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest

from tests.scenes.records import bucket_record
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.block import grid_block
from tiler.grid.records import GridBlock, GroundSelection
from tiler.grid.tasks.terrain import join_blocks
from tiler.runs.stage_runner import _outcomes
from tiler.schedule import Outcome, SerialExecutor, Task

SPEC = RasterSpec(Lattice(Fraction(1000)), 0, 1536, 1536, 1100)
"""Three by three blocks, those in the east of 76 columns."""
BUCKET = Lattice(Fraction(64_000))
RECORDS = {Cell(ix, iy): bucket_record(n=10_000) for ix in range(18) for iy in range(24)}


def tasks(blocks: list[Block] | None = None, **options: Any) -> list[Task]:
    data, rule = Bounds(0, 0, 1_100_000, 1_536_000), GroundSelection("final")
    given = {
        "name": "dtm",
        "spec": SPEC,
        "rule": rule,
        "data": data,
        "max_edge": Fraction(100_000),
    }
    works = [
        GridBlock(block=block, halo=101_000, **{**given, **options})
        for block in blocks or SPEC.blocks(512)
    ]
    return [
        Task("grid-dtm", work.block.name, "d", grid_block, {"work": work}, 1000)
        for work in works
    ]


def plan(most: int = 10**7, interpolation: str = "linear") -> Any:
    return SimpleNamespace(
        config=SimpleNamespace(interpolation=interpolation),
        buckets=BUCKET,
        block_points=most,
    )


def keys(found: list[Task]) -> list[list[str]]:
    return [[part.key for part in task.parts or (task,)] for task in found]


@pytest.mark.parametrize(
    ("workers", "most"), [(1, 10**7), (2, 10**7), (3, 10**7), (2, 2_000_000), (2, 1)]
)
def test_each_block_is_made_once_and_what_is_joined_fits(workers: int, most: int) -> None:
    every = tasks()
    found = join_blocks(plan(most), RECORDS, every, workers)
    assert Counter(key for group in keys(found) for key in group) == Counter(
        task.key for task in every
    )
    assert len({task.key for task in found}) == len(found) >= workers
    for task in found:
        assert task.points == 1000 * len(task.parts or (task,))
    if most == 1:
        assert len(found) == 9
    elif most == 10**7 and workers < 3:
        assert len(found) == workers


def test_two_workers_share_the_work_along_the_line_that_halves_it() -> None:
    one, two = keys(join_blocks(plan(), RECORDS, tasks(), 2))
    west = [key for key in one + two if key.endswith("c0000000")]
    assert sorted((one, two), key=len) == [west, [key for key in one + two if key not in west]]


def test_blocks_far_apart_and_other_interpolations_stay_alone() -> None:
    far = [Block(0, 0, 512, 512), Block(1024, 1024, 512, 76)]
    assert len(join_blocks(plan(), RECORDS, tasks(far), 1)) == 2
    for how in ("natural", "idw"):
        assert len(join_blocks(plan(interpolation=how), RECORDS, tasks(), 2)) == 9


def test_a_task_has_no_more_pixels_than_the_memory_is_planned_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tiler.grid.tasks.terrain.MAX_PIXELS", 2 * 512 * 512)
    assert len(join_blocks(plan(), RECORDS, tasks(), 1)) >= 3


def run_task(_: str, task: Task) -> Outcome:
    """A task of several fails, and one of the blocks; the others are made."""
    if task.parts or task.key.endswith("c0000512"):
        return Outcome(task, None, "too much", "MemoryError", again=True)
    return Outcome(task, {"key": task.key})


def test_what_fails_together_is_done_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tiler.runs.stage_runner.run_task", run_task)
    every = tasks()
    executors = SimpleNamespace(choose=lambda writes_out: SerialExecutor())
    job = SimpleNamespace(store=SimpleNamespace(url=""), executors=executors)

    def join(todo: list[Task], workers: int) -> list[Task]:
        return join_blocks(plan(), RECORDS, todo, workers)

    found = list(_outcomes(job, every, False, join))  # type: ignore[arg-type]
    assert not any(outcome.task.parts for outcome in found)
    last = {outcome.task.key: outcome for outcome in found}
    assert {key for key, outcome in last.items() if outcome.record is None} == {
        task.key for task in every if task.key.endswith("c0000512")
    }
    assert not any(outcome.again for outcome in last.values())


def test_the_time_of_a_task_is_that_of_its_parts() -> None:
    (joined,) = join_blocks(plan(), RECORDS, tasks(), 1)
    records = [{"n": i} for i in range(9)]
    outcomes = Outcome(joined, {"parts": records}, seconds=18.0).of_parts()
    assert [outcome.record for outcome in outcomes] == records
    assert [outcome.seconds for outcome in outcomes] == [2.0] * 9
