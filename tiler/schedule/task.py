"""Tasks, and the protocol of their executors.

A task is a pure function of the store: it reads whole arrays, and writes keys that no other task writes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from tiler.redaction import stored

if TYPE_CHECKING:  # numpy is loaded later, while the children start
    from tiler.core.lattice import Bounds, Lattice

Work = Callable[[str, Any], dict[str, Any]]
"""``work(store_url, arguments) -> record``: a function of a module, since it is pickled by name. The arguments are a
frozen dataclass that defines what is read and written, and with which parameters; the record is JSON-able."""

NOT_IN_DIGEST = {"digest": False}
"""Metadata of a field in the arguments that changes how the work is done, but not its result."""


@runtime_checkable
class Placed(Protocol):
    """Arguments of work that has a place on the map."""

    def place(self, buckets: Lattice) -> Bounds | None:
        """The bounds of the work, in absolute counts; ``buckets`` is the lattice of the store's buckets."""
        ...


TRIES = 3
"""A task that failed so many times is given up, and the other tasks go on."""


@dataclass(frozen=True)
class Task:
    """One unit of work, which is resumed and tried again as a whole.

    Attributes
    ----------
    stage : str
        Stage of the task; with `key` it names the commit in the store.
    key : str
        Name that is unique in the stage and safe as a file name.
    digest : str
        Digest of everything that the result depends on. If a commit has the same digest, the task is done.
    work : Work
        The function that a worker calls; the worker commits its result with the digest.
    arguments : dataclass
        Argument of `work`: frozen, small, with values that `digest_of` knows.
    points : int
        Number of points, which measures the work for progress and ETA.
    parts : tuple of Task
        Tasks that this one does together. Its record holds their records in the same order, as ``parts``, and each is
        committed by itself. The task is tried once; if it fails, the parts are done one by one.
    """

    stage: str
    key: str
    digest: str
    work: Work
    arguments: Any = None
    points: int = 0
    parts: tuple[Task, ...] = ()

    @property
    def tries(self) -> int:
        """Most tries of the task."""
        return 1 if self.parts else TRIES


@dataclass(frozen=True)
class Outcome:
    """Outcome of one try of a task: its record, or the error.

    Attributes
    ----------
    task : Task
    record : dict or None
        Result of the work; None if the try failed.
    error, error_kind : str or None
        The error in one line, and the name of its exception.
    seconds : float
    peak_rss_bytes : int
    again : bool
        Whether another try could help. If an executor yields it, another try follows.
    fatal : bool
        Whether no other task can succeed either.
    damaged : tuple of str
        Objects of the store that the task could not read.
    """

    task: Task
    record: dict[str, Any] | None
    error: str | None = None
    error_kind: str | None = None
    seconds: float = 0.0
    peak_rss_bytes: int = 0
    again: bool = False
    fatal: bool = False
    damaged: tuple[str, ...] = ()

    def of_parts(self) -> list[Outcome]:
        """Outcomes of the parts of a task, with the time divided by points; without parts, or failed, the outcome."""
        parts = self.task.parts
        if not parts or self.record is None:
            return [self]
        share = self.seconds / max(sum(part.points for part in parts), 1)
        return [
            replace(self, task=part, record=record, seconds=share * part.points)
            for part, record in zip(parts, self.record["parts"], strict=True)
        ]


@dataclass(frozen=True)
class Limits:
    """Limits of memory and time for a worker; beyond them it is ended.

    Attributes
    ----------
    memory_bytes : int or None
        Memory that a worker of this machine may allocate; None for no limit.
    seconds : float
        Time for a task of up to a million points; larger tasks have more in proportion.
    prepare : callable, optional
        See `tiler.schedule.Guard`.
    """

    memory_bytes: int | None = None
    seconds: float = 600.0
    prepare: Callable[[], None] | None = None

    def seconds_of(self, task: Task) -> float:
        """Time after which the worker of a task counts as hung."""
        return self.seconds * max(task.points / 1e6, 1.0)


Perform = Callable[[str, Task], Outcome]
"""``perform(store_url, task)`` runs the work on a worker and commits its record; a failed task is no exception."""


Look = Callable[[Callable[..., Any], str], None]
"""``look(ask, worker)`` checks a worker, with ``ask(function, *arguments)`` for the result of a function there; it
raises an error to end the run."""


@dataclass(frozen=True)
class Machine:
    """A machine of a cluster.

    Attributes
    ----------
    name : str
    memory_bytes : int
        Memory of the machine, or of its container or batch job.
    workers, threads : int
        Workers of the cluster on the machine, and their threads, which do one task at a time each.
    """

    name: str
    memory_bytes: int
    workers: int
    threads: int


class Executor(Protocol):
    """Runs tasks; all executors give the same result."""

    workers: int

    def on_each_worker(self, look: Look) -> None:
        """Call `look` for each worker of a cluster, now and when workers join later."""
        ...

    def machines(self) -> list[Machine]:
        """The machines of a cluster that have workers now, by name; empty without a cluster."""
        ...

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Run tasks, a bounded number at a time, and yield an outcome for each try, in any order.

        Raises ConnectionLostError if the connection to a cluster is lost for good.
        """
        ...

    def close(self) -> None:
        """Release the workers."""
        ...


def digest_of(*parts: Any) -> str:
    """A short stable digest of JSON-able values and dataclasses, without fields that are `NOT_IN_DIGEST`.

    The order of keys, and passwords and tokens in URLs, do not change it.
    """
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=to_json)
    if ":/" in text:
        text = json.dumps(stored(json.loads(text)), sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def to_json(value: Any) -> Any:
    """Convert a value in the arguments of a task for JSON: a dataclass to its fields, a fraction to text."""
    if isinstance(value, Fraction):
        return str(value)
    if is_dataclass(value):
        return {f.name: getattr(value, f.name) for f in fields(value) if f.metadata.get("digest", True)}
    raise TypeError(f"{type(value).__name__} has no place in the arguments of a task")
