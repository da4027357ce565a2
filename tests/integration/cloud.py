"""An S3 server on loopback, scheduler and workers as processes of their own."""

from __future__ import annotations

import contextlib
import json
import logging
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path

from tests.integration.command import environment
from tests.waiting import PATIENCE_SECONDS, wait_until

BUCKET = "bucket"


@contextlib.contextmanager
def object_store() -> Iterator[dict[str, str]]:
    """A server, and the variables with which everybody finds it."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    # the servers of one process share their objects
    reset = f"http://{host}:{port}/moto-api/reset"
    urllib.request.urlopen(reset, data=b"").close()
    try:
        yield {
            "AWS_ENDPOINT_URL": f"http://{host}:{port}",
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_DEFAULT_REGION": "us-east-1",
        }
    finally:
        server.stop()


class Cluster:
    """A Dask scheduler and workers; a context manager, within which ``port`` and ``address`` are the scheduler's.

    Parameters
    ----------
    folder : Path
        Of the processes, and of their logs.
    """

    port: int
    address: str

    def __init__(self, folder: Path, variables: dict[str, str] | None = None) -> None:
        self.folder = folder
        self._variables = variables or {}
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Cluster:
        # It chooses its port: one that is chosen here may be another's by then.
        told, options = (
            self.folder / "scheduler.json",
            "--host 127.0.0.1 --port 0 --no-dashboard",
        )
        scheduler = self._start(
            "dask.__main__", "scheduler", *options.split(), "--scheduler-file", str(told)
        )
        wait_until(lambda: _address_in(told), scheduler)
        self.address = _address_in(told)
        self.port = int(self.address.rpartition(":")[2])
        return self

    def __exit__(self, *error: object) -> None:
        # The scheduler last: workers whose scheduler is gone look for it before they end.
        scheduler, *workers = self._processes
        for process in workers:
            process.terminate()
        for process in (*workers, scheduler):
            process.terminate()
            try:
                process.wait(timeout=5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def worker(self, **variables: str) -> subprocess.Popen[bytes]:
        """One more worker, without a nanny: what kills it is the loss of a machine."""
        options = f"{self.address} --nthreads 1 --memory-limit 0 --no-dashboard --no-nanny --local-directory"
        return self._start(
            "dask.__main__", "worker", *options.split(), str(self.folder), **variables
        )

    def workers(self, number: int) -> list[subprocess.Popen[bytes]]:
        """The first workers, once the scheduler knows them."""
        found = [self.worker() for _ in range(number)]
        self.wait_for(number)
        return found

    def wait_for(self, workers: int) -> None:
        from distributed import Client

        with Client(self.address, timeout=PATIENCE_SECONDS, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE_SECONDS)

    def _start(self, *arguments: str, **variables: str) -> subprocess.Popen[bytes]:
        with open(self.folder / f"log-{len(self._processes)}", "wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                cwd=self.folder,
                stdout=log,
                stderr=log,
                env={**environment(), **self._variables, **variables},
            )
        self._processes.append(process)
        return process


def _address_in(file: Path) -> str:
    """The address that a scheduler wrote into a file; empty until it is there, and whole."""
    try:
        return str(json.loads(file.read_text())["address"])
    except (FileNotFoundError, json.JSONDecodeError):
        return ""


def blind(token: str) -> bool:
    """Instead of `tiler.schedule.cluster_check.sees`: a worker that sees no folder of the client."""
    return False


class Cable(threading.Thread):
    """Between a client and a scheduler; it can be cut, and the next connection holds again.

    Parameters
    ----------
    port : int
        Of the scheduler.
    """

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self._port = port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._lock = threading.Lock()
        self._ends: list[socket.socket] = []
        self._gone = False
        self.address = f"tcp://127.0.0.1:{self._listening.getsockname()[1]}"

    def run(self) -> None:
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            with self._lock, contextlib.ExitStack() as closed:
                closed.enter_context(near)
                if self._gone:
                    return
                try:
                    far = socket.create_connection(("127.0.0.1", self._port))
                except OSError:  # the scheduler is gone
                    continue
                closed.pop_all()
                self._ends += [near, far]
            for ends in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=ends, daemon=True).start()

    def _carry(self, source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                target.sendall(data)
            target.shutdown(socket.SHUT_WR)

    def cut(self, for_good: bool = False) -> None:
        with self._lock:  # what is just being connected is cut as well
            if for_good and not self._gone:
                self._gone = True
                with contextlib.suppress(OSError):
                    self._listening.shutdown(socket.SHUT_RDWR)
                self._listening.close()
            for end in self._ends:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
                end.close()
            self._ends.clear()
