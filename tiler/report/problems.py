"""Problems of a run: a list of records about missing and doubtful results, made from the content of run.json.

A source is a function from run.json to problems. To add a kind of problem, add a function to
`SOURCES`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Any, NamedTuple

from tiler.core.chances import LEFT, UNSURE, chance_of
from tiler.core.edits import NOT_GROUND, TO_GROUND, VOID
from tiler.core.points import NOISE
from tiler.core.review import LEFT_OUT, OK, OPEN, STATUSES
from tiler.core.units import length_text, small_area_text
from tiler.core.words import counted
from tiler.report.document import Content, Node, el, more, section, table
from tiler.report.runfile import title_of, units_of

MAX_ROWS = 1000
"""Largest number of rows of a table. The other rows are in run.json."""
MAX_OF_KIND = 10
"""Largest number of places of a kind that have their own row, the worst ones. The others share
one row."""
SMALL_M2 = 1000.0
"""Voids at the border of the survey below this area share one row."""
BESIDE_M = 10.0
"""Distance to a file that was left out up to which a void at the border of the survey is blamed on it."""
WITHOUT_RETURNS = "place without returns"
INSIDE = "void inside the survey"
AT_BORDER = "void at the border of the survey"
LIKELY = 0.8
"""Chance from which a place is called likely."""
PLANTS, STEEP = 0.5, 0.3
"""Share of objects and slope from which they are named as causes of unsure terrain."""

Run = Mapping[str, Any]
Place = tuple[float, float, float, float]
"""West, south, east, north in units of the CRS. For a point, west equals east and south equals
north."""


class Problem(NamedTuple):
    """Missing or doubtful result that a user should check.

    Attributes
    ----------
    what : str
        Kind of the problem, such as ``void inside the survey``.
    where : Place or None
        Extent of the problem, or None if it has no location.
    why : str
        Cause and size of the problem.
    remedy : str
        Remedy in words. It is empty if there is nothing to do.
    area_m2 : float or None
        Area of a place whose pixels are the problem.
    at : tuple of float, or None
        x and y of a pixel of it, unless the middle of the extent is meant.
    action : str
        Action of an edit that would remedy it, see `tiler.core.edits`. It is empty if no edit would.
    stake_m : float or None
        Height by which the terrain may be wrong, in metres.
    chance : float or None
        Chance that the terrain is wrong there. If its source does not give it, it is that of `tiler.core.chances`.
    rings : sequence of sequence of float
        Outline, as closed rings x, y, x, y, ... in units of the CRS. It is empty if the extent is the outline.
    status : str
        ``ok`` if a user looked at the place and found that it is right, else ``open``.
    """

    what: str
    where: Place | None
    why: str
    remedy: str = ""
    area_m2: float | None = None
    at: tuple[float, float] | None = None
    action: str = ""
    stake_m: float | None = None
    chance: float | None = None
    rings: Sequence[Sequence[float]] = ()
    status: str = OPEN

    def to_json(self) -> dict[str, Any]:
        """Return the entry of run.json. Its outline is in the entry of its source."""
        return {name: value for name, value in self._asdict().items() if name != "rings"}


def problems_of(run: Run) -> list[Problem]:
    """Return all problems of a run, in the order of `SOURCES`."""
    statistics = run.get("statistics") or {}
    kind = statistics.get("survey", {}).get("survey", {}).get("kind")
    right = set(map(tuple, run.get("found_right", ())))
    found = []
    for problem in (problem for source in SOURCES for problem in source(run)):
        if problem.where is not None:
            chance = problem.chance
            if chance is None:
                chance = chance_of(problem.what, kind, problem.area_m2)
            status = OK if (problem.what, problem.why, *problem.where) in right else OPEN
            problem = problem._replace(chance=chance, status=status)
        found.append(problem)
    return found


def open_problems(run: Run) -> list[Problem]:
    """Return the problems of a run without those at places that a user found to be right."""
    return [problem for problem in problems_of(run) if problem.status == OPEN]


def place_of(bounds: Sequence[float] | None) -> Place | None:
    """Return the extent of four edges (west, south, east, north), or of a point (x, y)."""
    if not bounds:
        return None
    west, south, *rest = (float(v) for v in bounds)
    east, north = rest or (west, south)
    return west, south, east, north


def unmet(run: Run) -> list[Mapping[str, Any]]:
    """Return the requirements of the last check of this terrain that are not met."""
    check = run.get("check", {})
    # A check that is older than the terrain measured another terrain.
    judged = () if check.get("older") else check.get("requirements", ())
    return [requirement for requirement in judged if not requirement["met"]]


def _requirements(run: Run) -> Iterator[Problem]:
    for requirement in unmet(run):
        name, limit, value = (requirement[key] for key in ("name", "limit", "value"))
        unit = f" {requirement.get('unit', '')}".rstrip()
        result = (
            f"did not measure {name}"
            if value is None
            else f"measured {name} = {value:.4g}{unit}"
        )
        why = f"the check {result}; the limit is {limit:g}{unit}"
        yield Problem(
            "requirement not met",
            None,
            why,
            "see Accuracy; run tiler check again after a change",
        )


def _warnings(run: Run) -> Iterator[Problem]:
    yield from (
        Problem("setting or input", None, text) for text in run["plan"].get("warnings", ())
    )
    yield from (Problem("doubtful decision", None, text) for text in run.get("doubts", ()))


def _objects(run: Run) -> Iterator[Problem]:
    """Yield the widest roof, and crowns, that may still be in the finished terrain."""
    positions = run.get("advice_at", ())
    for text, position in zip_longest(run.get("advice", ()), positions):
        yield Problem("objects suspected in the terrain", place_of(position), text)


def _files(run: Run) -> Iterator[Problem]:
    for file in run.get("quarantined", ()):
        why = file["error"].removeprefix(f"{file['path']}: ")
        where = _beside_survey(run, file.get("bounds"))
        yield Problem(
            LEFT_OUT, where, f"{file['path']}: {why}", "repair the file, then run again"
        )


def _beside_survey(run: Run, bounds: Sequence[float] | None) -> Place | None:
    """Return the part of the bounds of a file that lies in the survey or beside it, or None.

    A damaged header may state any bounds, and a file may be left out because it lies far away.
    """
    if bounds is None:
        return None
    west, south, east, north = run["plan"]["extent"]
    reach = max(east - west, north - south)
    near = (
        max(bounds[0], west - reach),
        max(bounds[1], south - reach),
        min(bounds[2], east + reach),
        min(bounds[3], north + reach),
    )
    return near if near[0] < near[2] and near[1] < near[3] else None


def _tasks(run: Run) -> Iterator[Problem]:
    for task in run.get("failed_tasks", ()):
        why = f"{title_of(run, task['stage'])} {task['key']}: {task['error']}"
        yield Problem("failed task", place_of(task.get("bounds")), why, "run again")


def _labels(run: Run) -> Iterator[Problem]:
    """Yield tiles with labels that points beyond their halo could change."""
    marked = run.get("filter", {}).get("marked", 0)
    tiles = [
        t
        for name, stage_tiles in run.get("tiles", {}).items()
        if name.startswith("filter")
        for t in stage_tiles
    ]
    doubtful = [tile for tile in tiles if tile["marked"]]
    remedy = "use a larger --halo"
    for tile in doubtful:
        why = f"tile {tile['key']}: {tile['marked']:,} labels are not certified, because points beyond its halo could "
        yield Problem("doubtful tile", place_of(tile["bounds"]), f"{why}change them", remedy)
    if marked and not doubtful:
        why = f"{marked:,} labels are not certified, because points beyond the widest halo could change them"
        yield Problem("doubtful tiles", None, why, remedy)


def _area(run: Run, square_metres: float) -> str:
    return small_area_text(square_metres, units_of(run)[0])


def _implausible(run: Run) -> Iterator[Problem]:
    for result in run.get("implausible", ()):
        where = place_of(result["bounds"])
        yield Problem(result["what"], where, result["why"], result["remedy"])


def _above(run: Run) -> Iterator[Problem]:
    """Yield the places where the terrain is certainly wrong, because it lies above all returns."""
    for place in run.get("above_returns", {}).get("worst", ()):
        height = length_text(round(place["height_m"], 1), units_of(run)[1])
        why = f"{_area(run, place['area_m2'])} of terrain lie above all returns, by up to {height}"
        remedy = (
            "look at the points; use --edits with action ground if they are ground, or void to leave it "
            "without heights"
        )
        yield Problem(
            "terrain above all returns",
            place_of(place["bounds"]),
            why,
            remedy,
            place["area_m2"],
            action=TO_GROUND,
            stake_m=place["height_m"],
            rings=place.get("rings", ()),
        )


def _left(run: Run) -> Iterator[Problem]:
    """Yield the objects that are probably left in the terrain, the worst first."""
    for place in run.get("left_objects", ()):
        height = length_text(round(place["height_m"], 1), units_of(run)[1])
        sure = "likely" if place["chance"] >= LIKELY else "perhaps"
        why = (
            f"{sure} an object: {_area(run, place['area_m2'])} of terrain rise by up to {height} above the land around "
            f"and have steep sides along {place['steep']:.0%} of the border"
        )
        action, remedy = NOT_GROUND, "use --edits with action not_ground if it is an object"
        if place["ground"] == 0:
            # Points beside it make its heights.
            action = VOID
            remedy = (
                "it has no ground point: use --edits with action flat and a height, or void"
            )
        yield Problem(
            LEFT,
            place_of(place["bounds"]),
            why,
            remedy,
            place["area_m2"],
            action=action,
            stake_m=place["height_m"],
            chance=place["chance"],
            rings=place["rings"],
        )


def _unsure(run: Run) -> Iterator[Problem]:
    """Yield the places where ground points are few and the terrain is rough, the worst first."""
    units = units_of(run)
    for place in run.get("unsure", ()):
        share, causes = place["objects"], []
        if share >= PLANTS:
            causes.append(f"plants or buildings ({share:.0%} of the points are not ground)")
        if place["slope"] >= STEEP:
            causes.append(f"a slope of {place['slope']:.0%}")
        reason = f", with {' and '.join(causes)}" if causes else ""
        lengths = zip(("gap_m", "error_m"), units, strict=True)
        gap, error = (length_text(round(place[name], 1), unit) for name, unit in lengths)
        why = (
            f"{_area(run, place['area_m2'])} of rough terrain are about {gap} from the nearest ground point{reason}; "
            f"a typical error is {error}"
        )
        yield Problem(
            UNSURE,
            place_of(place["bounds"]),
            why,
            "look at the points: use --edits with action ground or not_ground for those with a wrong class",
            place["area_m2"],
            stake_m=place["error_m"],
            chance=place["chance"],
            rings=place["rings"],
        )


def _voids(run: Run) -> Iterator[Problem]:
    """Yield the voids, those inside the survey before those at its border, without small ones there."""
    found = list(_all_voids(run))
    yield from (void for void in found if void.what != AT_BORDER)
    yield from (void for void in found if void.what == AT_BORDER and not _is_minor(void))


def _is_minor(problem: Problem) -> bool:
    """Return whether a problem is a small void at the border of the survey."""
    is_small = problem.area_m2 is not None and problem.area_m2 < SMALL_M2
    return is_small and problem.what == AT_BORDER


def _all_voids(run: Run) -> Iterator[Problem]:
    missing = [problem.where for problem in _files(run) if problem.where is not None]
    reach = BESIDE_M / units_of(run)[0]
    for void in run.get("voids", {}).get("largest", ()):
        why = f"{counted(void['pixels'], 'pixel')} ({_area(run, void['area_m2'])}) without a height"
        what, remedy = INSIDE, "use --voids fill to fill it from its boundary"
        if void.get("at_border"):
            # Filling needs a boundary on all sides.
            what = AT_BORDER
            remedy = "use --edits with action ground if land behind a wall was classified as a building"
            if any(_are_near(void["bounds"], place, reach) for place in missing):
                remedy = "repair the file beside it that was left out, then run again"
        remedy += ", or --edits with action void to accept it"
        where, area_m2, at = place_of(void["bounds"]), void["area_m2"], void.get("at")
        yield Problem(what, where, why, remedy, area_m2, at, rings=void.get("rings") or ())


def _are_near(a: Sequence[float], b: Sequence[float], reach: float) -> bool:
    return all(
        a[low] - reach <= b[high] and b[low] - reach <= a[high]
        for low, high in ((0, 2), (1, 3))
    )


def _without_returns(run: Run) -> Iterator[Problem]:
    for place in run.get("without_returns", ()):
        why = f"{_area(run, place['area_m2'])} without returns: the terrain there is interpolated from its rim"
        remedy = "ask for the missing strip, or use --edits with action void to leave it without heights"
        where, area_m2, at = place_of(place["bounds"]), place["area_m2"], place.get("at")
        rings = place.get("rings") or ()
        yield Problem(
            WITHOUT_RETURNS, where, why, remedy, area_m2, at, action=VOID, rings=rings
        )


def _edits(run: Run) -> Iterator[Problem]:
    """Yield edits that leave holes although the user did not ask for them, and edits that changed nothing."""
    for edit in run.get("edits") or ():
        holes, name = edit.get("holes", 0), f"edit {edit['number']} ({edit['action']})"
        if holes and edit["action"] != "void":
            why = f"{name} leaves {counted(holes, 'pixel')} without a height"
            yield Problem(
                "hole in an edit",
                place_of(edit["bounds"]),
                why,
                "use --voids fill or a larger --max-edge",
            )
        if edit.get("changed") is False:
            yield Problem(
                "edit without effect", place_of(edit["bounds"]), f"{name} changed nothing"
            )


def _doubts(run: Run) -> Iterator[Problem]:
    of_water = "check it; to change it, edit water.gpkg and give the file with --water"
    of_canopy = "use --canopy void for nodata there, or --edits with the action ground"
    for name, what, remedy in (
        ("water_doubts", "doubtful water", of_water),
        ("canopy_doubts", "ground hidden by canopy", of_canopy),
    ):
        for doubt in run.get(name, ()):
            yield Problem(what, place_of(doubt["place"]), doubt["text"], remedy)


def _kept(run: Run) -> Iterator[Problem]:
    for code, count in run.get("classes", {}).get("no_part", {}).items():
        if int(code) not in NOISE:
            why = f"{count:,} points of class {code} were not filtered and keep their class"
            remedy = "use --keep-classes to choose the classes that are kept"
            yield Problem("class that is not filtered", None, why, remedy)


def _strays(run: Run) -> Iterator[Problem]:
    for stray in run.get("strays", ()):
        why = f"point {stray['point']:,} of {stray['path']}, at the height {stray['z']:g}, is far from all other points"
        yield Problem("stray point", place_of((stray["x"], stray["y"])), why, "it was left out")


def _healed(run: Run) -> Iterator[Problem]:
    if healed := ", ".join(run.get("healed", ())):
        yield Problem("damaged store", None, f"damaged and computed again: {healed}")


SOURCES: tuple[Callable[[Run], Iterator[Problem]], ...] = (
    _requirements,
    _files,
    _tasks,
    _implausible,
    _above,
    _left,
    _unsure,
    _warnings,
    _objects,
    _voids,
    _without_returns,
    _edits,
    _doubts,
    _labels,
    _kept,
    _strays,
    _healed,
    lambda run: filter(_is_minor, _all_voids(run)),
)
"""Sources of problems, the most serious first."""


def kinds_text(problems: Sequence[Mapping[str, Any]]) -> str:
    """Return the number of the problems in run.json and their kinds, such as ``3: failed task (2), class kept``.

    Those that a user found to be right are only counted.
    """
    kinds = Counter(problem["what"] for problem in problems if problem.get("status") != OK)
    texts = [what if n == 1 else f"{what} ({n:,})" for what, n in kinds.items()]
    text = f"{kinds.total():,}: {', '.join(texts)}" if kinds else "none"
    n_right = len(problems) - kinds.total()
    return f"{text}; {right_text(n_right)}" if n_right else text


def right_text(number: int) -> str:
    """Return how many places were found to be right."""
    return f"{counted(number, 'place')} found right (ok)"


def review_text(review: Mapping[str, int]) -> str:
    """Return the numbers of places to review, such as ``12 open, 1 ok, 2 fixed``."""
    return ", ".join(f"{review[status]:,} {status}" for status in STATUSES)


def table_rows(run: Run) -> list[Problem]:
    """Return the problems of a run without long lists of places, so that these hide no other problem.

    Small voids at the border share one row, and so do the places of any kind after the worst
    `MAX_OF_KIND`. These rows are the last.
    """
    rows: list[Problem] = []
    shared: dict[str, list[Problem]] = {}
    own = Counter[str]()
    for problem in open_problems(run):
        is_further = _is_minor(problem) or own[problem.what] >= MAX_OF_KIND
        if problem.area_m2 is not None and is_further:
            shared.setdefault(problem.what, []).append(problem)
        else:
            rows.append(problem)
            own[problem.what] += 1
    return rows + [_joined(run, places) for places in shared.values()]


def _joined(run: Run, places: Sequence[Problem]) -> Problem:
    if len(places) == 1:
        return places[0]
    area = _area(run, sum(place.area_m2 or 0.0 for place in places))
    which = "small ones" if places[0].what == AT_BORDER else "more"
    why = f"{len(places):,} {which}, {area} together, in run.json (which lists at most {MAX_ROWS:,} of a kind)"
    return places[0]._replace(where=None, why=why)


def problems(run: Run) -> Node:
    """Return the section of the report about missing and doubtful results, with remedies."""
    found, all_problems = problems_of(run), table_rows(run)
    if not found:
        none = (
            "None: every file was read, every tile was processed, and no check of the run found a doubtful result. "
            "The checks do not find every error, such as houses in the terrain: look at the map."
        )
        return section("problems", "Problems", el("p", none))
    told = None
    if review := run.get("review"):
        told = el(
            "p",
            f"The run's folder has the places in review.gpkg, where they get a status: {review_text(review)}.",
        )
    if not all_problems:
        return section("problems", "Problems", el("p", "None is open."), told)
    rows: list[tuple[Content, ...]] = [
        (p.what, _link(p.where, p.at), p.why, p.remedy) for p in all_problems[:MAX_ROWS]
    ]
    total = None
    if len(open_problems(run)) > len(all_problems):
        kinds = kinds_text([problem.to_json() for problem in found])
        total = el("p", f"{kinds}. Places of one kind share a row after the worst.")
    return section(
        "problems",
        "Problems",
        total,
        told,
        table(("problem", "location", "cause", "remedy"), rows),
        more(len(all_problems), MAX_ROWS),
    )


def _link(where: Place | None, at: Sequence[float] | None) -> Content:
    """Return an extent as a link that shows it on the map."""
    if where is None:
        return "-"
    west, south, east, north = where
    x, y = at or ((west + east) / 2, (south + north) / 2)
    text = f"{x:.1f}, {y:.1f}"
    return el("a", text, href="#map", data_place=",".join(f"{edge:.10g}" for edge in where))


def marked_places(run: Run) -> list[list[Any]]:
    """Return kind, west, south, east and north of each problem that has a location, for the map.

    Of more than `MAX_ROWS` problems the first of each kind are shown.
    """
    located = [problem for problem in open_problems(run) if problem.where is not None]
    own = Counter[str]()
    ranked = []
    for number, problem in enumerate(located):
        ranked.append((own[problem.what], number))
        own[problem.what] += 1
    shown = [located[number] for _, number in sorted(ranked)[:MAX_ROWS]]
    return [[problem.what, *(problem.where or ())] for problem in shown]
