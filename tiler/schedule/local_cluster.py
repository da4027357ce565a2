"""Dask cluster inside the command's own process, for the workers of this machine.

Scheduler and workers are objects of one thread that communicate through memory, and their tasks
run in child processes (`tiler.schedule.children`). Therefore the cluster starts in hundredths
of a second and does not open a port.

By default, Dask makes a folder with a known name in the shared temporary folder, puts it first
on `sys.path`, and then imports optional modules. If another user made that folder before, Dask
could import that user's code. Here the folder is private. It is removed from the disk and from
`sys.path` once the cluster has started, since Dask uses it only with a memory limit.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any, cast

import dask
import distributed
from distributed.deploy.spec import SpecCluster

from tiler.import_path import without_scratch

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
