"""Child processes for the tasks of a Dask worker (see `ChildProcess`).

A native crash, a hang or too much memory ends only the child and one try of its task, and the
cause is known. The Dask worker and its other tasks continue.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import distributed
from distributed.system import MEMORY_LIMIT

from tiler.schedule.guard import ChildDiedError, ChildProcess, ChildStartError
from tiler.schedule.task import Outcome, Task, TaskLimits, TaskRunner

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
