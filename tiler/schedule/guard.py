"""Calls in a child process of functions that may crash, hang or exhaust memory. A dead child is replaced.

The child is a plain process with a pipe and not a process of `multiprocessing`. It does not
import the main module of the caller again and does not inherit threads, and its exit code shows
the cause of its death.
"""

from __future__ import annotations

import ctypes
import pickle
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from types import TracebackType
from typing import IO, Any, TypeAlias, TypeVar

import psutil

from tiler.errors import ConfigError, TilerError
from tiler.schedule.fork_server import (
    FORKS,
    NOT_STARTED,
    ForkedChild,
    child_environment,
    fork_child,
)

try:
    import resource
except ImportError:  # Windows does not have this module.
    _resource: Any = None
else:
    _resource = resource

Result = TypeVar("Result")
_Child: TypeAlias = "subprocess.Popen[bytes] | ForkedChild"

MEMORY_BYTES = 1 << 30

GRACE_SECONDS = 60.0
"""Time after the limit of a call, after which the child is killed if it has not ended itself. A stopped child cannot.

The time includes the start of the child and its imports, which take long on the disk of a busy cluster."""

_LOOK_SECONDS = 0.25
"""Interval at which a thread looks at the children at work."""

SIZE = struct.Struct("<Q")
"""Format of the length of a call, which is sent before the call.

With the length, the thread that reads calls need not unpickle them, which would import modules."""


_FAULTS = {
    0xC0000005: "access violation",
    0xC000001D: "illegal instruction",
    0xC00000FD: "stack overflow",
    0xC0000374: "heap corruption",
    0xC0000409: "abort",
}
"""Exit codes of processes that crash on Windows, and their names."""


class ChildDiedError(TilerError):
    """The child died during a call, or had to be ended. The message is a predicate: "crashed (SIGSEGV)"."""


class ChildMemoryError(ChildDiedError):
    """The call needs more memory than the child may have."""


class ChildStartError(ChildDiedError):
    """There was no memory or no process for a child. The call is not the cause."""


class ChildProcess:
    """Child process for calls. The first call starts it, and `close` ends it.

    The class is a context manager.

    Parameters
    ----------
    memory_bytes : int or None
        Memory that the child may allocate, or None for no limit. Where the system cannot limit it (`limits_memory`),
        the child is killed soon after it has more memory than this.
    prepare : callable, optional
        Function of a module that the server of forks calls once, before it forks the children.
    """

    def __init__(
        self, memory_bytes: int | None = MEMORY_BYTES, prepare: Callable[[], None] | None = None
    ) -> None:
        self.memory_bytes = memory_bytes
        self.prepare = prepare
        self.killed = False
        self._child: _Child | None = None
        self._began = 0.0
        self._seconds = 0.0

    def __enter__(self) -> ChildProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def call(self, function: Callable[..., Result], *arguments: Any, seconds: float) -> Result:
        """Return the result of ``function(*arguments)`` in the child. There can be one call at a time.

        Parameters
        ----------
        function : callable
            Function of a module, since it is pickled by name. Arguments and result are pickled, too.
        seconds : float
            Time after which the child counts as hung and ends.

        Raises
        ------
        ChildDiedError
            The child crashed, hung, ran out of memory, or was ended by `kill`. The next call gets a new child.
        Exception
            Exception that the function raised.
        """
        try:
            self._ask(function, arguments, seconds)
            return self._answer()  # type: ignore[no-any-return]  # pickle has no types
        except KeyboardInterrupt:
            # The child still works on this call, and the next call must not get its answer.
            self.close()
            raise

    def _ask(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], seconds: float
    ) -> None:
        call = pickle.dumps((function, arguments, seconds))
        if self._child is None:
            self._child = _child(self.memory_bytes, call, self.prepare)
        if self.killed:
            self._child.kill()  # `kill` was called before there was a child.
        self._began = time.monotonic()
        self._seconds = seconds
        try:
            _pipe(self._child.stdin).write(SIZE.pack(len(call)) + call)
            _pipe(self._child.stdin).flush()
        except OSError:
            return  # The child died while it waited, and `_answer` raises the error.

    def _answer(self) -> Any:
        child = self._child
        assert child is not None  # `_ask` has started the child.
        _AT_WORK.add(child, self._seconds, self.memory_bytes)
        try:
            # The pickle is from the own child.
            fine, result = pickle.load(_pipe(child.stdout))
        except (EOFError, OSError, pickle.UnpicklingError):
            late = time.monotonic() - self._began >= self._seconds
            code = self._end()
            if _AT_WORK.was_too_large(child):
                raise self._too_large() from None
            kind = ChildStartError if code == NOT_STARTED else ChildDiedError
            raise kind(_fate(code, late, self._seconds)) from None
        finally:
            _AT_WORK.discard(child)
        if fine:
            return result
        if isinstance(result, MemoryError):
            self.close()
            raise self._too_large()
        raise result

    def _too_large(self) -> ChildMemoryError:
        mebibytes = (self.memory_bytes or 0) >> 20
        return ChildMemoryError(
            f"needs more than the {mebibytes} MiB of memory that it may have"
        )

    def kill(self) -> None:
        """End the child permanently. Another thread may call this during a call, which then raises `ChildDiedError`."""
        self.killed = True
        child = self._child
        if child is not None:
            child.kill()

    def close(self) -> None:
        """End the child if there is one, even during a call."""
        if self._child is not None:
            self._child.kill()
            self._end()

    def leave(self) -> None:
        """End the child like `close`, but do not wait for its end. The child must not write anything."""
        child = self._child
        if isinstance(child, ForkedChild):
            self._child = None
            child.leave()
        else:
            self.close()

    def _end(self) -> int:
        """Wait for the end of a child, and return its exit code."""
        child, self._child = self._child, None
        assert child is not None  # Callers check this.
        with suppress(OSError):  # Buffered data cannot be written any more.
            _pipe(child.stdin).close()
        _pipe(child.stdout).close()
        for timeout, kill in ((5.0, child.kill), (GRACE_SECONDS, partial(_kill_surely, child))):
            try:
                return child.wait(timeout=timeout)
            except subprocess.TimeoutExpired:
                kill()
        return child.wait()


class _AtWork:
    """Children at work, and a thread that kills those that keep no limit.

    They have neither answered nor ended long after their time, or have too much memory. The limits themselves are the
    task of the child, but a stopped child (SIGSTOP) has no time, and not every system limits memory. One thread for
    all calls costs less than a timer per call.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kills: dict[_Child, tuple[float, Callable[[], None]]] = {}
        self._memory: dict[subprocess.Popen[bytes], int] = {}
        self._too_large: set[_Child] = set()
        self._thread: threading.Thread | None = None

    def add(self, child: _Child, seconds: float, memory_bytes: int | None) -> None:
        """Add a child whose call may take some seconds and some memory."""
        with self._lock:
            self._kills[child] = (time.monotonic() + seconds + GRACE_SECONDS, child.kill)
            if memory_bytes and isinstance(child, subprocess.Popen) and not limits_memory():
                self._memory[child] = memory_bytes
            if self._thread is None or not self._thread.is_alive():  # A fork has no threads.
                self._thread = threading.Thread(target=self._watch, daemon=True)
                self._thread.start()

    def discard(self, child: _Child) -> None:
        """Remove a child, which after that is not killed."""
        with self._lock:
            self._kills.pop(child, None)
            self._too_large.discard(child)
            if isinstance(child, subprocess.Popen):
                self._memory.pop(child, None)

    def was_too_large(self, child: _Child) -> bool:
        """Return whether a child was killed because it had too much memory."""
        with self._lock:
            return child in self._too_large

    def _watch(self) -> None:
        while True:
            time.sleep(_LOOK_SECONDS)
            now = time.monotonic()
            with self._lock:
                for child, (due, kill) in self._kills.items():
                    if now >= due:
                        kill()
                        self._kills[child] = now + GRACE_SECONDS, partial(_kill_surely, child)
                for process, memory_bytes in self._memory.items():
                    if _resident_bytes(process.pid) > memory_bytes:
                        self._too_large.add(process)
                        process.kill()


_AT_WORK = _AtWork()


def _resident_bytes(pid: int) -> int:
    """Return the resident memory of a process and its descendants in bytes. Those that have ended count as 0.

    In a virtual environment on Windows, the process is a launcher, and Python is its child.
    """
    total = 0
    with suppress(psutil.Error):
        process = psutil.Process(pid)
        for each in (process, *process.children(recursive=True)):
            with suppress(psutil.Error):
                total += int(each.memory_info().rss)
    return total


def _kill_surely(child: _Child) -> None:
    """Kill a child, and the server of a forked child with it, which may be stopped as well."""
    if isinstance(child, ForkedChild):
        child.kill_server()
    else:
        child.kill()


def _child(memory_bytes: int | None, call: bytes, prepare: Callable[[], None] | None) -> _Child:
    """Start a child with the import path of this process and without the current folder (``-P``)."""
    if not sys.executable:
        raise ConfigError(
            "workers cannot start: sys.executable is empty; start tiler with a Python program"
        )
    if FORKS:
        return fork_child(memory_bytes, call, prepare)
    limit = [] if memory_bytes is None else [str(memory_bytes)]
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", "tiler.schedule.guarded", *limit],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=child_environment(),
    )
    if sys.platform == "win32":
        _end_with_this_process(child)
    return child


if sys.platform == "win32":

    @cache
    def _job() -> ctypes.c_void_p:
        """Return a job of Windows, which ends its processes when the last handle of the job is closed."""
        kernel = ctypes.WinDLL("kernel32")
        kernel.CreateJobObjectW.restype = ctypes.c_void_p
        job = ctypes.c_void_p(kernel.CreateJobObjectW(None, None))
        # A JOBOBJECT_EXTENDED_LIMIT_INFORMATION with JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE alone.
        limits = struct.pack("<16xI124x", 0x2000)
        kernel.SetInformationJobObject(job, 9, limits, len(limits))
        return job

    def _end_with_this_process(child: Any) -> None:
        """Let Windows end a child when this process has ended, even if the child hangs and holds Python's lock.

        Where Windows refuses this, the child ends at the limit of its call.
        """
        handle = ctypes.c_void_p(int(child._handle))  # a child of `subprocess.Popen`
        ctypes.WinDLL("kernel32").AssignProcessToJobObject(_job(), handle)


def _pipe(stream: IO[bytes] | None) -> IO[bytes]:
    if stream is None:
        raise ValueError("the child must be started with pipes")
    return stream


def limits_memory() -> bool:
    """Return whether `limit_memory` works on this system. Only Linux counts all memory that a process allocates."""
    return _resource is not None and sys.platform == "linux"


def limit_memory(size_bytes: int) -> None:
    """Limit the memory of this process, if `limits_memory`. An allocation beyond the limit then fails immediately."""
    if limits_memory():
        _, hard = _resource.getrlimit(_resource.RLIMIT_DATA)
        size = size_bytes if hard == _resource.RLIM_INFINITY else min(size_bytes, hard)
        _resource.setrlimit(_resource.RLIMIT_DATA, (size, hard))


def _fate(code: int, late: bool, seconds: float) -> str:
    """Return the end of a child by its exit code, as a predicate for messages."""
    if code == NOT_STARTED:
        return "could not start: the system has no memory left, or allows no more processes"
    cause = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    if code in _FAULTS:
        cause = f"{_FAULTS[code]}, {code:#x}"
    if cause == "SIGALRM" or (late and cause in ("SIGKILL", "exit code 1")):
        return f"did not end within {seconds:g} s"
    if cause == "SIGKILL":
        return "was killed (SIGKILL), probably because memory ran out"
    return f"crashed ({cause})"
