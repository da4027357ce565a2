"""A Dask cluster inside the command's own process, for the workers of this machine.

Scheduler and workers are objects of one thread that talk through memory; their tasks run in children
(`tiler.schedule.children`), which are the processes. So it starts in hundredths of a second, and no port is opened.
"""

from __future__ import annotations

import warnings
from typing import Any

import distributed
from distributed.deploy.spec import SpecCluster

_WITHOUT_PORTS = {"protocol": "inproc://", "dashboard": False}


class QuietScheduler(distributed.Scheduler):
    """One that serves no page: there would be a port for it, open to the network."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Start no server."""


class QuietWorker(distributed.Worker):
    """A Dask worker without the web page that it would serve."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Start no server."""


def cluster_here(workers: int) -> Any:
    """A cluster of so many workers, with one thread each."""
    options = {**_WITHOUT_PORTS, "nthreads": 1, "memory_limit": 0}
    with warnings.catch_warnings():
        # What names the workers looks for an address of this machine; without a network there is none, and no matter.
        warnings.filterwarnings("ignore", "Couldn't detect a suitable IP address", RuntimeWarning)
        return SpecCluster(
            scheduler={"cls": QuietScheduler, "options": _WITHOUT_PORTS},
            workers={i: {"cls": QuietWorker, "options": options} for i in range(workers)},
            silence_logs=False,
        )
