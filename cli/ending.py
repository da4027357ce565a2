"""Ends an interrupted command within seconds: the command may end by itself, and is killed if something hangs."""

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
"""Time after a signal for closing files and for the last line; a batch system kills soon after."""
FORCED = b"tiler: interrupted; the work did not stop, so the process was ended\n"


@dataclass
class Ending:
    """Whether a command got a signal to end; a library may have turned the interruption into another error."""

    own_process: bool = False
    told: bool = False

    def interrupt(self, number: int, frame: object) -> NoReturn:
        """Handle SIGINT or SIGTERM; a second one does not disturb the orderly end, which comes in any case."""
        self.told = True
        signal.signal(number, signal.SIG_IGN)
        if self.own_process:  # objects that a library has half made complain when they are removed
            sys.unraisablehook = lambda _: None
            sys.excepthook = lambda *_: None  # code in C may print an error and go on
        raise KeyboardInterrupt


@contextmanager
def ended_in_time(own_process: bool) -> Iterator[Ending]:
    """Let SIGTERM interrupt a command as Ctrl-C does, and end it within `GRACE_SECONDS` of either signal.

    Python handles a signal between two of its instructions, so not while a library computes, and code that swallows
    the interruption goes on. Therefore the signal itself wakes a thread, which ends this process as a kill would. A
    kill harms no run.

    Parameters
    ----------
    own_process : bool
        Whether the process does nothing but this command. Then its last moments, after the block, are watched as well.
    """
    reading, writing = socket.socketpair()  # not every system has a pipe that does not block
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
        for number, handler in before.items():  # a command that has ended cannot be interrupted
            signal.signal(number, handler)
        if not own_process:
            signal.set_wakeup_fd(woken_before)
            done.set()
            writing.close()  # the thread reads the end, and closes the other one
        else:
            writing.detach()  # stays open to the last


def end_at_once(code: int) -> NoReturn:
    """End this process after its last line, and the children that it was just starting.

    Python's own way out would wait for threads. It would also end with another exit code if the interruption hit code
    that is made at run time, such as that of a dataclass.
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
