"""Parallel guarded calls, each in a child process. Results come in the order of the calls."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import TypeVar

from tiler.schedule.guard import MEMORY_BYTES, ChildProcess

Item = TypeVar("Item")
Result = TypeVar("Result")

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
