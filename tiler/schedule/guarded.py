"""The child of a `Guard`: answers calls from its standard input until that ends; or the process that forks such."""

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
    """Answer calls, one after another, until there are no more; with so much memory at most."""
    # Ctrl-C reaches every process; the end of the pipe ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if memory_bytes is not None:
        limit_memory(memory_bytes)
    # What libraries print must not come between the answers.
    answers, calls = os.fdopen(os.dup(1), "wb"), os.fdopen(0, "rb", closefd=False)
    os.dup2(2, 1)
    asked: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(calls, asked), daemon=True).start()
    while True:
        try:
            function, arguments, seconds = pickle.loads(asked.get())  # of the process that started this one
            _end_after(seconds)
            answer = (True, function(*arguments))
        except BaseException as error:  # noqa: BLE001 - a decoder may panic with what is no Exception
            answer = (False, _portable(error))
        _end_after(0.0)
        pickle.dump(answer, answers)
        answers.flush()


def _end_after(seconds: float) -> None:
    """Have this process ended in so many seconds, even if it hangs in a library and holds Python's lock; 0: do not."""
    if hasattr(signal, "setitimer"):  # the system ends it: nothing of this process has to run for that
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, seconds)
    elif seconds > 0:
        faulthandler.dump_traceback_later(seconds, exit=True)
    else:
        faulthandler.cancel_dump_traceback_later()


def _listen(calls: BinaryIO, asked: queue.SimpleQueue[bytes]) -> None:
    """Read calls; the end of the pipe is the end of the process that asks, and of this one in the midst of its work."""
    while True:
        size = calls.read(SIZE.size)
        call = calls.read(SIZE.unpack(size)[0]) if len(size) == SIZE.size else b""
        if not call:
            os._exit(0)
        asked.put(call)


def _portable(error: BaseException) -> BaseException:
    """The exception itself if it can be unpickled, else one with its text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - anything may go wrong with a foreign exception
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


if __name__ == "__main__":
    if SERVES in sys.argv:
        serve(socket.socket(fileno=os.dup(0)), answer_calls)
    answer_calls(int(sys.argv[1]) if len(sys.argv) > 1 else None)
