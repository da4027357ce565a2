"""Interchangeable executors of tasks: in this process, or on Dask workers of this machine or a cluster."""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module
from threading import Thread

from tiler.errors import ConfigError
from tiler.schedule.fork_server import FORKS, fork_server_running, prepare_children
from tiler.schedule.guard import ChildDiedError, ChildProcess, ChildStartError, limits_memory
from tiler.schedule.guarded_calls import ChildPool, call_isolated, half_of_memory
from tiler.schedule.task import (
    TRIES,
    Executor,
    Machine,
    Outcome,
    SerialExecutor,
    Task,
    TaskLimits,
    TaskRunner,
    WorkerCheck,
    calling,
)

__all__ = [
    "FORKS",
    "TRIES",
    "ChildDiedError",
    "ChildPool",
    "ChildProcess",
    "ChildStartError",
    "Executor",
    "Machine",
    "Outcome",
    "SerialExecutor",
    "Task",
    "TaskLimits",
    "TaskRunner",
    "WorkerCheck",
    "call_isolated",
    "calling",
    "fork_server_running",
    "half_of_memory",
    "import_dask",
    "limits_memory",
    "make_executor",
    "prepare_children",
]


_imports: list[Thread] = []
"""Threads that import Dask."""


def import_dask() -> None:
    """Import the modules that `make_executor` needs for workers, in a background thread."""

    def work() -> None:
        # `make_executor` raises the error again. A process that is ending refuses imports with a
        # RuntimeError.
        with suppress(Exception):
            import_module("tiler.schedule.workers")

    thread = Thread(target=work, name="import dask")
    thread.start()
    _imports.append(thread)


def make_executor(
    workers: int,
    address: str | None = None,
    in_process: bool = False,
    limits: TaskLimits | None = None,
) -> Executor:
    """Make an executor in this process, or on Dask workers of this machine or of the cluster at an address.

    A single worker also has a separate process, so that its crash does not end the run.
    """
    if in_process:
        return SerialExecutor()
    while (
        _imports
    ):  # An import that waits for one that fails in another thread gets half of the module.
        _imports.pop().join()
    try:
        from tiler.schedule.workers import DaskExecutor
    except ValueError as error:  # Dask reads its configuration while it is imported.
        text = str(error).splitlines()[0].rstrip(":,")
        raise ConfigError(
            f"the configuration of Dask cannot be read ({text}); correct it, or unset the variables DASK_..."
        ) from error

    return DaskExecutor(workers, address, limits)
