"""How a command ends: exit codes, and the end of an interrupted command within seconds.

Each error class has its own code (`tiler.errors`). A command may end by itself, and is killed if something hangs.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import NoReturn

import psutil

DONE = 0
USAGE = 2
PROCESSING = 4
PARTIAL = 5
INTERRUPTED = 130

EPILOG = """\b
Exit codes:
  0    done
  2    wrong usage or configuration, or refused by the plan
  3    an input cannot be read, or its CRS cannot be used
  4    processing failed
  5    done, but files, parts of files or tiles were left out, or a required check failed
  130  interrupted by Ctrl-C or SIGTERM; run the same command again to resume
"""


SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name)
)
"""Signals that end a command: Ctrl-C, the end by a batch system, and Ctrl-Break, the only one that Windows sends to a
process in a group of its own."""
GRACE_SECONDS = 4.0
"""Time after a signal for closing files and for the last line.

A batch system kills the process soon after the signal.
"""
FORCED = b"tiler: interrupted; the work did not stop, so the process was ended\n"


@dataclass
class InterruptState:
    """Record of whether a command got a signal to end.

    The error that ends the command is no proof, because a library may turn the interruption
    into another error.
    """

    own_process: bool = False
    told: bool = False

    def interrupt(self, number: int, frame: object) -> NoReturn:
        """Raise KeyboardInterrupt for one of `SIGNALS`.

        A second signal of the same kind is ignored, so that it does not disturb the orderly
        end.
        """
        self.told = True
        signal.signal(number, signal.SIG_IGN)
        if self.own_process:  # incomplete objects of libraries warn when they are deleted
            sys.unraisablehook = lambda _: None
            sys.excepthook = lambda *_: None  # code in C may print an error and go on
        raise KeyboardInterrupt


@contextmanager
def ended_in_time(own_process: bool) -> Iterator[InterruptState]:
    """Let all `SIGNALS` interrupt a command as Ctrl-C does, and end it within `GRACE_SECONDS` of a signal.

    Python handles a signal between two of its instructions, so not while a library computes,
    and code may swallow the interruption. Therefore the signal also wakes a thread, which ends
    this process like a kill if it does not end itself in time. A kill does not damage a run.

    Parameters
    ----------
    own_process : bool
        Whether the process runs only this command. Then the thread also watches the time after the block, until the
        process ends.
    """
    reading, writing = socket.socketpair()  # pipes cannot be non-blocking on every system
    writing.setblocking(False)
    done = threading.Event()
    threading.Thread(
        target=_watch, args=(reading, done), name="tiler-ending", daemon=True
    ).start()
    ending, previous_handlers = (
        InterruptState(own_process),
        {number: signal.getsignal(number) for number in SIGNALS},
    )
    for number, handler in previous_handlers.items():
        # Scripts start background commands with SIGINT ignored. It stays ignored.
        if number != signal.SIGINT or handler is signal.default_int_handler:
            signal.signal(number, ending.interrupt)
    woken_before = signal.set_wakeup_fd(writing.fileno(), warn_on_full_buffer=False)
    try:
        yield ending
    finally:
        for (
            number,
            handler,
        ) in previous_handlers.items():  # the handlers must not act after the command has ended
            signal.signal(number, handler)
        if not own_process:
            signal.set_wakeup_fd(woken_before)
            done.set()
            # the thread then reads the end of the stream, and closes the other socket
            writing.close()
        else:
            writing.detach()  # stays open until the process ends


def end_at_once(code: int) -> NoReturn:
    """Kill the children of this process, flush its output, and end it at once.

    A normal exit of Python would wait for threads. It would also have another exit code if the
    interruption hit code that is generated at run time, such as the methods of a dataclass.
    """
    _end_children()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _end_children() -> None:
    with suppress(psutil.Error):
        for child in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                child.kill()


def _watch(reading: socket.socket, done: threading.Event) -> None:
    while number := reading.recv(1):
        if number[0] in SIGNALS and not done.wait(GRACE_SECONDS):
            _end_children()
            with suppress(OSError):
                os.write(2, FORCED)
            os._exit(INTERRUPTED)
    reading.close()
