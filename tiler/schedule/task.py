"""A task: a pure function of the store. It reads whole arrays and writes keys that no other task writes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

from tiler.redaction import stored

Work = Callable[[str, dict[str, Any]], dict[str, Any]]
"""``work(store_url, arguments) -> record``: a module-level function (it travels by name); both JSON-able."""


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
    arguments : dict
        JSON-able, small.
    points : int
        How much there is to do, for progress and ETA.
    """

    stage: str
    key: str
    digest: str
    work: Work
    arguments: dict[str, Any] = field(default_factory=dict)
    points: int = 0


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


TRIES = 3
"""How often a task is tried; then it is given up, and the rest goes on."""


@dataclass(frozen=True)
class Limits:
    """What a worker may take for a task before it is taken for lost.

    Attributes
    ----------
    memory_bytes : int or None
        That a worker of this machine may allocate; None: anything.
    seconds : float
        That a task of a million points may take, as may smaller ones; larger ones in proportion.
    """

    memory_bytes: int | None = None
    seconds: float = 600.0

    def seconds_of(self, task: Task) -> float:
        """After which the worker of a task is taken for hung."""
        return self.seconds * max(task.points / 1e6, 1.0)


Perform = Callable[[str, Task], Outcome]
"""``perform(store_url, task)``: runs the work on a worker, commits its record, never raises for a failed task."""


Look = Callable[[Callable[..., Any], str], None]
"""``look(ask, worker)``: ``ask(function, *arguments)`` is its result on that worker; raises what ends the run."""


@dataclass(frozen=True)
class Machine:
    """One that workers of a cluster are on.

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
        """Outcomes as they come, in any order, with a bounded number of tasks in flight; one a try."""
        ...

    def close(self) -> None:
        """Release the workers."""
        ...


def digest_of(*parts: Any) -> str:
    """A short stable digest of JSON-able values (keys sorted); another password or token in a URL changes nothing."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    if ":/" in text:
        text = json.dumps(stored(parts), sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
