"""The child of a `Guard`: answers calls from its standard input until that ends."""

from __future__ import annotations

import faulthandler
import os
import pickle
import resource
import signal
import sys


def main() -> None:
    """Answer calls, one after another."""
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # Ctrl-C reaches every process; the end of the pipe ends this one
    limit_memory(int(sys.argv[1]))
    # What libraries print must not come between the answers.
    answers, calls = os.fdopen(os.dup(1), "wb"), sys.stdin.buffer
    os.dup2(2, 1)
    while True:
        try:
            function, arguments, seconds = pickle.load(calls)  # of the process that started this one
        except EOFError:
            return
        # A thread of C, which also ends a process that hangs in a library while it holds the interpreter's lock.
        faulthandler.dump_traceback_later(seconds, exit=True)
        try:
            answer = (True, function(*arguments))
        except BaseException as error:  # noqa: BLE001 - a decoder may panic with what is no Exception
            answer = (False, _portable(error))
        faulthandler.cancel_dump_traceback_later()
        pickle.dump(answer, answers)
        answers.flush()


def limit_memory(size_bytes: int) -> None:
    """Refuse to allocate more than this in this process; an allocation beyond fails at once."""
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    size = size_bytes if hard == resource.RLIM_INFINITY else min(size_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (size, hard))


def _portable(error: BaseException) -> BaseException:
    """The exception itself if it can be unpickled, else one with its text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - anything may go wrong with a foreign exception
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


if __name__ == "__main__":
    main()
