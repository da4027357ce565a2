"""The parts of the report that are text and tables, each from the content of run.json."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from tiler.core.mask_values import HOLE, MASK_VALUES, OUTSIDE
from tiler.observe.progress import count_text, duration_text, size_text
from tiler.report.document import Content, Node, el, section, table
from tiler.report.pictures import Pictures
from tiler.report.runfile import title_of

MOST_ROWS = 1000
"""Rows of a table at most; the rest is in run.json."""

SQUARE_KM = 1e6

Run = Mapping[str, Any]

STATES = {
    "done": "Finished",
    "running": "Still at work, or ended by force",
    "interrupted": "Interrupted: the same command goes on where it was",
}


def header(run: Run, title: str) -> Node:
    """The title, the state, what came out in a sentence, and the figures that most people look for."""
    good = run["state"] == "done" and not _left_out(run)
    cards = [el("div", el("b", value), el("span", name), class_="card") for name, value in figures(run)]
    return el(
        "header",
        el("p", state_text(run), class_="state good" if good else "state bad", id="state"),
        el("h1", title),
        el("p", sentence(run), class_="lead"),
        el("div", *cards, class_="cards"),
    )


def state_text(run: Run) -> str:
    """The state of the run in a few words."""
    if run["state"] == "done" and _left_out(run):
        return "Finished, with something left out"
    return STATES.get(run["state"], str(run["state"]))


def _left_out(run: Run) -> str:
    """``1 file and 2 tiles``; empty where nothing is missing."""
    files, tasks = len(run.get("quarantined", ())), len(run.get("failed_tasks", ()))
    parts = [f"{n} {name}{'' if n == 1 else 's'}" for n, name in ((files, "file"), (tasks, "task")) if n]
    return " and ".join(parts)


def sentence(run: Run) -> str:
    """What came out, in a sentence or two."""
    plan, dtm, left_out = run["plan"], run.get("dtm"), _left_out(run)
    what = "A run that made no terrain model yet"
    if dtm:
        what = f"A terrain model of {dtm['resolution_m']:g} m pixels"
    seconds = f" in {duration_text(run['seconds'])}" if "seconds" in run and not done_before(run) else ""
    missing = f" Left out: {left_out}; see Problems." if left_out else " Nothing was left out."
    return (
        f"{what} from {plan['points']:,} points of {counted(plan['inputs'], 'file')}, "
        f"{plan['area_m2'] / SQUARE_KM:,.3g} km2, by the method {plan['method']}{seconds}.{missing}"
    )


def counted(number: int, name: str) -> str:
    """A number and a noun, in the plural unless it is 1."""
    return f"{number:,} {name}" if number == 1 else f"{number:,} {name}s"


def figures(run: Run) -> Iterator[tuple[str, str]]:
    """Name and value of the figures that most people look for."""
    plan = run["plan"]
    if "counts" in run:
        yield "points read", count_text(run["counts"]["read"])
    if "filter" in run and run["filter"]["points"]:
        yield "of them ground", f"{run['filter']['ground'] / run['filter']['points']:.1%}"
    yield "points per m2", f"{plan['density_per_m2']:.3g}"
    if "dtm" in run:
        dtm = run["dtm"]
        yield f"pixels of {dtm['resolution_m']:g} m", f"{dtm['width']:,} x {dtm['height']:,}"
        pixels = max(dtm["width"] * dtm["height"], 1)
        if "mask" in run:
            # Of the raster's rectangle a ragged survey leaves much, of which nothing is missing.
            inside = pixels - run["mask"][MASK_VALUES[OUTSIDE]]
            holes = run["mask"][MASK_VALUES[HOLE].split(":")[0]]
            yield "of the survey with a height", f"{(inside - holes) / max(inside, 1):.1%}"
        else:
            yield "of them with a height", f"{dtm['filled'] / pixels:.1%}"
    if "seconds" in run:
        yield "time of the last run" if done_before(run) else "time", duration_text(run["seconds"])
    yield "peak memory of a process", size_text(run["peak_rss_bytes"])


def done_before(run: Run) -> int:
    """Tasks that an earlier run in the same OUT had done."""
    return sum(stage["done"] for stage in run.get("stages", {}).values())


def problems(run: Run) -> Node:
    """What is missing or doubtful, and what to do; the first thing to read after the figures."""
    content: list[Content] = [el("p", text, class_="warning") for text in warned(run)]
    marked = run.get("filter", {}).get("marked", 0)
    if marked:
        text = f"{marked:,} labels are not certified: points beyond the widest halo could change them."
        content.append(el("p", text, class_="warning"))
    quarantined = run.get("quarantined", ())
    if quarantined:
        left = [(q["path"], q["error"].removeprefix(f"{q['path']}: ")) for q in quarantined[:MOST_ROWS]]
        content += [el("h3", f"Files left out: {len(quarantined):,}"), table(("file", "why"), left)]
    failed = run.get("failed_tasks", ())
    if failed:
        rows = [
            (title_of(run, f["stage"]), f["key"], _place(f.get("bounds")), f["error"])
            for f in failed[:MOST_ROWS]
        ]
        columns = ("stage", "tile or task", "west, south, east, north", "why")
        content += [el("h3", f"Tasks that failed: {len(failed):,}"), table(columns, rows)]
    if healed := ", ".join(run.get("healed", ())):
        content.append(el("p", f"Objects of the store that were damaged, and made again: {healed}"))
    strays = run.get("strays", ())
    if strays:
        far = [
            (s["path"], f"{s['point']:,}", f"{s['x']:g}, {s['y']:g}, {s['z']:g}") for s in strays[:MOST_ROWS]
        ]
        heading = el("h3", f"Points far from all others: {len(strays):,}")
        content += [heading, table(("file", "point", "x, y, z"), far, (1,))]
    none = "None: every file was read and every tile was made."
    return section("problems", "Problems", *(content or [el("p", none)]))


def _place(bounds: list[float] | None) -> str:
    return ", ".join(f"{v:,.1f}" for v in bounds) if bounds else "-"


def _halo_m(run: Run) -> float:
    """The widest halo of the passes that the run did, as far as the plan knew it."""
    plan, survey = run["plan"], (run.get("statistics") or {}).get("survey", {}).get("survey", {})
    return float(plan.get("halo_by_kind_m", {}).get(survey.get("kind"), plan["halo_m"]))


class Settled(NamedTuple):
    """A setting that can be left to tiler: its value, who set it (``you`` or ``automatic``), and why."""

    setting: str
    value: str
    by: str
    why: str


def settled(run: Run) -> list[Settled]:
    """The values of those settings that tiler can choose by itself."""
    plan, config = run["plan"], run["configuration"]
    memory, declared = plan["memory_bytes"], "what the files declare"
    units = " and ".join(dict.fromkeys(plan.get("units", {}).values()))
    found = {
        "resolution": (f"{plan['resolution_m']:g} m", "1 m, or the points' spacing if wider"),
        "tile_size": (f"{plan['tile_m']:g} m", "what fits into a worker's memory"),
        "halo": (f"{_halo_m(run):g} m", "the method's own reach"),
        "workers": (str(plan["workers"]), "the cores that tiler may use"),
        "memory": (size_text(memory), "a fair share of the machine, 4 GiB at most"),
        "units": (units, declared),
        "crs": (_crs_name(plan["crs"]), declared),
    }
    return [
        Settled(name.replace("_", " "), value, *(("automatic", why) if config[name] is None else ("you", "")))
        for name, (value, why) in found.items()
    ]


def noted(run: Run) -> list[str]:
    """The notes of the plan and of the run, each once."""
    return list(dict.fromkeys([*run["plan"].get("notes", ()), *run.get("notes", ())]))


def warned(run: Run) -> list[str]:
    """What looks wrong in the settings or the data."""
    return [*run["plan"].get("warnings", ()), *run.get("advice", ())]


def decisions(run: Run) -> Node:
    """The section on what was decided automatically, and why."""
    told = [el("li", text) for text in noted(run)[:MOST_ROWS]]
    found = list(_measured(run))
    content: list[Content] = [table(("setting", "value", "by", "why"), settled(run))]
    if told:
        content += [el("h3", "Noted on the way"), el("ul", *told)]
    if found:
        measured = table(("by pass", "figure", "value"), found[:MOST_ROWS])
        content += [el("h3", "Measured over the whole run"), measured]
    return section("decisions", "Decided automatically", *content)


FIGURES_IN_WORDS = {
    "survey / kind": "kind of cloud",
    "survey / density_m2": "points per m2",
    "survey / sigma_m": "noise of heights, m",
    "survey / cell_sigma_m": "noise of heights within cells, m",
    "survey / label_sigma_m": "noise of heights that labels allow for, m",
    "survey / several": "share of points that are one of several returns",
}
"""Readable names of figures that passes measure; others keep the names that the passes give them."""


def _measured(run: Run) -> Iterator[tuple[str, str, str]]:
    """Pass, figure and value; a figure that later passes only hand on is listed once, with the first pass."""
    known: dict[str, str] = {}
    states = {step: dict(_flat("", state)) for step, state in run.get("statistics", {}).items()}
    for step, state in sorted(states.items(), key=lambda found: len(found[1])):
        new = {name: text for name, text in state.items() if known.get(name) != text}
        known |= new
        for name, text in new.items():
            if text != "-" and not name.startswith("run / ") and not name.endswith("notes"):
                yield step, FIGURES_IN_WORDS.get(name, name), text


def _crs_name(wkt: str | None) -> str:
    """The name that a WKT begins with: ``PROJCRS["name", ...``."""
    return "none" if wkt is None else wkt.split('"')[1] if wkt.count('"') > 1 else wkt


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, str]]:
    """Nested facts as names and texts; long lists by their length."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _flat(f"{prefix} / {name}" if prefix else str(name), inner)
    elif isinstance(value, list) and len(value) > 12:
        yield prefix, f"{len(value):,} values"
    else:
        yield prefix, value_text(value)


def value_text(value: Any) -> str:
    """A plain value as people read it."""
    if isinstance(value, list | tuple):
        return ", ".join(value_text(v) for v in value) or "none"
    if value is None or isinstance(value, bool):
        return {None: "-", True: "yes", False: "no"}[value]
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def terrain_map(pictures: Pictures | None) -> Node:
    """The map that the script draws, and each picture with its legend, for printing and where scripts are off."""
    keys = "Drag or arrow keys: move. Wheel, + and -: zoom. 0: all. N and P: next and previous tile."
    frame = el(
        "div",
        el("div", id="controls", class_="controls"),
        el("canvas", id="canvas", tabindex=0, role="img", aria_label=f"Map of the terrain. {keys}"),
        el("output", keys, id="told", aria_live="polite"),
        el("div", id="legend", class_="legend"),
        id="viewer",
    )
    figures = [
        el(
            "figure",
            el("img", src=p.uri, alt=p.title, width=p.size[0], height=p.size[1], id=f"picture-{p.name}"),
            el("figcaption", el("b", p.title), *(_swatch(colour, text) for colour, text in p.legend)),
        )
        for p in (pictures.pictures if pictures else ())
    ]
    if figures:
        return section("map", "Map", frame, el("div", *figures, class_="gallery"))
    missing = el("p", "No terrain model was written yet: the map shows files and tiles.")
    return section("map", "Map", missing, frame)


def _swatch(colour: tuple[int, int, int], text: str) -> Node:
    box = el("rect", width=12, height=12, fill="#{:02x}{:02x}{:02x}".format(*colour))
    return el("span", el("svg", box, width=12, height=12, aria_hidden="true"), f" {text}", class_="swatch")
