"""Runs guarded calls in parallel, each in a child process; results come in the order of the calls."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import TypeVar

from tiler.schedule.guard import MEMORY_BYTES, Guard

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 16
"""Calls a child that are begun before the first of them was taken: one that takes long does not hold up the others."""


class Guards:
    """Some `Guard`, of which each starts its child when it is first needed. A context manager.

    Parameters
    ----------
    count : int
        That work at a time.
    memory_bytes : int or None
        What each child may allocate.
    """

    def __init__(self, count: int, memory_bytes: int | None = MEMORY_BYTES) -> None:
        self._count = count
        self._all = [Guard(memory_bytes) for _ in range(count)]
        self._idle: queue.LifoQueue[Guard] = queue.LifoQueue()
        for guard in self._all:
            self._idle.put(guard)
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="guard")

    def __enter__(self) -> Guards:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all children, whatever they do."""
        for guard in self._all:
            guard.kill()
        self._threads.shutdown(cancel_futures=True)
        for guard in self._all:
            guard.leave()

    def each(
        self, function: Callable[[Guard, Item], Result], items: Iterable[Item]
    ) -> Iterator[Callable[[], Result]]:
        """``function(guard, item)`` for each item, in their order, each as a call that returns its result or raises.

        Parameters
        ----------
        function : callable
            Called in a thread, with a guard of its own; what it asks it for is done in the child.
        items : iterable
            Taken as there is room: at most `AHEAD` a child are begun and not taken.
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
