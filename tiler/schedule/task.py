"""A task: a pure function of the store. It reads whole arrays and writes keys that no other task writes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from tiler.redaction import stored

if TYPE_CHECKING:  # numpy is not loaded before the children are on their way
    from tiler.core.lattice import Bounds, Lattice

Work = Callable[[str, Any], dict[str, Any]]
"""``work(store_url, arguments) -> record``: a module-level function (it travels by name), of a frozen dataclass that
says what is read, what is written, where, and with which parameters; the record is JSON-able."""

NOT_IN_DIGEST = {"digest": False}
"""Metadata of a field of such a dataclass that changes how the work is done, but not what comes out."""


@runtime_checkable
class Placed(Protocol):
    """Arguments of work that has a place on the map."""

    def place(self, buckets: Lattice) -> Bounds | None:
        """What the work covers, absolute counts; ``buckets`` are those of the store."""
        ...


TRIES = 3
"""How often a task is tried; then it is given up, and the rest goes on."""


@dataclass(frozen=True)
class Task:
    """One unit of work, of resume and of retry.

    Attributes
    ----------
    stage : str
        The stage that it belongs to; with `key` it names the commit object in the store.
    key : str
        Unique within the stage, safe as a file name.
    digest : str
        Of everything that the result depends on. A commit with the same digest means: done already.
    work : Work
        Runs on a worker; what it returns is committed with the digest, by the worker.
    arguments : dataclass
        What `work` gets: frozen, small, of values that `digest_of` knows.
    points : int
        How much there is to do, for progress and ETA.
    parts : tuple of Task
        That this one does at once: its record has theirs, in their order, as ``parts``, and each is committed by
        itself. It is tried once; if it fails, they are done one by one.
    starts_small : bool
        It needs much memory at once: before it starts, its worker gives back what it keeps between tasks.
    """

    stage: str
    key: str
    digest: str
    work: Work
    arguments: Any = None
    points: int = 0
    parts: tuple[Task, ...] = ()
    starts_small: bool = False

    @property
    def tries(self) -> int:
        """How often it is tried."""
        return 1 if self.parts else TRIES


@dataclass(frozen=True)
class Outcome:
    """What became of a task: its record, or the error that ended it (one line, and its exception's name).

    Attributes
    ----------
    again : bool
        Trying again could help. Where an executor yields it, that is what it does: this is not the last word.
    fatal : bool
        No other task could succeed either.
    damaged : tuple of str
        Objects of the store that it could not read.
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
        """What became of each part of a task that was done, or of the task itself; the time is shared by points."""
        parts, record = self.task.parts, self.record
        if not parts or record is None:
            return [self]
        share = self.seconds / max(sum(part.points for part in parts), 1)
        return [
            replace(self, task=part, record=made, seconds=share * part.points)
            for part, made in zip(parts, record["parts"], strict=True)
        ]


@dataclass(frozen=True)
class Limits:
    """What a worker may take for a task before it is taken for lost.

    Attributes
    ----------
    memory_bytes : int or None
        That a worker of this machine may allocate; None: anything.
    seconds : float
        That a task of a million points may take, as may smaller ones; larger ones in proportion.
    prepare : callable, optional
        See `tiler.schedule.Guard`.
    """

    memory_bytes: int | None = None
    seconds: float = 600.0
    prepare: Callable[[], None] | None = None

    def seconds_of(self, task: Task) -> float:
        """After which the worker of a task is taken for hung."""
        return self.seconds * max(task.points / 1e6, 1.0)


Perform = Callable[[str, Task], Outcome]
"""``perform(store_url, task)``: runs the work on a worker, commits its record, never raises for a failed task."""


Look = Callable[[Callable[..., Any], str], None]
"""``look(ask, worker)``: ``ask(function, *arguments)`` is its result on that worker; raises what ends the run."""


@dataclass(frozen=True)
class Machine:
    """A machine of a cluster, with the workers on it.

    Attributes
    ----------
    name : str
    memory_bytes : int
        That it has, or that its container or batch job may take.
    workers, threads : int
        Of the cluster on it; each thread does one task at a time.
    """

    name: str
    memory_bytes: int
    workers: int
    threads: int


class Executor(Protocol):
    """Runs tasks; all executors give the same result."""

    workers: int

    def on_each_worker(self, look: Look) -> None:
        """Have `look` judge each worker of a cluster: those that are there now, and those that join later."""
        ...

    def machines(self) -> list[Machine]:
        """Those of a cluster whose workers are there now, by name; none where this machine is the one."""
        ...

    def run(self, perform: Perform, store_url: str, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Outcomes as they come, in any order, with a bounded number of tasks in flight; one a try.

        Raises ConnectionLostError where the connection to a cluster broke and does not come back.
        """
        ...

    def close(self) -> None:
        """Release the workers."""
        ...


def digest_of(*parts: Any) -> str:
    """A short stable digest of JSON-able values and of work's dataclasses, but for fields with `NOT_IN_DIGEST`.

    Keys are sorted; another password or token in a URL changes nothing.
    """
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=to_json)
    if ":/" in text:
        text = json.dumps(stored(json.loads(text)), sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def to_json(value: Any) -> Any:
    """What stands for a value of a task's arguments in JSON: a dataclass by its fields, a fraction as text."""
    if isinstance(value, Fraction):
        return str(value)
    if is_dataclass(value):
        return {f.name: getattr(value, f.name) for f in fields(value) if f.metadata.get("digest", True)}
    raise TypeError(f"{type(value).__name__} has no place in the arguments of a task")
