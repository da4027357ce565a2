"""Tasks on the workers of a Dask cluster that runs already.

No graph of all tasks is ever made: a few tasks a worker are in flight, the next is submitted when one is done.

Tasks that fail are tried again. Dask knows that a worker died, but not which of its tasks
killed it: all of them are suspects, which are tried once more when the others are done, each one alone, so that the
tasks that kill are known, and no others are given up.
"""

from __future__ import annotations

import faulthandler
import itertools
import logging
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import distributed
from distributed import KilledWorker

from tiler.errors import ConfigError
from tiler.schedule.local import WORKER_DIED
from tiler.schedule.task import TRIES, Limits, Outcome, Perform, Task

IN_FLIGHT_PER_WORKER = 2
"""One at work and one waiting, so that no worker idles while the client hears of a result."""

CONNECT_SECONDS = 20

_dask: Any = distributed
"""Its functions have no types."""


def _watched(perform: Perform, store_url: str, task: Task, seconds: float) -> Outcome:
    """On a worker: a task.

    A thread of C ends a process that hangs, also in a library that keeps the interpreter's lock; Dask replaces
    it. There is one such timer in a process: with several threads a worker it is that of the last task.
    """
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(seconds, exit=True, file=nowhere)
        try:
            return perform(store_url, task)
        finally:
            faulthandler.cancel_dump_traceback_later()


@dataclass(frozen=True)
class _Try:
    """One submission of a task."""

    task: Task
    number: int
    began: float


class DaskExecutor:
    """Bounded submission to a Dask cluster.

    Parameters
    ----------
    address : str
        Of a running scheduler.
    limits : Limits
        Of time; memory is the business of the cluster.

    Raises
    ------
    ConfigError
        No scheduler at the address, or one without workers.
    """

    def __init__(self, address: str, limits: Limits | None = None) -> None:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._limits = limits or Limits()
        self._submissions = itertools.count()  # Dask would answer for a name that it knows
        try:
            self._client: Any = _dask.Client(address, timeout=CONNECT_SECONDS)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(f"--scheduler {address}: no Dask scheduler answers there ({error})") from error
        self.workers = len(self._client.scheduler_info(n_workers=-1)["workers"])
        if self.workers == 0:
            self._client.close()
            raise ConfigError(
                f"--scheduler {address}: it has no workers; start some with `dask worker {address}`"
            )

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Outcomes as they come, one a try; `Outcome.again` tells that another one follows."""
        suspects: list[Task] = []
        deaths: Counter[str] = Counter()
        for outcome in self._together(perform, store_url, tasks):
            if outcome.error_kind == WORKER_DIED:
                suspects.append(outcome.task)
                deaths[outcome.task.key] += 1
                outcome = replace(outcome, again=True)
            yield outcome
        for task in suspects:
            while True:
                (outcome,) = self._together(perform, store_url, [task], tries=1)
                deaths[task.key] += outcome.error_kind == WORKER_DIED
                again = outcome.error_kind == WORKER_DIED and deaths[task.key] < TRIES
                if not again and outcome.error_kind == WORKER_DIED:
                    error = f"killed its worker {deaths[task.key]} times, the last one alone: {outcome.error}"
                    outcome = replace(outcome, error=error)
                yield replace(outcome, again=again)
                if not again:
                    break

    def _together(
        self, perform: Perform, store_url: str, tasks: Iterable[Task], tries: int = TRIES
    ) -> Iterator[Outcome]:
        """Outcomes of tasks that are in flight side by side, one a try."""
        waiting = iter(tasks)
        running: dict[str, _Try] = {}

        def submit(task: Task, number: int = 1) -> Any:
            future = self._client.submit(
                _watched, perform, store_url, task, self._limits.seconds_of(task), pure=False,
                key=f"{task.stage}/{task.key}/{next(self._submissions)}",
            )  # fmt: skip
            running[future.key] = _Try(task, number, time.monotonic())
            return future

        room = IN_FLIGHT_PER_WORKER * self.workers
        done = _dask.as_completed([submit(task) for task in itertools.islice(waiting, room)])
        for future in done:
            this = running.pop(future.key)
            outcome = self._outcome(future, this)
            future.release()
            again = outcome.again and this.number < tries
            if again:
                done.add(submit(this.task, this.number + 1))
            yield replace(outcome, again=again)
            following = None if again else next(waiting, None)
            if following is not None:
                done.add(submit(following))

    def _outcome(self, future: Any, this: _Try) -> Outcome:
        error = future.exception()
        if error is None:
            outcome: Outcome = future.result()
            return outcome
        if isinstance(error, KilledWorker):
            limit = self._limits.seconds_of(this.task)
            late = time.monotonic() - this.began >= limit
            text = (
                f"no end within {limit:g} s; --task-seconds allows more"
                if late
                else "its process ended without a word (a native crash, or the system took it for its memory)"
            )
            return Outcome(this.task, None, text, WORKER_DIED)
        text = (str(error) or repr(error)).splitlines()[0]
        return Outcome(this.task, None, text, type(error).__name__, again=True)

    def close(self) -> None:
        """Leave the cluster, which goes on."""
        self._client.close(timeout=5)
