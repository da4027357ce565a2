"""Content of run.json.

Only this module lists its entries. docs/run-json.md guarantees some of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any

from tiler.observe.events import Event
from tiler.observe.json_lines import message_of
from tiler.plan import Plan, plan_json
from tiler.redaction import stored
from tiler.report.problems import problems_of
from tiler.runs.results import Results
from tiler.schedule import Outcome, Task
from tiler.schedule.worker import peak_rss_bytes
from tiler.store import Commits
from tiler.version import __version__

LIBRARIES = ("numpy", "numba", "scipy", "laspy", "lazrs", "zarr", "dask", "rasterio", "pyproj")

PLACED = ("filter", "grid-")
"""Stages whose tasks are tiles of the map in the report."""

LISTED_TILES = 20_000
"""Maximum number of tiles of a stage whose tiles are listed. run.json is written after each stage, so it must not
become too long."""


@dataclass
class RunRecord:
    """Record of a run's work and results.

    Attributes
    ----------
    computed : int
        Number of tasks that this run did.
    stages : dict
        ``title``, ``tasks``, ``done`` (before this run), ``points``, ``pixels``, ``computed``, ``seconds`` and
        ``peak_rss_bytes`` of each stage by its key.
    quarantined : list
        ``path`` and ``error`` of each input that is left out.
    failed : list
        ``stage``, ``title``, ``key``, ``error``, ``kind`` and ``bounds`` of each task that failed for good.
    notes : list of str
        Notes for the user.
    warnings : list of str
        Warnings for the user, which `keep_warning` collects.
    exit_code : int or None
        Exit code of the run; None while it is running.
    tiles : dict
        State of each tile by stage and key, for the map in the report.
    results : Results
    """

    computed: int = 0
    stages: dict[str, dict[str, Any]] = field(default_factory=dict)
    quarantined: list[dict[str, str]] = field(default_factory=list)
    failed: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    exit_code: int | None = None
    tiles: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    results: Results = field(default_factory=Results)

    def first_error(self, stage: str) -> str:
        """Return the error of the first failed task of a stage."""
        return next(str(failure["error"]) for failure in self.failed if failure["stage"] == stage)

    def list_tiles(self, stage: str, tasks: Iterable[tuple[Task, list[float] | None]], done: Commits) -> None:
        """Add the tiles of a stage, with their bounds, before the stage begins."""
        self.tiles[stage] = {task.key: _tile(task, bounds, done) for task, bounds in tasks}

    def update_tile(self, outcome: Outcome) -> None:
        """Set the state of a tile after a try. It stays ``waiting`` if another try follows."""
        tile = self.tiles.get(outcome.task.stage, {}).get(outcome.task.key)
        if tile is None:
            return
        if outcome.record is not None:
            tile.update(_made(outcome.record))
            tile["seconds"] = round(outcome.seconds, 3)
            tile["peak_rss_bytes"] = outcome.peak_rss_bytes
        elif not (outcome.again or outcome.damaged):
            tile["state"] = "failed"

    def keep_warning(self, event: Event) -> None:
        """Keep the text of an event if it is a warning. This method is a listener."""
        text, level = message_of(event) or ("", "")
        if level == "warning" and text not in self.warnings:
            self.warnings.append(text)

    def content(self, plan: Plan, state: str) -> dict[str, Any]:
        """Return the content of run.json, without the passwords and tokens of URLs.

        Parameters
        ----------
        plan : Plan
        state : str
            ``running``, ``interrupted``, ``failed`` or ``done``.
        """
        tiles = {}
        for stage, by_key in self.tiles.items():
            tiles[stage] = [{"key": key, **tile} for key, tile in by_key.items()]
        peaks = [stage["peak_rss_bytes"] for stage in self.stages.values()]
        content = {
            "state": state,
            "version": __version__,
            "configuration": plan.config.to_json(),
            "plan": plan_json(plan),
            "libraries": _libraries(),
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "notes": self.notes,
            "warnings": self.warnings,
            "exit_code": self.exit_code,
            "tiles": tiles,
            "stages": self.stages,
            "quarantined": self.quarantined,
            "failed_tasks": self.failed,
            "peak_rss_bytes": max([peak_rss_bytes(), *peaks]),
            **self.results.to_json(),
        }
        found: dict[str, Any] = stored(content)
        found["problems"] = [problem._asdict() for problem in problems_of(found)]
        return found


@cache
def _libraries() -> dict[str, str]:
    # The result is cached, since each version is read from a file.
    return {name: version(name) for name in LIBRARIES}


def _tile(task: Task, bounds: list[float] | None, done: Commits) -> dict[str, Any]:
    """Return the state of a tile before its stage begins.

    If an earlier run did the tile, its time is only in the events of that run.
    """
    made = {"state": "waiting", "tries": 0, "marked": 0}
    if task.key in done:
        _, record = done[task.key]
        made = _made(record)
    return {"bounds": bounds, "points": task.points, **made, "seconds": None, "peak_rss_bytes": None}


def _made(record: dict[str, Any]) -> dict[str, Any]:
    return {"state": "done", "tries": record.get("tries", 1), "marked": record.get("marked", 0)}
