"""Guarded calls: one that reads files of unknown origin, and many at the same time, whose results come in their order.

Each has a child process with limits of time and memory.
"""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import psutil

from tiler.errors import InputError, ProcessingError
from tiler.io.locations import reading_remedy, stat_location
from tiler.schedule.guard import (
    MEMORY_BYTES,
    ChildDiedError,
    ChildMemoryError,
    ChildProcess,
    ChildStartError,
)

Result = TypeVar("Result")

MIN_SECONDS = 60.0
BYTES_PER_SECOND = 1e6
"""Lowest speed of reading a whole file. Every disk and decoder is faster."""


def seconds_for(paths: Sequence[Path]) -> float:
    """Return the time that reading some files may take, without missing files. Raise InputError for other errors."""
    size = 0
    for path in paths:
        try:
            size += stat_location(path).st_size
        except (FileNotFoundError, NotADirectoryError):
            continue  # The function that reads the file raises the error.
        except OSError as error:
            remedy = reading_remedy(path, "check its permissions")
            raise InputError(
                f"{path}: cannot be read ({error.strerror or error}); {remedy}"
            ) from error
    return MIN_SECONDS + size / BYTES_PER_SECOND


def call_isolated(
    function: Callable[..., Result],
    *arguments: Any,
    paths: Sequence[Path],
    memory_bytes: int = MEMORY_BYTES,
    seconds: float | None = None,
    remedy: str = "get the file again",
    smaller: str = "give a smaller file, or use a machine with more memory",
) -> Result:
    """Return the result of ``function(*arguments)`` in a separate child process.

    A child is needed since a small file can contain an SQL view that never ends, or state a
    size of a million times a million pixels.

    Parameters
    ----------
    function : callable
        Function of a module, since function, arguments and result are pickled.
    paths : sequence of Path
        Files that the function reads, for messages.
    memory_bytes : int
        Memory that the child may allocate.
    seconds : float, optional
        Time that the call may take. The default depends on the sizes of the files.
    remedy : str
        Advice for the user if reading crashes or takes too long.
    smaller : str
        Advice for the user if reading needs too much memory.

    Raises
    ------
    InputError
        The size of a file cannot be read, or reading crashed, took too long, or needed too much memory.
    Exception
        Exception that the function raised.
    """
    names = ", ".join(map(str, paths))
    if seconds is None:
        seconds = seconds_for(paths)
    try:
        with ChildProcess(memory_bytes) as guard:
            return guard.call(function, *arguments, seconds=seconds)
    except ChildStartError as error:
        raise ProcessingError(
            f"{names}: the process that reads it {error}; end other programs, then run again"
        ) from error
    except ChildMemoryError as died:
        raise InputError(f"{names}: the process that reads it {died}; {smaller}") from died
    except ChildDiedError as died:
        raise InputError(f"{names}: the process that reads it {died}; {remedy}") from died


def half_of_memory() -> int:
    """Return half of this machine's memory in bytes, for reading that needs more memory for more points or blocks."""
    return psutil.virtual_memory().total // 2


Item = TypeVar("Item")

AHEAD = 16
"""Calls per child that may begin before the first result is read, so that one long call does
not stop others."""


class ChildPool:
    """Several `ChildProcess` that work at the same time. Each starts its child when it is first needed.

    The class is a context manager.

    Parameters
    ----------
    count : int
        Number of children.
    memory_bytes : int or None
        Memory that each child may allocate, or None for no limit.
    """

    def __init__(self, count: int, memory_bytes: int | None = MEMORY_BYTES) -> None:
        self._count = count
        self._all = [ChildProcess(memory_bytes) for _ in range(count)]
        self._idle: queue.LifoQueue[ChildProcess] = queue.LifoQueue()
        for guard in self._all:
            self._idle.put(guard)
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="guard")

    def __enter__(self) -> ChildPool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End all children, even during a call."""
        for guard in self._all:
            guard.kill()
        self._threads.shutdown(cancel_futures=True)
        for guard in self._all:
            guard.leave()

    def each(
        self, function: Callable[[ChildProcess, Item], Result], items: Iterable[Item]
    ) -> Iterator[Callable[[], Result]]:
        """Call ``function(child, item)`` for each item, and yield a function per item, in order.

        Each of these functions returns the result of a call, or raises its error.

        Parameters
        ----------
        function : callable
            Function that is called in a thread, with a `ChildProcess` for its work.
        items : iterable
            Items, which are consumed one by one, at most `AHEAD` per child before their results are read.
        """

        def work(item: Item) -> Result:
            guard = self._idle.get()
            try:
                return function(guard, item)
            finally:
                self._idle.put(guard)

        begun: deque[Future[Result]] = deque()
        for item in items:
            if len(begun) == self._count * AHEAD:
                yield begun.popleft().result
            begun.append(self._threads.submit(work, item))
        while begun:
            yield begun.popleft().result
