"""Ends an interrupted command within seconds: it may end by itself, and is killed if something hangs."""

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

from cli import exit_codes

SIGNALS = (signal.SIGINT, signal.SIGTERM)
GRACE_SECONDS = 4.0
"""After a signal, for what a command has to close and to say; a batch system kills soon after."""
FORCED = b"tiler: interrupted; what it was at did not stop, so it was ended\n"


@dataclass
class Ending:
    """Whether a command was told to end: a library that was called may have made another error of that."""

    own_process: bool = False
    told: bool = False

    def interrupt(self, number: int, frame: object) -> NoReturn:
        """Handle SIGINT or SIGTERM; a second one must not disturb the end, of which it is seen to that it comes."""
        self.told = True
        signal.signal(number, signal.SIG_IGN)
        if self.own_process:  # what a library was just making is half made, and complains when it goes
            sys.unraisablehook = lambda _: None
            sys.excepthook = lambda *_: None  # of code in C that prints an error, and goes on
        raise KeyboardInterrupt


@contextmanager
def ended_in_time(own_process: bool) -> Iterator[Ending]:
    """Let SIGTERM interrupt a command as Ctrl-C does, and see to it that it ends within `GRACE_SECONDS` of either.

    Python tells of a signal between two of its instructions: not while a library computes, and code that swallows the
    interruption goes on. So a thread is woken by the signal itself. It ends this process as a kill would, which no run
    is harmed by.

    Parameters
    ----------
    own_process : bool
        The command is all that this process does: its last moments, after the block, are watched as well.
    """
    reading, writing = socket.socketpair()  # a pipe that does not block is not to be had everywhere
    writing.setblocking(False)
    done = threading.Event()
    threading.Thread(target=_watch, args=(reading, done), name="tiler-ending", daemon=True).start()
    ending, before = Ending(own_process), {number: signal.getsignal(number) for number in SIGNALS}
    signal.signal(signal.SIGTERM, ending.interrupt)
    if before[signal.SIGINT] is signal.default_int_handler:  # not ignored, as in the background of a script
        signal.signal(signal.SIGINT, ending.interrupt)
    woken_before = signal.set_wakeup_fd(writing.fileno(), warn_on_full_buffer=False)
    try:
        yield ending
    finally:
        for number, handler in before.items():  # what is done cannot be interrupted any more
            signal.signal(number, handler)
        if not own_process:
            signal.set_wakeup_fd(woken_before)
            done.set()
            writing.close()  # the thread reads the end, and closes the other one
        else:
            writing.detach()  # stays open to the last


def end_at_once(code: int) -> NoReturn:
    """End this process, once all is said, and the children that it was just starting.

    Not by Python's way out: that waits for threads, and where the interruption hit code that was made while it ran, as
    a dataclass is, it ends with another code.
    """
    _end_children()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _end_children() -> None:
    """Kill the processes that this one started, and theirs."""
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
            os._exit(exit_codes.INTERRUPTED)
    reading.close()
