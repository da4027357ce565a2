"""Calls that may crash, hang or eat memory, in a child process that is used again and replaced when it dies.

A plain child with a pipe, not `multiprocessing`: it neither imports the caller's main module again nor
inherits its threads, and its exit code says what killed it.
"""

from __future__ import annotations

import pickle
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import IO, Any, TypeAlias, TypeVar

from tiler.errors import ConfigError, TilerError
from tiler.schedule.fork_server import FORKS, NOT_STARTED, ForkedChild, child_environment, fork_child

try:
    import resource
except ImportError:  # Windows
    _resource: Any = None
else:
    _resource = resource

Result = TypeVar("Result")
_Child: TypeAlias = "subprocess.Popen[bytes] | ForkedChild"

MEMORY_BYTES = 1 << 30

SIZE = struct.Struct("<Q")
"""Before each call, its bytes: the thread that reads them must not have to import anything."""


class Died(TilerError):
    """The child did not survive a call, or had to be ended; the message is a predicate: "crashed (SIGSEGV)"."""


class NotStartedError(Died):
    """There was no memory or no process for a child: this says nothing about what it was to do."""


class Guard:
    """A child process for calls; started by the first one, ended by `close`. A context manager.

    Parameters
    ----------
    memory_bytes : int or None
        What the child may allocate, where the system can limit that (`limits_memory`); None: anything.
    prepare : callable, optional
        Of a module; called by the process that children are forked from, before it forks: what it does costs once.
    """

    def __init__(
        self, memory_bytes: int | None = MEMORY_BYTES, prepare: Callable[[], None] | None = None
    ) -> None:
        self.memory_bytes, self.prepare = memory_bytes, prepare
        self.killed = False
        self._child: _Child | None = None
        self._began = 0.0
        self._seconds = 0.0

    def __enter__(self) -> Guard:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def call(self, function: Callable[..., Result], *arguments: Any, seconds: float) -> Result:
        """``function(*arguments)``, as the child computes it; one call at a time.

        Parameters
        ----------
        function : callable
            Of a module (it travels by name); arguments and result are pickled.
        seconds : float
            After which the child is taken for hung, and ends.

        Raises
        ------
        Died
            The child crashed, hung, ran out of memory, or was ended by `kill`. The next call gets a new one.
        Exception
            What the function raised.
        """
        try:
            self._ask(function, arguments, seconds)
            return self._answer()  # type: ignore[no-any-return]  # pickle has no types
        except KeyboardInterrupt:
            self.close()  # it still works on this call: its answer must not be taken for the next one's
            raise

    def _ask(self, function: Callable[..., Any], arguments: tuple[Any, ...], seconds: float) -> None:
        """Let the child begin with a call."""
        call = pickle.dumps((function, arguments, seconds))
        if self._child is None:
            self._child = _child(self.memory_bytes, call, self.prepare)
        if self.killed:
            self._child.kill()  # it was not there yet when it was to be
        self._began, self._seconds = time.monotonic(), seconds
        try:
            _pipe(self._child.stdin).write(SIZE.pack(len(call)) + call)
            _pipe(self._child.stdin).flush()
        except OSError:
            return  # it died while it waited: `_answer` says so

    def _answer(self) -> Any:
        """What the call gave; waits for it."""
        assert self._child is not None  # it was just asked
        try:
            fine, result = pickle.load(_pipe(self._child.stdout))  # written by our own child
        except (EOFError, OSError, pickle.UnpicklingError):
            late = time.monotonic() - self._began >= self._seconds
            code = self._end()
            kind = NotStartedError if code == NOT_STARTED else Died
            raise kind(_fate(code, late, self._seconds)) from None
        if fine:
            return result
        if isinstance(result, MemoryError):
            self.close()
            raise Died(f"needs more than the {(self.memory_bytes or 0) >> 20} MiB of memory that it may have")
        raise result

    def kill(self) -> None:
        """End the child from another thread than the one that calls, which learns of it by `Died`; for good."""
        self.killed = True
        child = self._child
        if child is not None:
            child.kill()

    def close(self) -> None:
        """End the child, if there is one, whatever it does."""
        if self._child is not None:
            self._child.kill()
            self._end()

    def leave(self) -> None:
        """As `close`, without waiting until the child has ended: for one that is not in the midst of writing."""
        child = self._child
        if isinstance(child, ForkedChild):
            self._child = None
            child.leave()
        else:
            self.close()

    def _end(self) -> int:
        """Wait for a child that ends and return its exit code."""
        child, self._child = self._child, None
        assert child is not None  # callers looked
        with suppress(OSError):  # what was to be written has no reader any more
            _pipe(child.stdin).close()
        _pipe(child.stdout).close()
        try:
            return child.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            child.kill()
            return child.wait()


def _child(memory_bytes: int | None, call: bytes, prepare: Callable[[], None] | None) -> _Child:
    """Start a child that imports from where this process does, and never from the current folder (``-P``)."""
    if not sys.executable:
        raise ConfigError("no workers can start: Python does not know its own program (sys.executable)")
    if FORKS:
        return fork_child(memory_bytes, call, prepare)
    limit = [] if memory_bytes is None else [str(memory_bytes)]
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "tiler.schedule.guarded", *limit],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=child_environment(),
    )


def _pipe(stream: IO[bytes] | None) -> IO[bytes]:
    if stream is None:
        raise ValueError("the child was started with pipes")
    return stream


def limits_memory() -> bool:
    """Whether this system holds a process to `limit_memory`: Linux alone counts all that it allocates."""
    return _resource is not None and sys.platform == "linux"


def limit_memory(size_bytes: int) -> None:
    """Refuse to allocate more than this in this process, where `limits_memory`; an allocation beyond fails at once."""
    if limits_memory():
        _, hard = _resource.getrlimit(_resource.RLIMIT_DATA)
        size = size_bytes if hard == _resource.RLIM_INFINITY else min(size_bytes, hard)
        _resource.setrlimit(_resource.RLIMIT_DATA, (size, hard))


def _fate(code: int, late: bool, seconds: float) -> str:
    """What the exit code of a child says of its end, worded to follow its name."""
    if (hasattr(signal, "SIGALRM") and code == -signal.SIGALRM) or (code == 1 and late):
        return f"did not end within {seconds:g} s"
    if code == NOT_STARTED:
        return "could not start: the system has no memory left, or allows no more processes"
    if code < 0 and signal.Signals(-code).name == "SIGKILL":
        return "was killed (SIGKILL), as a system does that runs out of memory"
    if code < 0:
        return f"crashed ({signal.Signals(-code).name})"
    return f"crashed (exit code {code})"
