"""Executor of tasks on Dask workers: on this machine, in the command's own process, or on a running cluster.

There is no graph of all tasks. Each worker has a few tasks at a time, and another one is
submitted when one is done. A failed task is retried. `tiler.schedule.dask_workers` runs a task on a
worker.
"""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

import distributed
from distributed import KilledWorker
from distributed.comm.addressing import get_address_host_port

from tiler.errors import ConfigError, ConnectionLostError, first_line
from tiler.schedule.dask_workers import (
    WORKER_DIED,
    ExecutorSettings,
    SharedContext,
    call_in_child,
    cluster_here,
    defaults_of_dask,
    end_children,
    machine_of,
    run_task_in_child,
)
from tiler.schedule.task import Machine, Outcome, Task, TaskLimits, TaskRunner, WorkerCheck

WAITING_PER_WORKER = 1
"""Number of tasks that wait at each worker of a cluster, so that it has work while a result is
sent to the client."""

CONNECT_SECONDS = 20
WORKERS_SECONDS = 20
"""Maximum time to wait for the first worker of a cluster, since workers start later than their
scheduler."""
CLOSE_SECONDS = 5
CONCURRENT_CHECKS = 16
"""Number of workers that are checked at the same time. Each starts a child, which takes about a
second."""
LOOK_SECONDS = 5.0
"""Time between two searches for workers that have joined the cluster."""

_BROKEN = (OSError, CancelledError, AttributeError, RuntimeError)
"""Errors of Dask's client without a connection to the scheduler, the last two of them after its
last retry."""

_LOGGERS = ("distributed", "distributed.client")
"""Loggers of Dask that have their own levels. Instead of them, tiler reports a broken
connection in one line."""


@contextmanager
def _silent() -> Iterator[None]:
    levels = {name: logging.getLogger(name).level for name in _LOGGERS}
    for name in _LOGGERS:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


_silence = SharedContext(_silent)
"""Context while there is an executor, since its tasks report their errors."""

_dask: Any = distributed
"""Module `distributed` without type checks, since its functions have no types."""


@dataclass(frozen=True)
class _Try:
    task: Task
    number: int


class DaskExecutor:
    """Executor that submits tasks to Dask workers, a few at a time.

    Parameters
    ----------
    workers : int
        Number of workers to start on this machine, if there is no ``address``.
    address : str, optional
        Address of the scheduler of a running cluster.
    limits : TaskLimits

    Raises
    ------
    ConfigError
        There is no scheduler at the address, or it has no workers.
    """

    def __init__(
        self, workers: int, address: str | None = None, limits: TaskLimits | None = None
    ) -> None:
        self._run = ExecutorSettings(uuid.uuid4().hex, limits or TaskLimits())
        self._submissions = 0
        self._cluster: Any = None
        self._address = address
        # Until `close`. The user's configuration is for clusters of the user.
        self._contexts = [_silence] if address is not None else [_silence, defaults_of_dask]
        for context in self._contexts:
            context.begin()
        try:
            self._client = self._connected(workers, address)
        except BaseException:
            self._end_contexts()
            raise
        if address is None:
            self.workers = self._room = workers
            return
        self._judged: set[str] = set()
        self._judge: WorkerCheck | None = None
        self.workers = 0
        began = time.monotonic()
        self._look()
        while self.workers == 0 and self._looked - began < WORKERS_SECONDS:
            time.sleep(0.2)
            self._look()
        if self.workers == 0:
            self.close()
            raise self._without_workers()

    def _connected(self, workers: int, address: str | None) -> Any:
        """Return a client for new workers on this machine, or for the cluster at an address."""
        if address is None:
            self._cluster = cluster_here(workers)
            return _dask.Client(self._cluster, set_as_default=False)
        try:
            # This raises an error for a wrong address before there is a client that would have
            # to be closed.
            get_address_host_port(address)
            return _dask.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(
                f"--scheduler {address}: no Dask scheduler answers there ({error})"
            ) from error

    def _look(self) -> None:
        """Find the current workers of the cluster, and check the new ones."""
        self._looked = time.monotonic()
        threads = self._threads()
        if threads is None:
            return  # The tasks report a broken connection.
        self.workers = len(threads)
        self._room = max(sum(threads.values()) + WAITING_PER_WORKER * self.workers, 1)
        if self._judge is not None:
            new = sorted(set(threads) - self._judged)
            with ThreadPoolExecutor(CONCURRENT_CHECKS) as pool:
                for found in [
                    pool.submit(self._judge_one, self._judge, worker) for worker in new
                ]:
                    found.result()

    def _threads(self) -> dict[str, int] | None:
        """Return the number of threads of each worker, or None if the connection to the scheduler broke."""
        try:
            return dict(self._client.nthreads())
        except _BROKEN:
            return None

    def _judge_one(self, judge: WorkerCheck, worker: str) -> None:
        try:
            judge(partial(self._ask, worker), worker)
            self._judged.add(worker)
        except ConnectionLostError:
            if self._submissions == 0:
                raise
            # Later, the tasks report the loss, or the connection is restored and the next
            # `_look` checks the worker.
        except ConfigError:
            # A worker that has left the cluster needs no error.
            if worker in (self._threads() or ()):
                raise

    def on_each_worker(self, look: WorkerCheck) -> None:
        """Call `look` for each worker of a cluster, now and when workers join later."""
        if self._cluster is None:
            self._judge = look
            self._look()

    def machines(self) -> list[Machine]:
        """Return the machines of a cluster that have workers now, by name. The list is empty without a cluster."""
        if self._cluster is not None:
            return []
        found: dict[str, Machine] = {}
        for answer in self._on_workers(machine_of).values():
            if isinstance(answer, BaseException):  # The worker has just left the cluster.
                continue
            name, memory, threads = answer
            known = found.get(name, Machine(name, 0, 0, 0))
            found[name] = Machine(
                name=name,
                memory_bytes=max(known.memory_bytes, memory),
                workers=known.workers + 1,
                threads=known.threads + threads,
            )
        if not found:
            raise self._without_workers()
        return [found[name] for name in sorted(found)]

    def _ask(self, worker: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a function in a child of one worker."""
        answers = self._on_workers(
            call_in_child, self._run, function, *arguments, workers=[worker]
        )
        (answer,) = answers.values()
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _on_workers(
        self, function: Callable[..., Any], *arguments: Any, **options: Any
    ) -> dict[str, Any]:
        """Return the result of a function on each worker, or its exception."""
        try:
            return dict(self._client.run(function, *arguments, on_error="return", **options))
        except _BROKEN as error:
            raise self._lost() from error

    def run(
        self, run_task: TaskRunner, store_url: str, tasks: Iterable[Task]
    ) -> Iterator[Outcome]:
        """Run tasks and yield an outcome per try. If `Outcome.again` is True, the task is retried."""
        waiting = iter(tasks)
        running: dict[str, _Try] = {}
        done = _dask.as_completed(loop=self._client.loop)

        def submit(task: Task, number: int) -> None:
            # Each name is new, since Dask would return an old result for a known name. Dask
            # groups tasks by the text before the number.
            self._submissions += 1
            name = f"{task.stage}-{self._submissions}/{task.key}"
            arguments = (run_task_in_child, self._run, run_task, store_url, task)
            try:
                future = self._client.submit(*arguments, pure=False, key=name)
            except Exception as error:  # The class of the error depends on the version of Dask.
                if self._client.status in ("running", "connecting"):
                    raise
                raise self._lost() from error
            running[future.key] = _Try(task, number)
            done.add(future)

        def fill() -> None:
            for task in islice(waiting, max(self._room - len(running), 0)):
                submit(task, 1)

        fill()
        for future in done:
            this = running.pop(future.key)
            outcome = self._outcome(future, this)
            future.release()
            if outcome.again:
                submit(this.task, this.number + 1)
            if self._cluster is None and time.monotonic() - self._looked > LOOK_SECONDS:
                self._look()
            fill()
            yield outcome

    def _outcome(self, future: Any, this: _Try) -> Outcome:
        again = this.number < this.task.tries
        if future.cancelled():
            return self._cut_off(this)
        error = future.exception()
        if isinstance(error, KilledWorker):
            text = "its worker was lost each time (a lost machine, or too little memory)"
            return Outcome(this.task, None, text, WORKER_DIED, again=again)
        if error is not None:
            return Outcome(
                this.task, None, first_line(error), type(error).__name__, again=again
            )
        try:
            outcome: Outcome = future.result()
        except _BROKEN as broken:  # An error of the task itself is the `error` above.
            text = f"its result could not be fetched ({type(broken).__name__}: {first_line(broken)})"
            return replace(self._cut_off(this), error=text, again=again)
        if outcome.error_kind == WORKER_DIED:
            fate = f"its worker {outcome.error}"
            if not again:
                fate = f"killed its worker {this.number} times: it {outcome.error}"
            outcome = replace(outcome, error=fate)
        return replace(outcome, again=outcome.again and again)

    def _cut_off(self, this: _Try) -> Outcome:
        """Return the outcome of a try during which the connection broke.

        The task has to be retried, since Dask's client loses its tasks when it reconnects.
        """
        while self._client.status == "connecting":
            time.sleep(0.1)
        if self._client.status != "running":
            raise self._lost()
        return Outcome(
            this.task,
            None,
            "the connection to the scheduler broke",
            "ConnectionError",
            again=True,
        )

    def _lost(self) -> ConnectionLostError:
        text = "the connection broke and was not restored"
        if self._address is None:
            return ConnectionLostError(
                f"the workers of this machine: {text}; run the same command again to resume"
            )
        return ConnectionLostError(
            f"--scheduler {self._address}: {text}; check the cluster, then run the same command again to resume"
        )

    def _without_workers(self) -> ConfigError:
        return ConfigError(
            f"--scheduler {self._address}: it has no workers; start some with `dask worker {self._address}`"
        )

    def close(self) -> None:
        """End all work for this executor. A cluster at an address keeps running."""
        # Without a connection, the children cannot be ended.
        if self._client.status == "running":
            with suppress(*_BROKEN):
                ending = self._client._run, end_children, self._run.token
                self._client.sync(*ending, callback_timeout=CLOSE_SECONDS)
        with suppress(*_BROKEN):
            self._client.close(timeout=CLOSE_SECONDS)
        if self._cluster is not None:
            with suppress(*_BROKEN):  # A stopped child keeps its worker waiting.
                self._cluster.close(timeout=CLOSE_SECONDS)
        self._end_contexts()

    def _end_contexts(self) -> None:
        for context in reversed(self._contexts):
            context.end()
