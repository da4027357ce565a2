"""A Dask cluster inside the command's own process, for the workers of this machine.

Scheduler and workers are objects of one thread that communicate through memory; their tasks run in child processes
(`tiler.schedule.children`). So the cluster starts in hundredths of a second, and opens no port.

By default, Dask makes a folder with a known name in the shared temporary folder, puts it first on `sys.path`, and then
imports optional modules: another user who made that folder before could have code imported from it. Here the folder is
private. It is removed from the disk and from `sys.path` once the cluster has started, since Dask uses it only with a
limit of memory.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any

import dask
import distributed
from distributed.deploy.spec import SpecCluster

from tiler.import_path import without_scratch

_WITHOUT_PORTS = {"protocol": "inproc://", "dashboard": False}
_WITHOUT_FOLDERS = {"needs_workdir": False}
_QUIET = {
    "distributed.worker.profile.enabled": False,  # it would sample every thread a hundred times a second
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
"""Settings without measurements of the command's own process and without web pages, which no result depends on."""

_configuring = Lock()


class QuietScheduler(distributed.Scheduler):
    """A Dask scheduler without the web page, for which it would open a port to the network."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Start no server."""


class QuietWorker(distributed.Worker):
    """A Dask worker without the web page."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Start no server."""


def cluster_here(workers: int) -> Any:
    """A cluster of ``workers`` workers with one thread each."""
    alone = {**_WITHOUT_PORTS, **_WITHOUT_FOLDERS}
    options = {**alone, "nthreads": 1, "memory_limit": 0}
    with _configured(), warnings.catch_warnings():
        # Dask looks for an address of this machine to name the workers; without a network there is none.
        warnings.filterwarnings("ignore", "Couldn't detect a suitable IP address", RuntimeWarning)
        return SpecCluster(
            scheduler={"cls": QuietScheduler, "options": alone},
            workers={i: {"cls": QuietWorker, "options": options} for i in range(workers)},
            silence_logs=False,
        )


@contextmanager
def _configured() -> Iterator[None]:
    """Configure Dask during the block, and restore its configuration afterwards.

    Blocks in several threads wait for each other: if they overlapped, the last one would restore the settings of
    another one.
    """
    with _configuring, TemporaryDirectory(prefix="tiler-dask-") as folder:
        try:
            with dask.config.set({**_QUIET, "temporary-directory": folder}):
                yield
        finally:
            sys.path[:] = without_scratch(sys.path)
