"""Tasks on Dask workers: of this machine, in the command's own process, or of a cluster that runs already.

No graph of all tasks is ever made: a few tasks a worker are in flight, the next is submitted when one is done. What a
worker does with a task is in `tiler.schedule.children`; a task that fails is tried again.
"""

from __future__ import annotations

import logging
import time
import uuid
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import dask
import distributed
from distributed import KilledWorker
from distributed.comm.addressing import get_address_host_port

from tiler.errors import ConfigError, ConnectionLostError, first_line
from tiler.schedule.children import (
    WORKER_DIED,
    Run,
    call_in_child,
    end_children,
    machine_of,
    perform_in_child,
)
from tiler.schedule.local_cluster import cluster_here
from tiler.schedule.task import Limits, Look, Machine, Outcome, Perform, Task

WAITING_PER_WORKER = 1
"""Tasks of a cluster that wait at their worker, so that it does not idle while the client hears of a result."""

CONNECT_SECONDS = 20
WORKERS_SECONDS = 20
"""For the first worker of a cluster that was started just before: workers take longer than their scheduler."""
CLOSE_SECONDS = 5
LOOKS_AT_A_TIME = 16
"""Workers that are judged together: a child starts on each, which takes about a second."""
LOOK_SECONDS = 5.0
"""Workers that joined a cluster get their share after this time."""

_QUIET = {
    "distributed.worker.profile.enabled": False,  # it looks at every thread a hundred times a second
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}
"""What Dask measures of the command's own process, and nobody looks at."""

_BROKEN = (OSError, CancelledError, AttributeError, RuntimeError)
"""What Dask's client raises where its connection to the scheduler broke; the last two when it gave up."""

_LOGGERS = ("distributed", "distributed.client")
"""Those with levels of their own; what they say of a broken connection is told in one line of ours."""

_dask: Any = distributed
"""Its functions have no types."""


@dataclass(frozen=True)
class _Try:
    """One submission of a task."""

    task: Task
    number: int


class DaskExecutor:
    """Gives tasks to Dask workers, a few at a time.

    Parameters
    ----------
    workers : int
        Of this machine, where no ``address`` is given.
    address : str, optional
        Of the scheduler of a cluster that runs already, whose workers are used.
    limits : Limits

    Raises
    ------
    ConfigError
        No scheduler at the address, or one without workers.
    """

    def __init__(self, workers: int, address: str | None = None, limits: Limits | None = None) -> None:
        self._log_levels = {name: logging.getLogger(name).level for name in _LOGGERS}
        for name in _LOGGERS:  # until `close`: what matters is told by the tasks
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._run = Run(uuid.uuid4().hex, limits or Limits())
        self._submissions = 0
        self._cluster: Any = None
        self._address = address
        if address is None:
            with dask.config.set(_QUIET):
                self._cluster = cluster_here(workers)
                self._client: Any = _dask.Client(self._cluster, set_as_default=False)
            self.workers = self._room = workers
            return
        try:
            get_address_host_port(address)  # a client that finds this out is hard to get rid of
            self._client = _dask.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--scheduler {address}: no Dask scheduler answers there ({error})") from error
        self._judged: set[str] = set()
        self._judge: Look | None = None
        self.workers, began = 0, time.monotonic()
        self._look()
        while self.workers == 0 and self._looked - began < WORKERS_SECONDS:
            time.sleep(0.2)
            self._look()
        if self.workers == 0:
            self.close()
            raise self._without_workers()

    def _look(self) -> None:
        """Look which workers the cluster has."""
        self._looked = time.monotonic()
        threads = self._threads()
        if threads is None:
            return  # a broken connection is told by the tasks
        self.workers = len(threads)
        self._room = max(sum(threads.values()) + WAITING_PER_WORKER * self.workers, 1)
        if self._judge is not None:
            new = sorted(set(threads) - self._judged)
            with ThreadPoolExecutor(LOOKS_AT_A_TIME) as pool:
                for found in [pool.submit(self._judge_one, self._judge, worker) for worker in new]:
                    found.result()

    def _threads(self) -> dict[str, int] | None:
        """Threads of each worker that the scheduler knows; None where it cannot be asked."""
        try:
            return dict(self._client.nthreads())
        except _BROKEN:
            return None

    def _judge_one(self, judge: Look, worker: str) -> None:
        try:
            judge(partial(self._ask, worker), worker)
            self._judged.add(worker)
        except ConnectionLostError:
            if self._submissions == 0:
                raise
            # Else tasks tell it, or the connection is there again, and the next look asks the worker.
        except ConfigError:
            if worker in (self._threads() or ()):  # it did not go away meanwhile
                raise

    def on_each_worker(self, look: Look) -> None:
        """Have `look` judge each worker of a cluster: those that are there now, and those that join later."""
        if self._cluster is None:
            self._judge = look
            self._look()

    def machines(self) -> list[Machine]:
        """Those of a cluster whose workers are there now, by name; none where this machine is the one."""
        if self._cluster is not None:
            return []
        found: dict[str, list[tuple[int, int]]] = defaultdict(list)
        for answer in self._told(machine_of).values():
            if not isinstance(answer, BaseException):  # a worker that goes away just now
                name, memory, threads = answer
                found[name].append((memory, threads))
        if not found:
            raise self._without_workers()
        return [
            Machine(name, max(m for m, _ in held), len(held), sum(threads for _, threads in held))
            for name, held in sorted(found.items())
        ]

    def _ask(self, worker: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """What a function gives in a child of one worker."""
        (answer,) = self._told(call_in_child, self._run, function, *arguments, workers=[worker]).values()
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _told(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> dict[str, Any]:
        """What a function gives on each worker, or raises there."""
        try:
            return dict(self._client.run(function, *arguments, on_error="return", **options))
        except _BROKEN as error:
            raise self._lost() from error

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Outcomes as they come, one a try; `Outcome.again` tells that another one follows."""
        waiting = iter(tasks)
        running: dict[str, _Try] = {}
        done = _dask.as_completed(loop=self._client.loop)

        def submit(task: Task, number: int) -> None:
            self._submissions += 1  # Dask would answer for a name that it knows
            name = f"{task.stage}/{task.key}/{self._submissions}"
            arguments = (perform_in_child, self._run, perform, store_url, task)
            try:
                future = self._client.submit(*arguments, pure=False, key=name)
            except Exception as error:  # its class has changed between versions of Dask
                if self._client.status in ("running", "connecting"):
                    raise
                raise self._lost() from error
            running[future.key] = _Try(task, number)
            done.add(future)

        def fill() -> None:
            while len(running) < self._room and (task := next(waiting, None)) is not None:
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
        """What became of a try."""
        again = this.number < this.task.tries
        if future.cancelled():
            return self._cut_off(this)
        error = future.exception()
        if isinstance(error, KilledWorker):
            text = "its worker went away each time (a machine that was lost, or its memory)"
            return Outcome(this.task, None, text, WORKER_DIED, again=again)
        if error is not None:
            return Outcome(this.task, None, first_line(error), type(error).__name__, again=again)
        try:
            outcome: Outcome = future.result()
        except _BROKEN as broken:  # what a task raises is the `error` above
            text = f"its result could not be fetched ({type(broken).__name__}: {first_line(broken)})"
            return replace(self._cut_off(this), error=text, again=again)
        if outcome.error_kind == WORKER_DIED:
            fate = f"its worker {outcome.error}"
            if not again:
                fate = f"killed its worker {this.number} times: it {outcome.error}"
            outcome = replace(outcome, error=fate)
        return replace(outcome, again=outcome.again and again)

    def _cut_off(self, this: _Try) -> Outcome:
        """The connection to the scheduler broke: Dask's client takes it up again, but forgets what it had asked for."""
        while self._client.status == "connecting":
            time.sleep(0.1)
        if self._client.status != "running":
            raise self._lost()
        return Outcome(
            this.task, None, "the connection to the scheduler broke", "ConnectionError", again=True
        )

    def _lost(self) -> ConnectionLostError:
        text = "the connection broke and does not come back"
        if self._address is None:
            return ConnectionLostError(f"the workers of this machine: {text}; the same command goes on")
        return ConnectionLostError(
            f"--scheduler {self._address}: {text}; see to the cluster, the same command goes on"
        )

    def _without_workers(self) -> ConfigError:
        return ConfigError(
            f"--scheduler {self._address}: it has no workers; start some with `dask worker {self._address}`"
        )

    def close(self) -> None:
        """End what works for this executor, whatever it does; a cluster goes on."""
        if self._client.status == "running":  # else the connection is what ended the run
            with suppress(*_BROKEN):
                ending = self._client._run, end_children, self._run.token
                self._client.sync(*ending, callback_timeout=CLOSE_SECONDS)
        with suppress(*_BROKEN):
            self._client.close(timeout=CLOSE_SECONDS)
        if self._cluster is not None:
            self._cluster.close(timeout=CLOSE_SECONDS)
        for name, level in self._log_levels.items():
            logging.getLogger(name).setLevel(level)
