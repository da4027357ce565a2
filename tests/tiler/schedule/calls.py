"""What tests let workers do, by name: crash, hang, eat memory."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from typing import NoReturn

import numpy as np

from tiler.errors import InputError


def double(value: int) -> int:
    return 2 * value


def pid() -> int:
    return os.getpid()


def fail(text: str) -> NoReturn:
    raise InputError(text)


def crash() -> None:
    ctypes.string_at(0)


def abort() -> None:
    os.kill(os.getpid(), signal.SIGABRT)


def leave() -> None:
    os._exit(7)


def sleep() -> None:
    time.sleep(60)


def hang_with_the_lock() -> None:
    """In a library that keeps the interpreter's lock: no Python code can run in any thread."""
    ctypes.PyDLL(None).sleep(60)


def allocate(gibibytes: int) -> int:
    return int(np.ones(gibibytes << 27, dtype=np.float64).size)


class Panic(BaseException):
    def __init__(self, one: int, two: int) -> None:
        super().__init__("cannot be unpickled: its arguments are not kept")


def panic() -> NoReturn:
    raise Panic(1, 2)


def chatter() -> str:
    print("between the answers")
    os.write(1, b"and below Python")
    return "answer"
