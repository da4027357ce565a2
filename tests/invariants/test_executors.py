"""Serial = 1 worker = 2 workers = another order of the tasks, byte for byte."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import distributed
import pytest

from tests.invariants.runs import do, output_digests
from tests.scenes.small_stores import USUAL_ROW_POINTS, small_stores
from tiler.schedule import Executor, Outcome, SerialExecutor, Task, TaskRunner
from tiler.schedule.workers import DaskExecutor


class Shuffled(SerialExecutor):
    """Tasks in any order but the given one."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)

    def run(
        self, run_task: TaskRunner, store_url: str, tasks: Iterable[Task]
    ) -> Iterator[Outcome]:
        shuffled = list(tasks)
        self.random.shuffle(shuffled)
        return super().run(run_task, store_url, shuffled)


class Twice(SerialExecutor):
    """Each task is done twice, as when a worker is lost after its commit."""

    def run(
        self, run_task: TaskRunner, store_url: str, tasks: Iterable[Task]
    ) -> Iterator[Outcome]:
        for task in tasks:
            run_task(store_url, task)
            yield run_task(store_url, task)


class OnCluster(DaskExecutor):
    """Two workers in processes of their own, as far as this machine can have a cluster."""

    def __init__(self) -> None:
        self.processes: Any = distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
        )
        super().__init__(2, self.processes.scheduler_address)

    def close(self) -> None:
        super().close()
        self.processes.close()


EXECUTORS: dict[str, Callable[[], Executor]] = {
    "two workers": lambda: DaskExecutor(2),
    "another order": lambda: Shuffled(1),
    "twice": Twice,
}
SLOW: dict[str, Callable[[], Executor]] = {
    "one worker": lambda: DaskExecutor(1),
    "a cluster of two": OnCluster,
    "one more order": lambda: Shuffled(2),
}


@pytest.mark.parametrize(
    "name", [*EXECUTORS, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]
)
def test_every_executor_gives_the_same_bytes(
    name: str,
    quarter_files: list[Path],
    finished: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    small_stores(monkeypatch, row_points=USUAL_ROW_POINTS)  # what workers know
    monkeypatch.setattr(
        "tiler.runs.executors.make_executor", lambda *_: (EXECUTORS | SLOW)[name]()
    )
    result = do(quarter_files, tmp_path / "out", water="auto")
    assert result.exit_code == 0
    assert output_digests(tmp_path / "out") == output_digests(finished)


@pytest.mark.processes
def test_workers_and_memory_are_in_no_digest(quarter_files: list[Path], tmp_path: Path) -> None:
    do(quarter_files, tmp_path / "out")
    again = do(quarter_files, tmp_path / "out", workers=2, memory="2GiB")
    assert again.did_nothing
