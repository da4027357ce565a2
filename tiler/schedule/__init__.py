"""Small and equal executors: in this process, on processes of this machine, or on a Dask cluster."""

from __future__ import annotations

from tiler.schedule.guard import Died, Guard
from tiler.schedule.local import LocalExecutor
from tiler.schedule.serial import SerialExecutor
from tiler.schedule.task import TRIES, Executor, Limits, Outcome, Perform, Task, Work, digest_of

__all__ = [
    "TRIES",
    "Died",
    "Executor",
    "Guard",
    "Limits",
    "LocalExecutor",
    "Outcome",
    "Perform",
    "SerialExecutor",
    "Task",
    "Work",
    "digest_of",
    "make_executor",
]


def make_executor(
    workers: int, address: str | None = None, in_process: bool = False, limits: Limits | None = None
) -> Executor:
    """Make one on processes of this machine, on a Dask cluster (imported only then), or in this process.

    Also one worker is a process of its own: what crashes it must not end the run.
    """
    if in_process:
        return SerialExecutor()
    if address is None:
        return LocalExecutor(workers, limits)
    from tiler.schedule.workers import DaskExecutor

    return DaskExecutor(address, limits)
