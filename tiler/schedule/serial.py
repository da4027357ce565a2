"""Executor that runs tasks one after another in this process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from tiler.schedule.task import Machine, Outcome, Task, TaskRunner, WorkerCheck


class SerialExecutor:
    """Executor without workers, which is the simple reference for `DaskExecutor`."""

    workers = 1

    def on_each_worker(self, look: WorkerCheck) -> None:
        """Do nothing, since there are no workers of a cluster."""

    def machines(self) -> list[Machine]:
        """Return an empty list, since there is no cluster."""
        return []

    def run(
        self, run_task: TaskRunner, store_url: str, tasks: Iterable[Task]
    ) -> Iterator[Outcome]:
        """Run tasks and yield outcomes in the order of the tasks."""
        for task in tasks:
            for tries in range(1, task.tries + 1):
                outcome = run_task(store_url, task)
                again = outcome.again and tries < task.tries
                yield replace(outcome, again=again)
                if not again:
                    break

    def close(self) -> None:
        """Do nothing."""
