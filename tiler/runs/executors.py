"""Chooses the workers for the tasks of a run: those asked for, or local ones for files that these cannot see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from tiler.io.locations import location
from tiler.plan import Plan, projected_memory
from tiler.runs.cluster_check import Access
from tiler.runs.worker import prepare
from tiler.schedule import Executor, Limits, Machine, make_executor
from tiler.store import store_exists

MEMORY_TIMES, MEMORY_MORE_BYTES = 2, 512 << 20
"""A worker that allocates so many times what it is allowed, and more, has gone wrong: the system must not suffer."""


@dataclass(frozen=True)
class Cluster:
    """What the plan says of a cluster.

    Attributes
    ----------
    machines : list of Machine
    out_seen : bool
        Its workers can write into OUT: else this machine does.
    """

    machines: list[Machine]
    out_seen: bool

    def lines(self, need_bytes: int) -> list[str]:
        """The cluster in lines of text for people."""
        workers, threads = sum(m.workers for m in self.machines), sum(m.threads for m in self.machines)
        least = min(m.memory_bytes // m.threads for m in self.machines)
        found = [
            f"cluster     {workers} workers for {threads} tasks at a time on {len(self.machines)} machines; "
            f"{least / 2**20:,.0f} MiB for each task at least, {need_bytes / 2**20:,.0f} MiB needed; "
            "all have these versions and read the inputs"
        ]
        if not self.out_seen:
            found.append(
                "note        the cluster's workers do not see OUT: this machine would write the files"
            )
        return found

    def to_json(self) -> dict[str, Any]:
        """The cluster as JSON-able values."""
        return {"machines": [asdict(machine) for machine in self.machines], "out_seen": self.out_seen}


def look_at_cluster(plan: Plan, store_url: str | None, products: str | None) -> tuple[Plan, Cluster]:
    """The plan of a run on the cluster that it names, and what that has.

    Parameters
    ----------
    plan : Plan
    store_url, products : str or None
        As of `Crew`, where they are known already. There, a file without bytes is written and removed again.

    Raises
    ------
    ConfigError
        No cluster there, or one whose workers cannot take part.
    """
    executor = _executor(plan, plan.config.scheduler)
    try:
        access, machines = _look_at_workers(plan, executor, store_url, products)
    finally:
        executor.close()
    threads = sum(machine.threads for machine in machines)
    return replace(plan, workers=threads), Cluster(machines, access.out_seen)


def _look_at_workers(
    plan: Plan, executor: Executor, store_url: str | None, products: str | None
) -> tuple[Access, list[Machine]]:
    """Judge the workers of a cluster, now and as they join, and the memory of their machines."""
    sources = [(location(s.path), s.state) for s in plan.sources]
    there = store_url is not None and store_exists(store_url)
    access = Access(str(plan.config.scheduler), sources, store_url, products, there)
    executor.on_each_worker(access)
    machines = executor.machines()
    access.refuse_small(machines, max(projected_memory(plan).values()))
    return access, machines


def _executor(plan: Plan, scheduler: str | None) -> Executor:
    config, memory = plan.config, MEMORY_TIMES * plan.memory + MEMORY_MORE_BYTES
    limits = Limits(memory, config.task_seconds, partial(prepare, plan.memory))
    return make_executor(plan.workers, scheduler, config.in_process, limits)


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
        """The executor to give tasks to.

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
                self._access = _look_at_workers(self._plan, self._main, self._store_url, self._products)[0]
        if not writes_out or self._access is None or self._access.out_seen:
            return self._main
        if self._here is None:
            self._note(f"the cluster's workers do not see {self._products}: this machine writes the files")
            self._here = self._make(None)
        return self._here

    def _make(self, scheduler: str | None) -> Executor:
        return _executor(self._plan, scheduler)

    def close(self) -> None:
        """Release the workers, those that were made last first."""
        for executor in (self._here, self._main):
            if executor is not None:
                executor.close()
