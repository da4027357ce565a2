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
