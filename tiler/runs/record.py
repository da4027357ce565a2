"""What run.json says of a run; the one place that lists its entries."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any, TypedDict

from tiler.plan import Plan, plan_json
from tiler.redaction import stored
from tiler.runs.worker import peak_rss_bytes
from tiler.schedule import Outcome, Task
from tiler.store import Commits
from tiler.version import __version__

LIBRARIES = ("numpy", "numba", "scipy", "laspy", "lazrs", "zarr", "dask", "rasterio", "pyproj")

PLACED = ("filter", "grid-")
"""Stages whose tasks are tiles of the map in the report."""

LISTED_TILES = 20_000
"""Tiles of a stage listed in run.json, which is written again after each stage; where there are more, none is."""


class Facts(TypedDict, total=False):
    """What the stages add to run.json; each entry is there once its stage is done.

    Heights and distances in rasters are in units of the CRS, names that end in ``_m`` are metres.
    """

    products_at: str | None  # URL of OUT, where it is one
    given: list[str]  # INPUT, as it was called with
    seconds: float
    report: str | None  # name of the report, None where it could not be drawn
    inputs: list[
        dict[str, Any]
    ]  # each source, with the digest of its bytes and the points that are stored of it
    fetched: dict[str, int]  # bytes of inputs at URLs: for the plan, of points, for classified clouds
    counts: dict[str, Any]  # points read, stored, dropped by reason, duplicates, strays, buckets
    strays: list[dict[str, Any]]  # each point that is far from all others of its file
    statistics: dict[str, Any]  # state after each pass of the method
    filter: dict[str, Any]  # points of each class, tiles, marks, overlap work
    breaklines: dict[str, Any]
    bridges: list[dict[str, Any]]  # sizes and outline of each that was left out
    edits: list[dict[str, Any]]  # what each correction changed
    water: list[Any]  # each body of water, with its level and the pixels that it has
    dtm: dict[str, Any]  # size of the raster, pixels with a height, marks, blocks
    dsm: dict[str, Any]
    mask: dict[str, Any]  # pixels of each value
    contours: dict[str, Any]
    outline: dict[str, Any]  # widest gap that counts as surveyed, pixels cut
    advice: list[str]  # choices that the data show to be wrong
    outputs: dict[
        str, int
    ]  # files of OUT that this run wrote or found as it would write them, and their bytes
    digests: dict[str, str]  # of these files
    made_of: dict[str, str]  # digest of what each raster was made of
    earlier_outputs: dict[str, str | None]  # files of earlier runs, until the export has dealt with them
    healed: list[str]  # objects of the store that were damaged and are made again


@dataclass
class RunRecord:
    """What was done and what became of it.

    Attributes
    ----------
    computed : int
        Tasks that this run did.
    stages : dict
        Key -> ``title`` in words, ``tasks``, ``done`` before, ``points``, ``computed``, ``seconds``,
        ``peak_rss_bytes``.
    quarantined : list
        ``path`` and ``error`` of each input that is left out.
    failed : list
        ``stage``, its ``title`` in words, ``key``, ``error``, ``kind`` and ``bounds`` of each task that was given up.
    notes : list of str
        What was decided for people.
    tiles : dict
        Stage -> key -> what became of the tile, for the map in the report.
    facts : Facts
    """

    computed: int = 0
    stages: dict[str, dict[str, Any]] = field(default_factory=dict)
    quarantined: list[dict[str, str]] = field(default_factory=list)
    failed: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    tiles: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    facts: Facts = field(default_factory=Facts)

    def first_error(self, stage: str) -> str:
        """Of the task of a stage that was given up first."""
        return next(str(failure["error"]) for failure in self.failed if failure["stage"] == stage)

    def list_tiles(self, stage: str, tasks: Iterable[tuple[Task, list[float] | None]], done: Commits) -> None:
        """Tiles of a stage before it begins, each with its bounds."""
        self.tiles[stage] = {task.key: _tile(task, bounds, done) for task, bounds in tasks}

    def tell_tile(self, outcome: Outcome) -> None:
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

    def content(self, plan: Plan, state: str) -> dict[str, Any]:
        """What run.json holds; no URL in it has a password or token.

        Parameters
        ----------
        plan : Plan
        state : str
            ``running``, ``interrupted`` or ``done``.
        """
        found: dict[str, Any] = stored(
            {
                "state": state,
                "version": __version__,
                "configuration": plan.config.to_json(),
                "plan": plan_json(plan),
                "libraries": _libraries(),
                "written": datetime.now(UTC).isoformat(timespec="seconds"),
                "notes": self.notes,
                "tiles": {s: [{"key": k, **t} for k, t in ts.items()] for s, ts in self.tiles.items()},
                "stages": self.stages,
                "quarantined": self.quarantined,
                "failed_tasks": self.failed,
                "peak_rss_bytes": max(
                    [peak_rss_bytes(), *(s["peak_rss_bytes"] for s in self.stages.values())]
                ),
                **self.facts,
            }
        )
        return found


@cache
def _libraries() -> dict[str, str]:
    """Versions of the libraries; read once, as each is a file."""
    return {name: version(name) for name in LIBRARIES}


def _tile(task: Task, bounds: list[float] | None, done: Commits) -> dict[str, Any]:
    """A tile before its stage begins; one that an earlier run did has the time in that run's events alone."""
    made = _made(done[task.key][1]) if task.key in done else {"state": "waiting", "tries": 0, "marked": 0}
    return {"bounds": bounds, "points": task.points, **made, "seconds": None, "peak_rss_bytes": None}


def _made(record: dict[str, Any]) -> dict[str, Any]:
    return {"state": "done", "tries": record.get("tries", 1), "marked": record.get("marked", 0)}
