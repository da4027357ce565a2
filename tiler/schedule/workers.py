"""Tasks on Dask workers: processes of this machine, or a cluster that runs already.

No graph of all tasks is ever made: a few tasks a worker are in flight, the next is submitted when one is done.
"""

from __future__ import annotations

import itertools
import logging
import signal
from collections.abc import Iterable, Iterator
from typing import Any

import distributed
from distributed import KilledWorker, WorkerPlugin

from tiler.errors import ConfigError
from tiler.schedule.task import Outcome, Perform, Task

IN_FLIGHT_PER_WORKER = 2
"""One at work and one waiting, so that no worker idles while the client hears of a result."""

CONNECT_SECONDS = 20


_dask: Any = distributed
"""Its functions have no types."""


class _Patience(WorkerPlugin):
    """Ctrl-C reaches every process of a terminal; a worker, also one that replaces a dead one, ends with its client."""

    name = "tiler-patience"

    def setup(self, worker: Any) -> None:
        """In the worker's main thread, before its first task."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)


class DaskExecutor:
    """Bounded submission to a Dask cluster.

    Parameters
    ----------
    workers : int
        Processes to start here, one thread each; ignored with an address.
    address : str, optional
        Of a running scheduler.

    Raises
    ------
    ConfigError
        No scheduler at the address, or one without workers.
    """

    def __init__(self, workers: int, address: str | None = None) -> None:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._cluster: Any = None
        if address is None:
            self._cluster = _dask.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, memory_limit=0,
                dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL,
            )  # fmt: skip
            self._client: Any = _dask.Client(self._cluster)
            self._client.register_plugin(_Patience())
            self.workers = workers
            return
        try:
            self._client = _dask.Client(address, timeout=CONNECT_SECONDS)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(f"--scheduler {address}: no Dask scheduler answers there ({error})") from error
        self.workers = len(self._client.scheduler_info(n_workers=-1)["workers"])
        if self.workers == 0:
            self._client.close()
            raise ConfigError(
                f"--scheduler {address}: it has no workers; start some with `dask worker {address}`"
            )

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Outcomes as they come."""
        waiting = iter(tasks)
        running: dict[str, Task] = {}
        room = IN_FLIGHT_PER_WORKER * self.workers
        first = [self._submit(perform, store_url, task, running) for task in itertools.islice(waiting, room)]
        done = _dask.as_completed(first)
        for future in done:
            task = running.pop(future.key)
            yield self._outcome(future, task)
            future.release()
            following = next(waiting, None)
            if following is not None:
                done.add(self._submit(perform, store_url, following, running))

    def _submit(self, perform: Perform, store_url: str, task: Task, running: dict[str, Task]) -> Any:
        future = self._client.submit(
            perform, store_url, task, key=f"{task.stage}/{task.key}/{task.digest}", pure=False
        )
        running[future.key] = task
        return future

    def _outcome(self, future: Any, task: Task) -> Outcome:
        error = future.exception()
        if error is None:
            outcome: Outcome = future.result()
            return outcome
        text = (
            "its worker died, three times" if isinstance(error, KilledWorker) else str(error) or repr(error)
        )
        return Outcome(task, None, text.splitlines()[0], type(error).__name__)

    def close(self) -> None:
        """End the workers that were started here, leave a cluster of others running."""
        self._client.close(timeout=5)
        if self._cluster is not None:
            self._cluster.close(timeout=10)
