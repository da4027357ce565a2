"""Who does the tasks of a run: its workers, or workers of this machine for files that those of a cluster do not see."""

from __future__ import annotations

from collections.abc import Callable

from tiler.access import Access
from tiler.places import is_url
from tiler.plan import Plan
from tiler.schedule import Executor, Limits, make_executor

MEMORY_TIMES, MEMORY_MORE_BYTES = 2, 512 << 20
"""A worker that allocates so many times what it is allowed, and more, has gone wrong: the system must not suffer."""


class Crew:
    """The executors of a run, each made when it is first needed.

    Parameters
    ----------
    plan : Plan
    store_url : str
    products : str
        Folder or URL of the files that the run writes.
    note : callable
        Told what is decided for people.
    """

    def __init__(self, plan: Plan, store_url: str, products: str, note: Callable[[str], None]) -> None:
        self._plan, self._store_url, self._products, self._note = plan, store_url, products, note
        self._main: Executor | None = None
        self._here: Executor | None = None
        self._access: Access | None = None

    def executor(self, writes_out: bool = False) -> Executor:
        """Whom to give tasks to.

        Parameters
        ----------
        writes_out : bool
            They write files into OUT.

        Raises
        ------
        ConfigError
            No cluster where one was named, or workers that cannot take part.
        """
        config = self._plan.config
        if self._main is None:
            self._main = self._make(config.scheduler)
            if config.scheduler is not None:
                sources = [
                    (str(s.path if is_url(s.path) else s.path.resolve()), s.size) for s in self._plan.sources
                ]
                self._access = Access(config.scheduler, sources, self._store_url, self._products)
                self._main.on_each_worker(self._access)
        if not writes_out or self._access is None or self._access.out_seen:
            return self._main
        if self._here is None:
            self._note(f"the cluster's workers do not see {self._products}: this machine writes the files")
            self._here = self._make(None)
        return self._here

    def _make(self, scheduler: str | None) -> Executor:
        config, memory = self._plan.config, MEMORY_TIMES * self._plan.memory + MEMORY_MORE_BYTES
        limits = Limits(memory, config.task_seconds)
        return make_executor(self._plan.workers, scheduler, config.in_process, limits)

    def close(self) -> None:
        """Release the workers."""
        for executor in (self._main, self._here):
            if executor is not None:
                executor.close()
