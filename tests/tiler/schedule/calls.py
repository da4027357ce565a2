"""Functions that tests let workers call: they crash, hang or eat memory."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tiler.errors import InputError
from tiler.schedule import Outcome, Task

CRASHED, ABORTED = (
    ("crashed (access violation, 0xc0000005)", "crashed (abort, 0xc0000409)")
    if os.name == "nt"
    else ("crashed (SIGSEGV)", "crashed (SIGABRT)")
)
"""Ends of `crash` and `abort`."""


def double(value: int) -> int:
    return 2 * value


def pid() -> int:
    return os.getpid()


def fail(text: str) -> NoReturn:
    raise InputError(text)


def fail_with(error: Exception) -> NoReturn:
    raise error


def crash() -> None:
    if os.name == "nt":  # ctypes makes an exception of the fault there
        os.kill(os.getpid(), 0xC0000005)
    ctypes.string_at(0)


def abort() -> None:
    os.kill(os.getpid(), 0xC0000409 if os.name == "nt" else signal.SIGABRT)


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def leave() -> None:
    os._exit(7)


def sleep() -> None:
    time.sleep(900)


def hang_with_the_lock() -> None:
    """Hang in a library that holds the interpreter's lock, so that no Python code can run."""
    if os.name == "nt":
        ctypes.PyDLL("kernel32").Sleep(900_000)
    else:
        ctypes.PyDLL(None).sleep(900)


def allocate(gibibytes: int) -> int:
    return int(np.ones(gibibytes << 27, dtype=np.float64).size)


def allocate_and_wait() -> None:
    """Keep more than half a gibibyte until the process is killed."""
    kept = np.ones(80 << 20, dtype=np.float64)
    while kept.all():
        time.sleep(1)


def allocate_in_a_child_and_wait() -> None:
    """Have a child keep more than half a gibibyte until this process is killed."""
    keep = "import sys; kept = b'x' * (640 << 20); sys.stdin.read()"
    subprocess.Popen([sys.executable, "-c", keep], stdin=subprocess.PIPE).wait()


class Panic(BaseException):
    def __init__(self, one: int, two: int) -> None:
        super().__init__("cannot be unpickled: its arguments are not kept")


def panic() -> NoReturn:
    raise Panic(1, 2)


def chatter() -> str:
    print("between the answers")
    os.write(1, b"and below Python")
    return "answer"


def square(store_url: str, arguments: dict[str, Any]) -> dict[str, Any]:
    """Work of a task, which first does what its arguments say."""
    if "wait" in arguments:
        time.sleep(arguments["wait"])
    name = arguments.get("does")
    tries = Path(store_url, f"tries-{arguments['value']}")
    tries.mkdir(parents=True, exist_ok=True)
    (tries / f"{os.getpid()}-{time.monotonic_ns()}").touch()
    if name and len(list(tries.iterdir())) <= arguments.get("times", 99):
        {
            "leave": leave,
            "kill": kill,
            "crash": crash,
            "sleep": sleep,
            "fail": partial(fail, "cloud.las: bad"),
            "hang": hang_with_the_lock,
            "allocate": partial(allocate, 8),
            "stumble": stumble,
        }[name]()
    return {"square": arguments["value"] ** 2}


def stumble() -> NoReturn:
    raise OSError("a passing fault")


def run_task(store_url: str, task: Task) -> Outcome:
    """Like `tiler.schedule.worker.run_task`, but without a store."""
    try:
        return Outcome(task, task.work(store_url, task.arguments))
    except InputError as error:
        return Outcome(task, None, str(error), "InputError")
    except (OSError, MemoryError) as error:
        return Outcome(task, None, str(error), type(error).__name__, again=True)


_prepared: list[int] = []


def prepare() -> None:
    """Remember which process did this."""
    _prepared.append(os.getpid())


def refuse_forks() -> None:
    """Let all forks but the first one fail, as on a system without free processes."""
    forked = os.fork
    found = []

    def fork() -> int:
        if found:
            raise OSError(errno.EAGAIN, "no process is left")
        found.append(forked())
        return found[0]

    if os.fork.__module__ == "posix":  # not yet
        os.fork = fork


def prepared() -> str:
    """The process that called `prepare`, or None."""
    return "by the server" if _prepared == [os.getppid()] else ""
