"""The command line in forks of a warm process: imports and kernels, most of a small command, are loaded only once.

``python -m tests.docs.resident SOCKET`` serves until its stdin ends. A client sends its streams, folder, environment
and arguments, and receives the exit code. A run does its work in the fork itself (``--in-process``).
"""

from __future__ import annotations

import importlib
import json
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

CLIENT = """#!{python} -SE
import json, os, socket, sys
call = json.dumps([os.getcwd(), dict(os.environ), sys.argv[1:]]).encode()
with socket.socket(socket.AF_UNIX) as line:
    line.connect({address!r})
    socket.send_fds(line, [len(call).to_bytes(8, "little")], [0, 1, 2])
    line.sendall(call)
    sys.exit(int(line.makefile().readline()))
"""
"""The program `tiler`: it starts in milliseconds, as it imports nothing of ours."""


def write_client(path: Path, address: Path) -> None:
    """Write the program that asks the server at an address."""
    path.write_text(CLIENT.format(python=sys.executable, address=str(address)))
    path.chmod(0o755)


def serve(address: str) -> None:
    """Answer each client in a fork, until stdin ends."""
    warm()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address)
        listening.listen()
        while True:
            ready, _, _ = select.select([listening, sys.stdin], [], [])
            if sys.stdin in ready:
                return
            line, _ = listening.accept()
            with line:
                if os.fork() == 0:
                    answer(line)
            reap()


def warm() -> None:
    """Load everything, with the kernels. No store is opened: zarr's thread would be missing in the forks."""
    from cli.main import COMMANDS, STAGES
    from ptd import precompile
    from tiler import preparation

    for name in COMMANDS.keys() - set(STAGES):
        importlib.import_module(f"cli.commands.{name}")
    for name in ("filter", "pipeline", "report.html", "simulate"):
        importlib.import_module(f"tiler.{name}")
    preparation.import_stages()
    preparation.import_libraries()
    with mock.patch.object(precompile, "compile_once", _always):
        precompile.warm_filters("auto", _silent)
        precompile.warm_gridding("linear", _silent)
    run_in_process()


def _silent() -> None:
    """Say nothing."""


def _always(name: str, tell: Callable[[], None], work: Callable[[], None]) -> None:
    """Do the work that loads kernels, although they are compiled."""
    work()


def run_in_process() -> None:
    """Let all settings of commands have the default ``in_process = true``."""
    from tiler.config import RunConfig

    parse = RunConfig.from_mapping.__func__  # type: ignore[attr-defined]

    def from_mapping(cls: type[RunConfig], data: Mapping[str, Any]) -> Any:
        return parse(cls, {"in_process": True, **data})

    RunConfig.from_mapping = classmethod(from_mapping)  # type: ignore[method-assign, assignment]


def answer(line: socket.socket) -> None:
    """Do what a client asks, and end this process."""
    size, streams, _, _ = socket.recv_fds(line, 8, 3)
    call = line.makefile("rb").read(int.from_bytes(size, "little"))
    folder, environment, arguments = json.loads(call)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["tiler", *arguments]
    code = code_of_command()
    line.sendall(f"{code}\n".encode())
    os._exit(code)


def code_of_command() -> int:
    from cli.main import main

    try:
        code: Any = main()
    except SystemExit as ended:
        code = ended.code
    sys.stdout.flush()
    sys.stderr.flush()
    return int(code or 0)


def reap() -> None:
    """Forget forks that have ended."""
    while True:
        try:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                return
        except ChildProcessError:
            return


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve(sys.argv[1])
