"""Executors of a run: the requested workers, and local ones for files that a cluster cannot write."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from tiler.io.locations import location
from tiler.plan import Plan, projected_memory
from tiler.schedule import Executor, Machine, TaskLimits, make_executor
from tiler.schedule.cluster_check import ClusterAccess
from tiler.schedule.worker import prepare
from tiler.store import store_exists

# A worker fails if it needs more than MEMORY_TIMES times the planned memory plus
# MEMORY_MORE_BYTES: it is faulty.
MEMORY_TIMES = 2
MEMORY_MORE_BYTES = 512 << 20


@dataclass(frozen=True)
class Cluster:
    """Description of a cluster for the plan.

    Attributes
    ----------
    machines : list of Machine
    out_seen : bool
        Whether the workers can write into OUT. If not, this machine writes the files.
    """

    machines: list[Machine]
    out_seen: bool

    def lines(self, need_bytes: int) -> list[str]:
        """Return the cluster as lines of text."""
        workers = sum(m.workers for m in self.machines)
        threads = sum(m.threads for m in self.machines)
        least = min(m.memory_bytes // m.threads for m in self.machines)
        found = [
            f"cluster     {workers} workers for {threads} concurrent tasks on {len(self.machines)} machines; "
            f"{least / 2**20:,.0f} MiB or more per task, {need_bytes / 2**20:,.0f} MiB needed; "
            "all have the same versions as this machine and can read the inputs"
        ]
        if not self.out_seen:
            found.append(
                "note        the workers of the cluster cannot write into OUT, so this machine would write the files"
            )
        return found

    def to_json(self) -> dict[str, Any]:
        """Return the cluster as JSON-able values."""
        return {
            "machines": [asdict(machine) for machine in self.machines],
            "out_seen": self.out_seen,
        }


def look_at_cluster(
    plan: Plan, store_url: str | None, products: str | None
) -> tuple[Plan, Cluster]:
    """Return the plan with the workers of its cluster, and the cluster.

    Parameters
    ----------
    plan : Plan
    store_url, products : str or None
        Locations of the store and the results (see `Executors`); None if unknown. Each worker writes a small file
        there and removes it.

    Raises
    ------
    ConfigError
        There is no cluster, or a worker cannot take part.
    """
    executor = _executor(plan, plan.config.scheduler)
    try:
        access, machines = _look_at_workers(plan, executor, store_url, products)
    finally:
        executor.close()
    threads = sum(machine.threads for machine in machines)
    resources = replace(plan.resources, workers=threads)
    return replace(plan, resources=resources), Cluster(machines, access.out_seen)


def _look_at_workers(
    plan: Plan, executor: Executor, store_url: str | None, products: str | None
) -> tuple[ClusterAccess, list[Machine]]:
    """Check the workers of a cluster, now and when they join, and the memory of their machines."""
    sources = [(location(s.path), s.state) for s in plan.inputs.sources]
    there = store_url is not None and store_exists(store_url)
    access = ClusterAccess(str(plan.config.scheduler), sources, store_url, products, there)
    executor.on_each_worker(access)
    machines = executor.machines()
    access.validate_memory(machines, max(projected_memory(plan).values()))
    return access, machines


def _executor(plan: Plan, scheduler: str | None) -> Executor:
    config = plan.config
    memory = MEMORY_TIMES * plan.resources.memory + MEMORY_MORE_BYTES
    limits = TaskLimits(memory, config.task_seconds, partial(prepare, plan.resources.memory))
    return make_executor(plan.resources.workers, scheduler, config.in_process, limits)


class Executors:
    """Executors of a run, each made when it is first needed.

    Parameters
    ----------
    plan : Plan
    store_url : str
    products : str
        Folder or URL of the files that the run writes.
    note : callable
        Function that receives notes for the user.
    """

    def __init__(
        self, plan: Plan, store_url: str, products: str, note: Callable[[str], None]
    ) -> None:
        self._plan = plan
        self._store_url = store_url
        self._products = products
        self._note = note
        self._main: Executor | None = None
        self._here: Executor | None = None
        self._access: ClusterAccess | None = None

    def choose(self, writes_out: bool = False) -> Executor:
        """Return the executor for some tasks.

        Parameters
        ----------
        writes_out : bool
            Whether the tasks write files into OUT.

        Raises
        ------
        ConfigError
            The cluster does not exist, or a worker cannot take part.
        """
        scheduler = self._plan.config.scheduler
        if self._main is None:
            self._main = _executor(self._plan, scheduler)
            if scheduler is not None:
                self._access, _ = _look_at_workers(
                    self._plan, self._main, self._store_url, self._products
                )
        if not writes_out or self._access is None or self._access.out_seen:
            return self._main
        if self._here is None:
            self._note(
                f"the workers of the cluster cannot write into {self._products}, so this machine writes the files"
            )
            self._here = _executor(self._plan, None)
        return self._here

    def close(self) -> None:
        """Release the workers of all executors, in reverse order."""
        for executor in (self._here, self._main):
            if executor is not None:
                executor.close()
