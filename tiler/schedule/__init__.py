"""Small and equal executors: in this process, or on Dask workers."""

from __future__ import annotations

from tiler.schedule.guard import Died, Guard
from tiler.schedule.serial import SerialExecutor
from tiler.schedule.task import Executor, Outcome, Perform, Task, Work, digest_of

__all__ = [
    "Died",
    "Executor",
    "Guard",
    "Outcome",
    "Perform",
    "SerialExecutor",
    "Task",
    "Work",
    "digest_of",
    "make_executor",
]


def make_executor(workers: int, address: str | None = None) -> Executor:
    """Make one that works in this process for one worker, else on Dask (imported only then)."""
    if workers == 1 and address is None:
        return SerialExecutor()
    from tiler.schedule.workers import DaskExecutor

    return DaskExecutor(workers, address)
