"""Dask workers: those of this machine, and the child process in which any worker runs a task (see `ChildProcess`).

A native crash, a hang or too much memory ends only the child and one try of its task, and the cause is known. The Dask
worker and its other tasks continue.

The cluster of this machine is inside the command's own process. Scheduler and workers are objects of one thread that
communicate through memory. Therefore it starts in hundredths of a second and does not open a port.

By default, Dask makes a folder with a known name in the shared temporary folder, puts it first on `sys.path`, and then
imports optional modules. If another user made that folder before, Dask could import that user's code. Here the folder
is private. It is removed from the disk and from `sys.path` once the cluster has started, since Dask uses it only with a
memory limit.
"""

from __future__ import annotations

import asyncio
import socket
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any, cast

import dask
import distributed
from distributed.deploy.spec import SpecCluster
from distributed.system import MEMORY_LIMIT

from tiler.import_path import without_scratch
from tiler.schedule.guard import ChildDiedError, ChildProcess, ChildStartError
from tiler.schedule.task import Outcome, Task, TaskLimits, TaskRunner

_WITHOUT_PORTS = {"protocol": "inproc://", "dashboard": False}
_WITHOUT_FOLDERS = {"needs_workdir": False}
_QUIET = {
    # The profiler would sample every thread 100 times per second.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
"""Settings that disable web pages and measurements of the command's own process, which do not
affect results."""

_configuring = Lock()


class SharedContext:
    """Context that is entered for the first of several users and left after the last.

    Parameters
    ----------
    make : callable
        Function that returns a context manager.
    """

    def __init__(self, make: Callable[[], AbstractContextManager[object]]) -> None:
        self._make = make
        self._lock = Lock()
        self._users = 0
        self._entered = ExitStack()

    def begin(self) -> None:
        """Add one to the number of users, and enter the context for the first."""
        with self._lock:
            self._users += 1
            if self._users == 1:
                self._entered.enter_context(self._make())

    def end(self) -> None:
        """Subtract one from the number of users, and leave the context after the last."""
        with self._lock:
            self._users -= 1
            if self._users == 0:
                self._entered.close()


def _defaults() -> AbstractContextManager[object]:
    """Return a context with Dask's own configuration, without files and variables of the user."""
    setting: Any = dask.config
    return cast("AbstractContextManager[object]", setting.set(setting.merge(*setting.defaults)))


defaults_of_dask = SharedContext(_defaults)
"""Context while there is a cluster of this module. A preloaded module or a short timeout of the
user is meant for other clusters."""


class QuietScheduler(distributed.Scheduler):
    """Dask scheduler without the web page, for which it would open a port to the network."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Do not start a server."""


class QuietWorker(distributed.Worker):
    """Dask worker without the web page."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Do not start a server."""


def cluster_here(workers: int) -> Any:
    """Return a cluster of ``workers`` workers with one thread each."""
    alone = {**_WITHOUT_PORTS, **_WITHOUT_FOLDERS}
    options = {**alone, "nthreads": 1, "memory_limit": 0}
    with _configured(), warnings.catch_warnings():
        # Dask searches for an address of this machine to name the workers, but without a
        # network there is none.
        warnings.filterwarnings(
            "ignore", "Couldn't detect a suitable IP address", RuntimeWarning
        )
        return SpecCluster(
            scheduler={"cls": QuietScheduler, "options": alone},
            workers={i: {"cls": QuietWorker, "options": options} for i in range(workers)},
            silence_logs=False,
        )


@contextmanager
def _configured() -> Iterator[None]:
    """Configure Dask during the block, and restore its configuration afterwards.

    Blocks in several threads wait for each other. If they overlapped, the last one would
    restore the settings of another block.
    """
    with _configuring, TemporaryDirectory(prefix="tiler-dask-") as folder:
        try:
            with dask.config.set({**_QUIET, "temporary-directory": folder}):
                yield
        finally:
            sys.path[:] = without_scratch(sys.path)


WORKER_DIED = "WorkerDied"
"""Error kind of a task that killed its worker."""


@dataclass(frozen=True)
class ExecutorSettings:
    """Values that the tasks of one executor share.

    Attributes
    ----------
    token : str
        Unique name of the executor.
    limits : TaskLimits
    """

    token: str
    limits: TaskLimits


class Children:
    """Children of a Dask worker: one per running task. Idle children are kept for the next task."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[ChildProcess] = []
        self._busy: dict[ChildProcess, str] = {}
        self._ended: set[str] = set()

    def run_task(
        self, run: ExecutorSettings, run_task: TaskRunner, store_url: str, task: Task
    ) -> Outcome:
        """Run a task in a child, and return its outcome."""
        guard = self._take(run)
        try:
            outcome = guard.call(run_task, store_url, task, seconds=run.limits.seconds_of(task))
            if outcome.again:
                guard.close()  # The next try gets a new process.
        except ChildStartError as error:
            outcome = Outcome(task, None, f"its process {error}", "MemoryError", again=True)
        except ChildDiedError as died:
            outcome = Outcome(task, None, str(died), WORKER_DIED, again=True)
        except Exception as error:  # noqa: BLE001 - The task, or its outcome, could not be sent.
            kind = type(error).__name__
            outcome = Outcome(task, None, f"{kind}: {error}", kind, again=True)
        finally:
            self._give_back(guard)
        return outcome

    def call(self, run: ExecutorSettings, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of ``function(*arguments)`` in a child.

        Raise the exception of the function, or `ChildDiedError`.
        """
        guard = self._take(run)
        try:
            return guard.call(function, *arguments, seconds=run.limits.seconds)
        finally:
            self._give_back(guard)

    def end(self, token: str) -> None:
        """End the children of one executor, and all idle ones. Later tasks of this executor end immediately."""
        with self._lock:
            self._ended.add(token)
            for guard, owner in self._busy.items():
                if owner == token:
                    guard.kill()
            idle, self._idle = self._idle, []
        for guard in idle:
            guard.close()

    def _take(self, run: ExecutorSettings) -> ChildProcess:
        """Return an idle child with the same memory limit, or a new one."""
        with self._lock:
            others, self._idle = self._idle, []
            guard = ChildProcess(run.limits.memory_bytes, run.limits.prepare)
            while others:
                other = others.pop()
                if other.memory_bytes == guard.memory_bytes:
                    guard, self._idle = other, others
                    break
                other.close()
            self._busy[guard] = run.token
            if run.token in self._ended:
                guard.kill()  # The executor of the task has ended.
            return guard

    def _give_back(self, guard: ChildProcess) -> None:
        with self._lock:
            del self._busy[guard]
            if not guard.killed:
                self._idle.append(guard)
                return
        guard.close()


def run_task_in_child(
    run: ExecutorSettings, run_task: TaskRunner, store_url: str, task: Task
) -> Outcome:
    """Call `Children.run_task` on a Dask worker."""
    return _children(distributed.get_worker()).run_task(run, run_task, store_url, task)


async def call_in_child(
    run: ExecutorSettings,
    function: Callable[..., Any],
    *arguments: Any,
    dask_worker: distributed.Worker,
) -> Any:
    """Call `Children.call` on a Dask worker, in parallel with its tasks. Dask passes the worker."""
    return await asyncio.to_thread(_children(dask_worker).call, run, function, *arguments)


def machine_of(dask_worker: distributed.Worker) -> tuple[str, int, int]:
    """Return name and memory (bytes) of a Dask worker's machine, and the worker's threads. Dask passes the worker."""
    return socket.gethostname(), MEMORY_LIMIT, dask_worker.state.nthreads


def end_children(token: str, dask_worker: distributed.Worker) -> None:
    """Call `Children.end` on a Dask worker. Dask passes the worker."""
    _children(dask_worker).end(token)


def _children(worker: distributed.Worker) -> Children:
    # The children are an attribute of the worker, since a process can have several workers.
    found: Children = vars(worker).setdefault("tiler_children", Children())
    return found
