"""Results of a run, with a type for each entry of run.json: first inputs, points and labels, then the terrain.

docs/run-json.md guarantees some of the names. Heights and distances in rasters are in units of the CRS, values with
names that end in ``_m`` in metres.
"""

from __future__ import annotations

from dataclasses import dataclass

from tiler.core.points import Counts
from tiler.core.records import Record


@dataclass(frozen=True, slots=True)
class LeftOut(Record):
    """Input that is left out: its path, why, and [west, south, east, north] if its header states them."""

    path: str
    error: str
    bounds: list[float] | None = None


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
class SurveyStep(Record):
    """Heights of a survey above those of another one, in flat cells of both: median, MAD, and number of cells."""

    other: str
    median_m: float
    mad_m: float
    cells: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyResult(Record):
    """Survey of the setting ``--priority``.

    Attributes
    ----------
    name : str
        Its days, or its line in the file.
    first, last : str or None
        First and last day (ISO 8601), if all files have a date.
    files, points, used : int
        Number of files, of their stored points, and of these without the points that another survey hides.
    density : float
        Points per square metre of the cells with points of the survey.
    area_m2 : float
        Area of the cells that have points of the survey and in which it counts (`tiler.core.surveys`). With a part of
        the survey (`--bounds`, `--aoi`), cells of its margin are among them.
    steps : list of SurveyStep
        Steps to the surveys that count more, where both have points.
    """

    name: str
    first: str | None
    last: str | None
    files: int
    points: int
    used: int
    density: float
    area_m2: float
    steps: list[SurveyStep]


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


Rings = list[list[float]]
"""Closed rings or lines, each as x, y, x, y, ... in units of the CRS."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanopyResult(Record):
    """Closed canopy that hides the ground.

    Attributes
    ----------
    share : float, optional
        Share of canopy in the area that has points.
    mode : str
        Setting ``--canopy``.
    places : list of [x, y]
        Centres of the blocks with most canopy.
    rings : Rings
        Outlines of canopy for the map.
    """

    share: float | None
    mode: str
    places: list[list[float]] | None = None
    rings: Rings | None = None


@dataclass(frozen=True, slots=True)
class BreaklineCounts(Record):
    """Numbers of breaklines and their vertices, and the lines for the map, unless they are too long."""

    lines: int
    vertices: int
    drawn: Rings


@dataclass(frozen=True, slots=True)
class BridgeResult(Record):
    """Bridge that was removed: its size, the number of points below it, and its outline."""

    length_m: float
    width_m: float
    clearance_m: float
    below: int
    rings: Rings


@dataclass(frozen=True, slots=True, kw_only=True)
class EditResult(Record):
    """Changes by an edit.

    Attributes
    ----------
    number : int
    action : str
    bounds : [west, south, east, north]
    points, ground_before, ground_after : int
        Number of points inside an edit of points, and of ground points among them before and after the edit.
    by : str
        How the ground of an edit with the action `ground` is chosen.
    rings : Rings
        Outline for the map.
    pixels : int
        Number of pixels that an edit of pixels set.
    changed : bool
    holes : int
        Number of pixels inside the edit without a height.
    """

    number: int
    action: str
    bounds: list[float]
    points: int | None = None
    ground_before: int | None = None
    ground_after: int | None = None
    by: str | None = None
    rings: Rings | None = None
    pixels: int | None = None
    changed: bool | None = None
    holes: int | None = None


@dataclass(frozen=True, slots=True)
class StationResult(Record):
    """Position along a river at which its level was estimated.

    ``along`` is the distance from the first station. See `tiler.core.water.Station` for the others.
    """

    along: float
    seen: int
    level: float
    left: float | None
    right: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterResult(Record):
    """Body of water: highest and lowest level, size, confidence, and stations of a river."""

    number: int
    kind: str
    level: float
    level_end: float
    pixels: int
    area_m2: float
    sure: float | None
    bounds: list[float]
    stations: list[StationResult]
    rings: Rings | None = None


@dataclass(frozen=True, slots=True)
class Doubt(Record):
    """Result that should be checked: a text, and a position [x, y] or bounds [west, south, east, north]."""

    text: str
    place: list[float]


@dataclass(frozen=True, slots=True, kw_only=True)
class TerrainResult(Record):
    """Terrain model.

    Attributes
    ----------
    width, height : int
        Size of the raster in pixels.
    resolution_m : float
    filled, marked : int
        Number of pixels with a height, and of pixels that are not certified.
    blocks, blocks_done_again : int
        Number of blocks, and of blocks that needed more than one try.
    thinned : bool
        Whether only some of the ground points make the surface.
    """

    width: int
    height: int
    resolution_m: float
    filled: int
    marked: int
    blocks: int
    blocks_done_again: int
    thinned: bool


@dataclass(frozen=True, slots=True)
class SurfaceResult(Record):
    """Surface model: pixels with a height, and pixels with returns."""

    filled: int
    measured: int


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlineResult(Record):
    """Outline of the survey.

    Attributes
    ----------
    gap_m, widest_gap_m : float
        Usual and largest width of the gaps that count as surveyed.
    cell_m : float
        Size of the cells of the search.
    cut_pixels : int
        Number of pixels whose height was removed.
    rings : Rings
    polygons : int
        Number of polygons of the outline.
    """

    gap_m: float
    widest_gap_m: float
    cell_m: float
    cut_pixels: int
    rings: Rings | None = None
    polygons: int | None = None


@dataclass(frozen=True, slots=True)
class SigmaGroup(Record):
    """Standard error of one group of ground: pixels, expected RMSE, and pixels by class of the error."""

    pixels: int
    rmse_m: float | None
    histogram: list[int]


@dataclass(frozen=True, slots=True)
class SigmaResult(Record):
    """Standard error of the terrain.

    Attributes
    ----------
    kind : str or None
        Kind of cloud whose constants were used. None for the larger error of both kinds.
    edges_m : list of float
        Edges of the classes of the histograms.
    open, covered, water : SigmaGroup
    """

    kind: str | None
    edges_m: list[float]
    open: SigmaGroup
    covered: SigmaGroup
    water: SigmaGroup


@dataclass(frozen=True, slots=True)
class VoidResult(Record):
    """Connected pixels without a height.

    Attributes
    ----------
    pixels : int
    bounds : [west, south, east, north]
        Edges in units of the CRS.
    area_m2 : float
    at_border : bool
        Whether one of the pixels touches a pixel outside the survey.
    at : [x, y]
        Centre of one of the pixels, where they are dense. The middle of the bounds may lie in none.
    rings : Rings, optional
        Outline of rectangles around the pixels, for the places that run.json lists.
    """

    pixels: int
    bounds: list[float]
    area_m2: float
    at_border: bool
    at: list[float]
    rings: Rings | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class VoidsResult(Record):
    """Voids of the delivered terrain.

    Attributes
    ----------
    surveyed_pixels, pixels, asked_pixels : int
        Number of pixels that have a height or should have one, of pixels that should have one and do not, and of pixels
        without a height because an edit asks for that.
    number : int
        Number of voids.
    largest : list of VoidResult
    """

    surveyed_pixels: int
    pixels: int
    asked_pixels: int
    number: int
    largest: list[VoidResult]


@dataclass(frozen=True, slots=True)
class AbovePlace(Record):
    """Connected pixels in which the terrain lies above all returns.

    Attributes
    ----------
    pixels : int
    bounds : [west, south, east, north]
        Edges in units of the CRS.
    area_m2 : float
    height_m : float
        Largest height above the highest return of a pixel of the terrain at its lowest corner.
    rings : Rings
        Outline of the pixels.
    """

    pixels: int
    bounds: list[float]
    area_m2: float
    height_m: float
    rings: Rings


@dataclass(frozen=True, slots=True)
class AboveResult(Record):
    """Terrain above all returns.

    Attributes
    ----------
    pixels : int
        Number of pixels, also of those in small places.
    number : int
        Number of places that are large enough to be listed.
    worst : list of AbovePlace
        Places, the largest height first.
    """

    pixels: int
    number: int
    worst: list[AbovePlace]


@dataclass(frozen=True, slots=True, kw_only=True)
class UnsurePlace(Record):
    """Place where the terrain is unsure.

    Attributes
    ----------
    bounds : [west, south, east, north]
        Edges in units of the CRS.
    area_m2 : float
    error_m : float
        Typical error of its heights.
    gap_m : float
        Mean distance to the nearest ground point.
    slope : float
        Slope of the land (rise over run).
    objects : float
        Share of objects among the points around.
    chance : float
        Chance that the terrain is wrong there.
    rings : Rings
        Outline of its cells.
    """

    bounds: list[float]
    area_m2: float
    error_m: float
    gap_m: float
    slope: float
    objects: float
    chance: float
    rings: Rings


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftObject(Record):
    """Object that is probably left in the terrain.

    Attributes
    ----------
    bounds : [west, south, east, north]
        Edges in units of the CRS.
    area_m2 : float
    height_m : float
        Largest height of its terrain above the land around.
    steep : float
        Share of its border that is steep.
    ground : int
        Number of ground points in it.
    chance : float
        Chance that it is an object.
    rings : Rings
        Outline of its cells.
    """

    bounds: list[float]
    area_m2: float
    height_m: float
    steep: float
    ground: int
    chance: float
    rings: Rings


@dataclass(frozen=True, slots=True)
class Implausible(Record):
    """Result that cannot be true: its kind, what was found, a setting to try, and its extent if it has one."""

    what: str
    why: str
    remedy: str
    bounds: list[float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes(Record):
    """Changes of the files in OUT since the run before, as paths in OUT.

    Attributes
    ----------
    changed, added, removed : list of str
        Files with other bytes, new files, and files that were moved because they are outdated.
    unchanged : int
        Number of files with the same bytes. They keep their times.
    sheets : list of str
        Names of the sheets of the terrain of which a raster changed or is new.
    """

    changed: list[str]
    added: list[str]
    removed: list[str]
    unchanged: int
    sheets: list[str]


@dataclass(frozen=True, slots=True)
class ReviewResult(Record):
    """Numbers of places to review: not looked at, right as they are, and changed by an edit."""

    open: int
    ok: int
    fixed: int


@dataclass(frozen=True, slots=True)
class ContourResult(Record):
    """Contours: interval, numbers of lines and vertices, of lines cut in two, and of lines left out as too short."""

    interval: float
    lines: int
    vertices: int
    cut: int
    short: int


@dataclass(frozen=True, slots=True)
class SpotCounts(Record):
    """Numbers of tops and of bottoms."""

    highs: int
    lows: int
