"""Calls that may crash, hang or eat memory, in a child process that is used again and replaced when it dies.

A plain child with a pipe, not `multiprocessing`: it neither imports the caller's main module again nor
inherits its threads, and its exit code says what killed it.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, TypeVar

from tiler.errors import TilerError

Result = TypeVar("Result")

MEMORY_BYTES = 1 << 30


class Died(TilerError):
    """The child did not survive a call, or had to be ended; the message is a predicate: "crashed (SIGSEGV)"."""


class Guard:
    """A child process for calls; started by the first one, ended by `close`. A context manager.

    Parameters
    ----------
    memory_bytes : int
        What the child may allocate (RLIMIT_DATA, where the system enforces it).
    """

    def __init__(self, memory_bytes: int = MEMORY_BYTES) -> None:
        self._memory = memory_bytes
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Guard:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, function: Callable[..., Result], *arguments: Any, seconds: float) -> Result:
        """``function(*arguments)``, as the child computes it.

        Parameters
        ----------
        function : callable
            Of a module (it travels by name); arguments and result are pickled.
        seconds : float
            After which the child is taken for hung, and ends.

        Raises
        ------
        Died
            The child crashed, hung, or ran out of memory. The next call gets a new one.
        Exception
            What the function raised.
        """
        started = time.monotonic()
        child = self._running()
        assert child.stdin is not None  # both are pipes
        assert child.stdout is not None
        try:
            pickle.dump((function, arguments, seconds), child.stdin)
            child.stdin.flush()
            fine, result = pickle.load(child.stdout)  # written by our own child
        except (EOFError, OSError, pickle.UnpicklingError):
            code = self._end(child)
            raise Died(_fate(code, time.monotonic() - started >= seconds, seconds)) from None
        except BaseException:
            self._end(child)  # it still works on this call: its answer must not be taken for the next one's
            raise
        if fine:
            return result  # type: ignore[no-any-return]  # pickle has no types
        if isinstance(result, MemoryError):
            self._end(child)
            raise Died(f"needs more than the {self._memory >> 20} MiB of memory that it may have")
        raise result

    def close(self) -> None:
        """End the child, if there is one."""
        if self._child is not None:
            self._end(self._child)

    def _running(self) -> subprocess.Popen[bytes]:
        if self._child is None:
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p or os.getcwd() for p in sys.path)}
            self._child = subprocess.Popen(
                [sys.executable, "-m", "tiler.schedule.guarded", str(self._memory)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment,
            )  # fmt: skip
        return self._child

    def _end(self, child: subprocess.Popen[bytes]) -> int:
        """Kill the child if it lives; its exit code."""
        self._child = None
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                try:
                    pipe.close()
                except OSError:
                    continue  # what was to be written has no reader any more
        try:
            # A dying child needs a moment; one that lives would wait for work.
            return child.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            child.kill()
            return child.wait()


def _fate(code: int, late: bool, seconds: float) -> str:
    """What an exit code tells, as a predicate."""
    if code == 1 and late:
        return f"did not end within {seconds:g} s"
    if code < 0:
        return f"crashed ({signal.Signals(-code).name})"
    return f"crashed (exit code {code})"
