"""Executors of tasks, interchangeable: in this process, or on Dask workers of this machine or of a cluster."""

from __future__ import annotations

from tiler.schedule.fork_server import kept_forking, prepare_children
from tiler.schedule.guard import Died, Guard, limits_memory
from tiler.schedule.isolated_reading import half_of_memory, read_apart, seconds_for
from tiler.schedule.parallel_calls import Guards
from tiler.schedule.serial import SerialExecutor
from tiler.schedule.task import (
    NOT_IN_DIGEST,
    TRIES,
    Executor,
    Limits,
    Look,
    Machine,
    Outcome,
    Perform,
    Placed,
    Task,
    Work,
    digest_of,
)

__all__ = [
    "NOT_IN_DIGEST",
    "TRIES",
    "Died",
    "Executor",
    "Guard",
    "Guards",
    "Limits",
    "Look",
    "Machine",
    "Outcome",
    "Perform",
    "Placed",
    "SerialExecutor",
    "Task",
    "Work",
    "digest_of",
    "half_of_memory",
    "kept_forking",
    "limits_memory",
    "make_executor",
    "prepare_children",
    "read_apart",
    "seconds_for",
]


def make_executor(
    workers: int, address: str | None = None, in_process: bool = False, limits: Limits | None = None
) -> Executor:
    """Make one on Dask workers (imported only then), of this machine or of a cluster, or in this process.

    Also one worker works in a process of its own: what crashes it must not end the run.
    """
    if in_process:
        return SerialExecutor()
    from tiler.schedule.workers import DaskExecutor

    return DaskExecutor(workers, address, limits)
