"""Results of a run on its inputs, points and labels, with a type for each entry of run.json.

docs/run-json.md guarantees some of the names. Results on the terrain are in
`tiler.core.terrain_results`.
"""

from __future__ import annotations

from dataclasses import dataclass

from tiler.core.classes import Counts
from tiler.core.records import Record


@dataclass(frozen=True, slots=True)
class LeftOut(Record):
    """Input that is left out: its path, and why."""

    path: str
    error: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StageResult(Record):
    """Work of a stage.

    Attributes
    ----------
    stage, title : str
        Key of the stage, and its name in words.
    tasks, done : int
        Number of tasks, and of those that earlier runs did.
    points, pixels : int
        Number of points that the tasks of this run read, and of pixels that they made.
    computed : int
        Number of tasks that this run did.
    seconds : float
        Time that these tasks took.
    peak_rss_bytes : int
        Memory of the largest process, 0 without tasks.
    """

    stage: str
    title: str
    tasks: int
    done: int
    points: int
    pixels: int
    computed: int
    seconds: float
    peak_rss_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TileResult(Record):
    """Tile of the map in the report.

    Attributes
    ----------
    bounds : [west, south, east, north] or None
    points : int
    state : str
        ``waiting``, ``done`` or ``failed``.
    tries, marked : int
        Number of tries, and of uncertified labels or pixels.
    seconds : float or None
        Time that its task took, or None if this run did not do it.
    peak_rss_bytes : int or None
    """

    bounds: list[float] | None
    points: int
    state: str = "waiting"
    tries: int = 0
    marked: int = 0
    seconds: float | None
    peak_rss_bytes: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class PointCounts(Record):
    """Numbers of points that a run read.

    Attributes
    ----------
    read, stored : int
        Number of points that were read, and of points in the store.
    dropped, unselected : dict of str to int
        Number of points that are not stored, by reason, and of points that are stored but not filtered, by the
        setting that excludes them.
    largest_rounding : float
        Largest change of a coordinate in units of the CRS.
    duplicates_within_files, duplicates_between_files : int
    participating, kept_out : int
        Number of stored points that are filtered, and of the others.
    buckets : int
        Number of buckets with points.
    strays : int
        Number of points far from all others, or outside the bounds of their file.
    """

    read: int
    stored: int
    dropped: dict[str, int]
    unselected: dict[str, int]
    largest_rounding: float
    duplicates_within_files: int | None = None
    duplicates_between_files: int | None = None
    participating: int | None = None
    kept_out: int | None = None
    buckets: int | None = None
    strays: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassCounts(Record):
    """Numbers of points by class.

    Attributes
    ----------
    input, no_part : dict of str to int
        Points of the input, and points of the input that are not filtered.
    reclass : str
        Setting ``--reclass`` of the classified clouds.
    kept, written : dict of str to int
        Points in classified clouds: filtered points that kept the class of the input, and all points.
    ground : int
        Points in classified clouds that the run classified as ground, after the edits.
    """

    input: Counts
    no_part: Counts
    reclass: str | None = None
    kept: Counts | None = None
    written: Counts | None = None
    ground: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FetchedBytes(Record):
    """Bytes of inputs at URLs that were read for the plan, for the points, and for the classified clouds."""

    plan: int
    points: int
    classified: int | None = None


@dataclass(frozen=True, slots=True)
class SurveyDates(Record):
    """First and last day of the survey (ISO 8601), and what they are taken from."""

    first: str
    last: str
    by: str


@dataclass(frozen=True, slots=True)
class Stray(Record):
    """Point far from all others of its file: path of the file, number of the record, and position."""

    path: str
    point: int
    x: float
    y: float
    z: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelCounts(Record):
    """Numbers of labelled points and of tiles.

    Attributes
    ----------
    points, ground, low_noise, unclassified, kept : int
        Number of labelled points, in all and by label.
    marked : int
        Number of labels that are not certified.
    tiles, tiles_done_again : int
        Number of tiles, and of tiles that needed a wider halo.
    overlap_work : float
        Ratio of the area of all windows to the area of the tiles.
    """

    points: int
    ground: int
    low_noise: int
    unclassified: int
    kept: int
    marked: int
    tiles: int
    tiles_done_again: int
    overlap_work: float
