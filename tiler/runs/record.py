"""Content of run.json.

This module and `tiler.runs.results` define its entries. docs/run-json.md guarantees some of
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any

from tiler.config import RunConfig
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.records import to_json
from tiler.core.results import LeftOut, StageResult, TileResult
from tiler.io.locations import with_slashes
from tiler.observe.events import Event, TaskFailed
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
"""Prefixes of the keys of stages whose tasks are tiles of the map in the report."""

LISTED_TILES = 20_000
"""Maximum number of tiles of a stage whose tiles are listed. run.json is written after each
stage, so it must not become too long."""


@dataclass
class RunRecord:
    """Record of a run's work and results.

    Attributes
    ----------
    computed : int
        Number of tasks that this run had to do, with those that failed.
    stages : dict of str to StageResult
        Work of each stage by its key.
    quarantined : list of LeftOut
    failed : list of TaskFailed
        Tasks that failed for good.
    notes : list of str
        Notes for the user.
    warnings : list of str
        Warnings for the user, which `keep_warning` collects.
    exit_code : int or None
        Exit code of the run; None while it is running.
    tiles : dict of str to dict of str to TileResult
        Tiles by stage and key, for the map in the report.
    results : Results
    """

    computed: int = 0
    stages: dict[str, StageResult] = field(default_factory=dict)
    quarantined: list[LeftOut] = field(default_factory=list)
    failed: list[TaskFailed] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    exit_code: int | None = None
    tiles: dict[str, dict[str, TileResult]] = field(default_factory=dict)
    results: Results = field(default_factory=Results)

    def leave_out(self, path: str, error: str) -> None:
        """Add an input that is left out. Its error may begin with the path."""
        named = with_slashes(path)
        self.quarantined.append(LeftOut(named, error.replace(path, named)))

    def first_error(self, stage: str) -> str:
        """Return the error of the first failed task of a stage."""
        return next(failure.error for failure in self.failed if failure.stage == stage)

    def list_tiles(self, stage: str, tasks: Iterable[Task], done: Commits) -> None:
        """Add the tiles of a stage before the stage begins."""
        self.tiles[stage] = {task.key: _tile(task, done) for task in tasks}

    def update_tile(self, outcome: Outcome) -> None:
        """Set the state of a tile after a try. It stays ``waiting`` if another try follows."""
        tiles, key = self.tiles.get(outcome.task.stage, {}), outcome.task.key
        if key not in tiles:
            return
        if outcome.record is not None:
            seconds = round(outcome.seconds, 3)
            tile = replace(tiles[key], seconds=seconds, peak_rss_bytes=outcome.peak_rss_bytes)
            tiles[key] = _done(tile, outcome.record)
        elif not (outcome.again or outcome.damaged):
            tiles[key] = replace(tiles[key], state="failed")

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
        for name, by_key in self.tiles.items():
            tiles[name] = [{"key": key, **tile.to_json()} for key, tile in by_key.items()]
        peaks = [stage.peak_rss_bytes for stage in self.stages.values()]
        content = {
            "state": state,
            "version": __version__,
            "configuration": _settings(plan.config),
            "plan": plan_json(plan),
            "libraries": _libraries(),
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "notes": self.notes,
            "warnings": self.warnings,
            "exit_code": self.exit_code,
            "tiles": tiles,
            "stages": to_json(self.stages),
            "quarantined": to_json(self.quarantined),
            "failed_tasks": [task.to_json() for task in self.failed],
            "peak_rss_bytes": max([peak_rss_bytes(), *peaks]),
            **self.results.to_json(),
        }
        redacted: dict[str, Any] = stored(content)
        redacted["problems"] = [problem._asdict() for problem in problems_of(redacted)]
        return redacted


def _settings(config: RunConfig) -> dict[str, Any]:
    """Return the settings. Names of files have slashes, as all paths in run.json."""
    settings = config.to_json()
    files = {f.name for f in fields(config) if f.metadata["kind"] in ("file", "files")}
    for name in files | {"store"}:
        if isinstance(settings[name], str):
            settings[name] = with_slashes(settings[name])
        elif settings[name] is not None:
            settings[name] = [with_slashes(path) for path in settings[name]]
    return settings


@cache
def _libraries() -> dict[str, str]:
    # The result is cached, since each version is read from a file.
    return {name: version(name) for name in LIBRARIES}


def extent_of(task: Task) -> list[float] | None:
    """Return lowest x, y and highest x, y of a task in units of the CRS, or None if it has no position."""
    edges = None if task.bounds is None else task.bounds.to_json()
    return None if edges is None else [edge / COUNTS_PER_UNIT for edge in edges]


def _tile(task: Task, done: Commits) -> TileResult:
    """Return a tile before its stage begins.

    If an earlier run did the tile, its time is only in the events of that run.
    """
    tile = TileResult(
        bounds=extent_of(task), points=task.points, seconds=None, peak_rss_bytes=None
    )
    if task.key in done:
        _, stored_record = done[task.key]
        return _done(tile, stored_record)
    return tile


def _done(tile: TileResult, stored_record: Mapping[str, Any]) -> TileResult:
    # Records of some rasters lack these entries, since their pixels are never uncertified.
    return replace(
        tile,
        state="done",
        tries=stored_record.get("tries", 1),
        marked=stored_record.get("marked", 0),
    )
