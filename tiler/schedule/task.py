"""Tasks, the protocol of their executors, and the executor that runs them in this process.

A task is a pure function of the store: it reads whole arrays, and writes keys that no other
task writes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, Protocol, Self

from tiler.core.records import JoinedRecord, Record, digest_of
from tiler.version import RULES

if TYPE_CHECKING:
    from tiler.core.lattice import Bounds
    from tiler.store import TileStore


P = ParamSpec("P")
Result = Record | Mapping[str, Any]
"""Result of a task, which the store keeps as JSON."""
Work = Callable[..., Result]
"""Function ``work(store, **values)`` of a module, since it is pickled by name."""


@dataclass(frozen=True)
class Call:
    """Function that a worker calls with its store, and the other arguments of the function (see `calling`).

    Attributes
    ----------
    work : callable
    values : mapping
    aside : frozenset of str
        Names of values on which the result does not depend, or whose digest the maker of the task gives.
    """

    work: Work
    values: Mapping[str, Any]
    aside: frozenset[str] = frozenset()

    def without(self, *names: str) -> Self:
        """Leave values out of the digest of the task."""
        return replace(self, aside=frozenset(names))

    @property
    def held(self) -> dict[str, Any]:
        """Values that are in the digest of the task."""
        return {name: value for name, value in self.values.items() if name not in self.aside}


def calling(
    work: Callable[Concatenate[TileStore, P], Result], /, *_: P.args, **values: P.kwargs
) -> Call:
    """Return the call of a function with keyword arguments after the store, whose types are checked."""
    return Call(work, values)


TRIES = 3
"""Number of failed tries after which a task is abandoned and the other tasks continue."""


@dataclass(frozen=True)
class Task:
    """Unit of work, which is resumed and retried as a whole.

    Attributes
    ----------
    stage : str
        Stage of the task. Stage and `key` are the key of the commit in the store.
    key : str
        Name that is unique in the stage and safe as a file name.
    digest : str
        Digest of everything that the result depends on. If a commit has the same digest, the task is done.
    work : Work
        Function that a worker calls with its store and the arguments. The worker commits its result with the digest.
    arguments : mapping of str to object
        Small values that can be pickled.
    points, pixels : int
        Number of points, and of pixels of whole rasters. Their sum measures the work for progress and ETA.
    makes : int
        Number of pixels of the block that the task makes, if points measure the work.
    parts : tuple of Task
        Tasks that this task does together. The item ``parts`` of its record contains their records in the same order,
        and each is committed separately. The task is tried once. If it fails, the parts are done one by one.
    bounds : Bounds or None
        Position of the work in absolute counts, for the message if it fails.
    """

    stage: str
    key: str
    digest: str
    work: Work
    arguments: Mapping[str, Any] = field(default_factory=dict)
    points: int = 0
    pixels: int = 0
    makes: int = 0
    parts: tuple[Task, ...] = ()
    bounds: Bounds | None = None

    @classmethod
    def of(
        cls,
        stage: str,
        key: str,
        call: Call,
        *held: Any,
        rules: str | None = None,
        **given: Any,
    ) -> Self:
        """Return the task of a call.

        Its digest is made from the values and from ``held``, the digests of what the work reads. ``rules`` is
        the version of the rules, by default `RULES`. ``given`` are other attributes.
        """
        digest = digest_of(rules or RULES, call.held, *held)
        return cls(stage, key, digest, call.work, call.values, **given)

    @property
    def tries(self) -> int:
        """Maximum number of tries of the task."""
        return 1 if self.parts else TRIES


@dataclass(frozen=True)
class Outcome:
    """Outcome of a try of a task: its record, or the error.

    Attributes
    ----------
    task : Task
    record : mapping or None
        Result of the work, or None if the try failed.
    error, error_kind : str or None
        Error in one line, and name of its exception.
    seconds : float
        Duration of the try.
    peak_rss_bytes : int
        Largest resident memory of the process.
    again : bool
        Whether a retry could succeed. If it is True in an outcome of `Executor.run`, the executor retries the task.
    fatal : bool
        Whether all other tasks would fail as well.
    damaged : tuple of str
        Objects of the store that the task could not read.
    """

    task: Task
    record: Mapping[str, Any] | None
    error: str | None = None
    error_kind: str | None = None
    seconds: float = 0.0
    peak_rss_bytes: int = 0
    again: bool = False
    fatal: bool = False
    damaged: tuple[str, ...] = ()

    def of_parts(self) -> list[Outcome]:
        """Return the outcomes of the parts of a task, with the time divided in proportion to the points.

        If the task has no parts or failed, the result is only this outcome.
        """
        parts = self.task.parts
        if not parts or self.record is None:
            return [self]
        share = self.seconds / max(sum(part.points for part in parts), 1)
        records: list[Mapping[str, Any]] = JoinedRecord.of(self.record).parts
        return [
            replace(self, task=part, record=record, seconds=share * part.points)
            for part, record in zip(parts, records, strict=True)
        ]


@dataclass(frozen=True)
class TaskLimits:
    """Limits of memory and time for a worker, beyond which it is ended.

    Attributes
    ----------
    memory_bytes : int or None
        Memory that a worker of this machine may allocate, or None for no limit.
    seconds : float
        Time for a task of up to a million points and pixels. Larger tasks have more time in proportion.
    prepare : callable, optional
        Function that the server of forks calls once (see `tiler.schedule.ChildProcess`).
    """

    memory_bytes: int | None = None
    seconds: float = 600.0
    prepare: Callable[[], None] | None = None

    def seconds_of(self, task: Task) -> float:
        """Return the time in seconds after which the worker of a task counts as hung."""
        return self.seconds * max((task.points + task.pixels) / 1e6, 1.0)


TaskRunner = Callable[[str, Task], Outcome]
"""Function ``run_task(store_url, task)`` that runs the work on a worker and commits its record.

It returns an outcome and does not raise an exception if the task fails."""


WorkerCheck = Callable[[Callable[..., Any], str], None]
"""Function ``look(ask, worker)`` that checks a worker.

``ask(function, *arguments)`` returns the result of a function on the worker. An error that ``look`` raises ends the
run."""


@dataclass(frozen=True)
class Machine:
    """Machine of a cluster.

    Attributes
    ----------
    name : str
    memory_bytes : int
        Memory of the machine, or of its container or batch job.
    workers, threads : int
        Number of the cluster's workers on the machine, and of their threads. Each thread does one task at a time.
    """

    name: str
    memory_bytes: int
    workers: int
    threads: int


class Executor(Protocol):
    """Runner of tasks. All executors give the same result."""

    workers: int

    def on_each_worker(self, look: WorkerCheck) -> None:
        """Call `look` for each worker of a cluster, now and when workers join later."""
        ...

    def machines(self) -> list[Machine]:
        """Return the machines of a cluster that have workers now, by name. The list is empty without a cluster."""
        ...

    def run(
        self, run_task: TaskRunner, store_url: str, tasks: Iterable[Task]
    ) -> Iterator[Outcome]:
        """Run tasks, a bounded number at a time, and yield an outcome per try, in any order.

        Raise ConnectionLostError if the connection to a cluster is permanently lost.
        """
        ...

    def close(self) -> None:
        """Release the workers."""
        ...


class SerialExecutor:
    """Executor without workers, which is the simple reference for `DaskExecutor`."""

    workers = 1

    def on_each_worker(self, look: WorkerCheck) -> None:
        """Do nothing, since there are no workers of a cluster."""

    def machines(self) -> list[Machine]:
        """Return an empty list, since there is no cluster."""
        return []

    def run(
        self, run_task: TaskRunner, store_url: str, tasks: Iterable[Task]
    ) -> Iterator[Outcome]:
        """Run tasks and yield outcomes in the order of the tasks."""
        for task in tasks:
            for tries in range(1, task.tries + 1):
                outcome = run_task(store_url, task)
                again = outcome.again and tries < task.tries
                yield replace(outcome, again=again)
                if not again:
                    break

    def close(self) -> None:
        """Do nothing."""
