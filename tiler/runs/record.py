"""Content of run.json: results that the stages add, and the record of the work.

docs/run-json.md guarantees some entries.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

from ptd.passes import State
from tiler.config import RunConfig
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.records import to_json
from tiler.core.results import (
    AboveResult,
    BreaklineCounts,
    BridgeResult,
    CanopyResult,
    Changes,
    ClassCounts,
    ContourResult,
    Doubt,
    EditResult,
    FetchedBytes,
    Implausible,
    LabelCounts,
    LeftObject,
    LeftOut,
    OutlineResult,
    PointCounts,
    ReviewResult,
    SigmaResult,
    SpotCounts,
    StageResult,
    Stray,
    SurfaceResult,
    SurveyDates,
    SurveyResult,
    TerrainResult,
    TileResult,
    UnsurePlace,
    VoidResult,
    VoidsResult,
    WaterResult,
)
from tiler.io.las.headers import stated_bounds
from tiler.io.locations import with_slashes
from tiler.observe.events import Event, TaskFailed
from tiler.observe.json_lines import message_of
from tiler.plan import Plan, plan_json
from tiler.redaction import stored
from tiler.report.problems import problems_of
from tiler.schedule import Outcome, Task
from tiler.schedule.worker import peak_rss_bytes
from tiler.store import Commits
from tiler.version import __version__


class Results:
    """Results of a run. Each attribute that was set is an entry of run.json.

    An attribute is set by its stage. Defaults are not written to run.json.

    Attributes
    ----------
    products_at : str or None
        URL of OUT, if it is at a URL.
    given : list of str
        INPUT as given by the user.
    seconds : float
    report : str or None
        Name of the report. None if it could not be made.
    report_title : str or None
        Title that the user gave to the report.
    inputs : sequence of mapping
        Sources, with the digest of the bytes and the number of stored points.
    fetched : FetchedBytes or None
        None unless inputs are at URLs.
    dates : SurveyDates or None
        None if neither points nor headers have a date.
    crs_code : str or None
        Code of the horizontal CRS.
    statistics : mapping
        State after each pass of the method.
    mask : dict of str to int
        Number of pixels by value of the mask.
    sheets : int
        Number of sheets.
    water_doubts, canopy_doubts : list of Doubt
        Doubts about bodies of water (with positions) and about closed canopy (with bounds).
    doubts : list of str
        Decisions that are uncertain.
    advice : list of str
        Settings that the data show to be wrong.
    advice_at : list of [x, y]
        Position of each advice.
    found_right : list of [kind, cause, west, south, east, north]
        Problems at places that a user found to be right.
    outputs : mapping of str to int
        Files in OUT that this run wrote or found up to date, and their sizes in bytes.
    digests : mapping of str to str
        Digests of these files.
    made_of : mapping of str to str
        Digest of the points, labels and settings from which each product was made.
    delivered : mapping of str to str
        Digests of the files of the last run that wrote all its files.
    earlier_outputs : mapping of str to str or None
        Files in OUT that earlier runs may have written, each with its digest from their `made_of`, or None if that is
        not known or outdated.
    healed : sequence of str
        Damaged objects of the store that the run repaired.
    """

    products_at: str | None
    given: list[str]
    seconds: float
    report: str | None
    report_title: str | None
    inputs: Sequence[Mapping[str, Any]]
    fetched: FetchedBytes | None = None
    dates: SurveyDates | None
    crs_code: str | None
    counts: PointCounts
    classes: ClassCounts
    strays: list[Stray]
    surveys: list[SurveyResult]
    statistics: Mapping[str, State]
    filter: LabelCounts
    canopy: CanopyResult
    breaklines: BreaklineCounts
    bridges: list[BridgeResult]
    edits: Sequence[EditResult] = ()
    water: list[WaterResult]
    dtm: TerrainResult
    dsm: SurfaceResult
    mask: dict[str, int]
    sigma: SigmaResult
    voids: VoidsResult
    without_returns: list[VoidResult]
    above_returns: AboveResult
    left_objects: list[LeftObject]
    unsure: list[UnsurePlace]
    implausible: list[Implausible]
    review: ReviewResult
    found_right: list[list[str | float]]
    changes: Changes
    contours: ContourResult
    spots: SpotCounts
    sheets: int
    outline: OutlineResult | None = None
    water_doubts: list[Doubt]
    canopy_doubts: list[Doubt]
    doubts: list[str]
    advice: list[str]
    advice_at: list[list[float]]
    outputs: Mapping[str, int] = MappingProxyType({})
    digests: Mapping[str, str] = MappingProxyType({})
    made_of: Mapping[str, str]
    delivered: Mapping[str, str] = MappingProxyType({})
    earlier_outputs: Mapping[str, str | None]
    healed: Sequence[str] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the entries of run.json."""
        return {name: to_json(value) for name, value in vars(self).items()}


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
        error, bounds = error.replace(path, named), stated_bounds(path)
        self.quarantined.append(LeftOut(named, error, bounds))

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
        redacted["problems"] = [problem.to_json() for problem in problems_of(redacted)]
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
