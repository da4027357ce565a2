"""A run at work: what its stages share, what was done, and what run.json says of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.errors import DamagedError, DiskFullError, ProcessingError
from tiler.io.locations import is_url, joined, put_file
from tiler.io.result_folder import RUN
from tiler.observe.events import Listener
from tiler.plan import Plan, plan_json
from tiler.redaction import stored
from tiler.report import write_run_file
from tiler.runs.executors import Crew
from tiler.runs.worker import peak_rss_bytes, perform
from tiler.schedule import Outcome, Placed, Task
from tiler.store import LEASE_SECONDS, Commits, Lease, TileStore, store_exists
from tiler.version import __version__

LIBRARIES = (
    "numpy",
    "numba",
    "scipy",
    "laspy",
    "lazrs",
    "zarr",
    "dask",
    "rasterio",
    "pyproj",
    "shapely",
    "pyogrio",
    "contourpy",
)

PACKED_COMMITS = 256
"""From so many commits on, a stage packs them into one object when it ends: each costs a request to read."""

PLACED = ("filter", "grid-")
"""Stages whose tasks are tiles of the map in the report."""

LISTED_TILES = 20_000
"""Tiles of a stage listed in run.json, which is written again after each stage; where there are more, none is."""

Warm = Callable[[Callable[[], None]], None]


@dataclass
class RunResult:
    """How a run ended.

    Attributes
    ----------
    exit_code : int
        0, or 5 if something was left out.
    summary : dict
        What ``run.json`` says.
    did_nothing : bool
        Everything had been done before.
    """

    exit_code: int
    summary: dict[str, Any]
    did_nothing: bool


@cache
def _libraries() -> dict[str, str]:
    """Their versions; read once, as each is a file."""
    return {name: version(name) for name in LIBRARIES}


@dataclass
class Job:
    """A run at work: what the stages share.

    ``out`` is the folder of run.json, the log and the report; ``products``, the same or a URL, that of all other files.
    """

    plan: Plan
    out: Path
    products: str
    store: TileStore
    listener: Listener
    crew: Crew = field(init=False)
    computed: int = 0
    stages: dict[str, dict[str, Any]] = field(default_factory=dict)
    quarantined: list[dict[str, str]] = field(default_factory=list)
    failed: list[dict[str, Any]] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    tiles: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    damaged: set[str] = field(default_factory=set)
    leases: tuple[Lease, ...] = ()
    held: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        self.crew = Crew(self.plan, self.store.url, self.products, self.note)

    def note(self, text: str) -> None:
        """Tell people what was decided for them, now and in run.json."""
        if text not in self.notes:  # a stage that is done again says the same again
            self.notes.append(text)
        self.listener("note", {"text": text})

    def sorted_out(self, stage: str, tasks: Iterable[Task]) -> tuple[Commits, Commits]:
        """Commits of a stage that hold for these tasks, and those that do not: of other settings or inputs."""
        digests = {task.key: task.digest for task in tasks}
        found = self.store.committed(stage)
        done = {key: commit for key, commit in found.items() if commit[0] == digests.get(key)}
        return done, {key: commit for key, commit in found.items() if key not in done}

    def take_back(self, stage: str, keys: Iterable[str]) -> None:
        """Tasks are done no more: always before what they wrote is overwritten or removed.

        Else a run that is killed on the way would leave commits whose data are another run's.
        """
        self.store.uncommit(stage, *keys)

    def perform(
        self, stage: str, tasks: Iterable[Task], warm: Warm | None = None, writes_out: bool = False
    ) -> Commits:
        """Do what is not done yet of a stage; commits of all its tasks that succeeded.

        ``warm`` compiles the kernels of the stage, here and once, before local workers would each do so.
        ``writes_out``: the tasks write files into OUT.
        """
        wanted = {task.key: task for task in tasks}
        done, stale = self.sorted_out(stage, wanted.values())
        self.take_back(stage, stale)
        todo = [task for key, task in wanted.items() if key not in done]
        info = {
            "stage": stage,
            "tasks": len(wanted),
            "done": len(done),
            "points": sum(t.points for t in todo),
        }
        self.listener("stage_started", info)
        if stage.startswith(PLACED) and len(wanted) <= LISTED_TILES:
            places = {key: self._place(task) for key, task in wanted.items()}
            self.tiles[stage] = {key: _tile_facts(task, places[key], done) for key, task in wanted.items()}
        start, cpu_peak = time.monotonic(), 0
        if todo and warm is not None and self.plan.config.scheduler is None:
            warm(lambda: self.listener("note", {"text": "compiling kernels (once on this machine)"}))
        outcomes = self.crew.executor(writes_out).run(perform, self.store.url, todo) if todo else ()
        for outcome in outcomes:
            self._tell_tile(outcome)
            self._finished(outcome)
            self._hold()
            cpu_peak = max(cpu_peak, outcome.peak_rss_bytes)
            if outcome.record is not None:
                done[outcome.task.key] = (outcome.task.digest, outcome.record)
        if self.damaged:
            keys, self.damaged = tuple(sorted(self.damaged)), set()
            raise DamagedError(f"{self.store.url}: {', '.join(keys)}: damaged or gone; run again", keys)
        seconds = round(time.monotonic() - start, 3)
        self.computed += len(todo)
        self.store.compact(stage, PACKED_COMMITS)
        self.stages[stage] = {**info, "computed": len(todo), "seconds": seconds, "peak_rss_bytes": cpu_peak}
        self.listener("stage_finished", {"stage": stage, "seconds": seconds})
        self.save("running")
        return dict(sorted(done.items()))

    def _hold(self) -> None:
        """End this run if another one took store or OUT over, as after a long sleep of this machine."""
        if time.monotonic() - self.held > LEASE_SECONDS / 2:
            for lease in self.leases:
                lease.check()
            self.held = time.monotonic()

    def _finished(self, outcome: Outcome) -> None:
        task = outcome.task
        if outcome.record is not None:
            self.listener(
                "task_done",
                {"stage": task.stage, "key": task.key, "points": task.points, "seconds": round(outcome.seconds, 3),
                 "peak_rss_bytes": outcome.peak_rss_bytes},
            )  # fmt: skip
            return
        failure: dict[str, Any] = {
            "stage": task.stage,
            "key": task.key,
            "error": outcome.error or "",
            "kind": outcome.error_kind or "",
        }
        self._refuse_gone()
        if outcome.fatal:
            raise DiskFullError(f"{task.stage} {task.key}: {outcome.error}")
        self.damaged.update(outcome.damaged)
        if outcome.again or outcome.damaged:
            self.listener("task_again", failure)
            return
        failure["bounds"] = self._place(task)
        self.listener("task_failed", dict(failure))
        self.failed.append(failure)
        if self.plan.config.on_error == "stop":
            raise ProcessingError(
                f"{task.stage} {task.key}: {outcome.error}; --on-error skip goes on without it"
            )

    def _refuse_gone(self) -> None:
        """Raise ProcessingError where it is not the task that failed: everything that it needs was removed."""
        places = [self.store.url] if not store_exists(self.store.url) else []
        places += [str(self.out)] if not self.out.is_dir() else []
        if places:
            raise ProcessingError(
                f"{places[-1]}: was removed while the run went on; run again, and what is gone is made anew"
            )

    def _tell_tile(self, outcome: Outcome) -> None:
        """What became of a tile; one that is tried again stays ``waiting``."""
        tile = self.tiles.get(outcome.task.stage, {}).get(outcome.task.key)
        if tile is None:
            return
        if outcome.record is not None:
            tile.update(_made(outcome.record))
            tile["seconds"] = round(outcome.seconds, 3)
            tile["peak_rss_bytes"] = outcome.peak_rss_bytes
        elif not (outcome.again or outcome.damaged):
            tile["state"] = "failed"

    def _place(self, task: Task) -> list[float] | None:
        """The hole that a task leaves: lowest x, y, highest x, y in units of the CRS; None where it has no place."""
        work = task.arguments
        bounds = work.place(self.plan.meta.bucket) if isinstance(work, Placed) else None
        return None if bounds is None else [v / COUNTS_PER_UNIT for v in bounds.to_json()]

    def save(self, state: str) -> dict[str, Any]:
        """Write run.json and return its content; no URL in it has a password or token."""
        content: dict[str, Any] = stored({
            "state": state, "version": __version__, "configuration": self.plan.config.to_json(),
            "plan": plan_json(self.plan), "libraries": _libraries(),
            "written": datetime.now(UTC).isoformat(timespec="seconds"), "notes": self.notes,
            "tiles": {s: [{"key": k, **t} for k, t in ts.items()] for s, ts in self.tiles.items()},
            "stages": self.stages, "quarantined": self.quarantined, "failed_tasks": self.failed,
            "peak_rss_bytes": max([peak_rss_bytes(), *(s["peak_rss_bytes"] for s in self.stages.values())]),
            **self.facts,
        })  # fmt: skip
        write_run_file(self.out, content)
        if is_url(self.products):  # a run from elsewhere knows by it whose files these are
            put_file(self.out / RUN, joined(self.products, RUN))
        return content


def _tile_facts(task: Task, bounds: list[float] | None, done: Commits) -> dict[str, Any]:
    """A tile before its stage begins; one that an earlier run did has the time in that run's events alone."""
    made = _made(done[task.key][1]) if task.key in done else {"state": "waiting", "tries": 0, "marked": 0}
    return {"bounds": bounds, "points": task.points, **made, "seconds": None, "peak_rss_bytes": None}


def _made(record: dict[str, Any]) -> dict[str, Any]:
    return {"state": "done", "tries": record.get("tries", 1), "marked": record.get("marked", 0)}
