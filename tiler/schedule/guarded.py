"""Program of a child of `ChildProcess`, which answers calls from its standard input, or of the server of forks."""

from __future__ import annotations

import faulthandler
import os
import pickle
import queue
import signal
import socket
import sys
import threading
from typing import BinaryIO, NoReturn

from tiler.schedule.fork_server import SERVES, serve
from tiler.schedule.guard import SIZE, limit_memory


def answer_calls(memory_bytes: int | None) -> NoReturn:
    """Answer calls, one after another, until the pipe ends. ``memory_bytes`` limits the memory."""
    # Ctrl-C reaches every process, but only the end of the pipe ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if memory_bytes is not None:
        limit_memory(memory_bytes)
    # Answers go to a copy of the standard output, so that libraries cannot print between them. Calls come from a copy
    # of the standard input: while a thread reads it, Windows does not even tell a library its type.
    answers, calls = os.fdopen(os.dup(1), "wb"), os.fdopen(os.dup(0), "rb")
    os.dup2(2, 1)
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    asked: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(calls, asked), daemon=True).start()
    while True:
        try:
            # The pickle is from the process that started this one.
            function, arguments, seconds = pickle.loads(asked.get())
            _end_after(seconds)
            answer = (True, function(*arguments))
        except BaseException as error:  # noqa: BLE001 - The panic of a decoder is not an Exception.
            answer = (False, _portable(error))
        _end_after(0.0)
        pickle.dump(answer, answers)
        answers.flush()


def _end_after(seconds: float) -> None:
    """End this process after some seconds, even if it hangs in a library and holds Python's lock.

    A time of 0 cancels this.
    """
    if hasattr(signal, "setitimer"):  # This timer needs no Python code to end the process.
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, seconds)
    elif seconds > 0:
        faulthandler.dump_traceback_later(seconds, exit=True)
    else:
        faulthandler.cancel_dump_traceback_later()


def _listen(calls: BinaryIO, asked: queue.SimpleQueue[bytes]) -> None:
    """Read calls into the queue. The end of the pipe ends this process, even during a call."""
    while True:
        size = calls.read(SIZE.size)
        if len(size) < SIZE.size:
            os._exit(0)
        call = calls.read(SIZE.unpack(size)[0])
        if not call:
            os._exit(0)
        asked.put(call)


def _portable(error: BaseException) -> BaseException:
    """Return the exception if it can be pickled, or another one with its text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - Pickling the exception of a library may raise any error.
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


if __name__ == "__main__":
    if SERVES in sys.argv:
        serve(socket.socket(fileno=os.dup(0)), answer_calls)
    answer_calls(int(sys.argv[1]) if len(sys.argv) > 1 else None)
