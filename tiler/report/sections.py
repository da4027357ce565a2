"""Sections of the report with text and tables, made from the content of run.json."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from ptd.places import TABLES
from tiler.core.units import area_text, length_text
from tiler.core.words import counted, name_in_wkt
from tiler.observe.progress import count_text, duration_text, size_text
from tiler.report.document import Node, el, section, swatch, table
from tiler.report.pictures import Pictures, css
from tiler.report.problems import MAX_ROWS, Run, unmet
from tiler.report.runfile import units_of

STATES = {
    "done": "Finished",
    "running": "Still running, or killed",
    "failed": "Failed with an error: run the same command again to resume",
    "interrupted": "Interrupted: run the same command again to resume",
}


def header(run: Run, title: str) -> Node:
    """Return the head of the report: title, state, result in a sentence, and the key figures."""
    cards = [
        el("div", el("b", value), el("span", name), class_="card")
        for name, value in figures(run)
    ]
    return el(
        "header",
        el(
            "p",
            state_text(run),
            class_=f"state {'good' if is_good(run) else 'bad'}",
            id="state",
        ),
        el("h1", title),
        el("p", sentence(run), class_="lead"),
        el("div", *cards, class_="cards"),
    )


def is_good(run: Run) -> bool:
    """Return whether a run is finished, left nothing out, and meets the requirements of the last check."""
    return run["state"] == "done" and not (left_out(run) or unmet(run))


def state_text(run: Run) -> str:
    """Return the state of the run in a few words."""
    faults = ["incomplete"] if left_out(run) else []
    if count := len(unmet(run)):
        faults.append(
            f"{counted(count, 'requirement')} {'is' if count == 1 else 'are'} not met"
        )
    if run["state"] == "done" and faults:
        return f"Finished, but {', and '.join(faults)}"
    return STATES.get(run["state"], str(run["state"]))


def left_out(run: Run) -> str:
    """Return the number of missing files and tasks in words, or an empty text if nothing is missing."""
    files, tasks = len(run.get("quarantined", ())), len(run.get("failed_tasks", ()))
    cut = sum(file.get("incomplete", False) for file in run.get("inputs", ()))
    parts = [
        (files, "file", "files"),
        (cut, "part of a file", "parts of files"),
        (tasks, "task", "tasks"),
    ]
    texts = [f"{n} {one if n == 1 else many}" for n, one, many in parts if n]
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def sentence(run: Run) -> str:
    """Return the result of the run in one or two sentences."""
    absent = left_out(run)
    seconds = (
        f" in {duration_text(run['seconds'])}"
        if "seconds" in run and not done_before(run)
        else ""
    )
    missing = f" Left out: {absent}; see Problems." if absent else " Nothing was left out."
    return f"{made_text(run)}{seconds}.{missing}"


def made_text(run: Run) -> str:
    """Return a summary of the terrain and of its points, without a full stop."""
    plan, dtm = run["plan"], run.get("dtm")
    subject, area_m2 = "A run without a terrain model so far", plan["area_m2"]
    if dtm:
        subject = f"A terrain model with pixels of {length(run, dtm['resolution_m'])}"
    if dtm and "voids" in run:
        area_m2 = run["voids"]["surveyed_pixels"] * dtm["resolution_m"] ** 2
    return (
        f"{subject} from {plan['points']:,} points of {counted(plan['inputs'], 'file')}, "
        f"{area_text(area_m2, units_of(run)[0])}, by the method {plan['method']}"
    )


def figures(run: Run) -> Iterator[tuple[str, str]]:
    """Yield names and values of the key figures."""
    plan = run["plan"]
    if "counts" in run:
        yield "points read", count_text(run["counts"]["read"])
    if "filter" in run and run["filter"]["points"]:
        classes = run.get("classes", {})
        ground, points = run["filter"]["ground"], run["filter"]["points"]
        if "ground" in classes:
            ground, points = classes["ground"], max(sum(classes["written"].values()), 1)
        yield "ground points", f"{ground / points:.1%}"
    yield "points per m2", f"{plan['density_per_m2']:.3g}"
    if "dtm" in run:
        dtm = run["dtm"]
        yield (
            f"pixels of {length(run, dtm['resolution_m'])}",
            f"{dtm['width']:,} x {dtm['height']:,}",
        )
        pixels = max(dtm["width"] * dtm["height"], 1)
        if "voids" in run:
            # A ragged survey covers only a part of the raster. The pixels outside are not
            # missing.
            yield f"of {surveyed_text(run)} has a height", share_with_height(run["voids"])
        else:
            yield "of the pixels have a height", f"{dtm['filled'] / pixels:.1%}"
    if "seconds" in run:
        yield (
            "time of the last run" if done_before(run) else "time",
            duration_text(run["seconds"]),
        )


def length(run: Run, metres: float) -> str:
    """Return a length as text in the unit of the CRS."""
    return length_text(metres, units_of(run)[0])


def area(run: Run, square_metres: float) -> str:
    """Return an area as text in units that suit the CRS."""
    return area_text(square_metres, units_of(run)[0])


def share_with_height(voids: Mapping[str, Any]) -> str:
    """Return the share of the survey's pixels that have a height, rounded down so that 100 % means all pixels."""
    inside = voids["surveyed_pixels"]
    known = inside - voids["pixels"] - voids["asked_pixels"]
    return f"{1000 * known // max(inside, 1) / 10:.1f} %"


def surveyed_text(run: Run) -> str:
    """Return what a share of the survey is a share of. What is left out does not count."""
    return "the area that was read" if left_out(run) else "the survey"


def done_before(run: Run) -> int:
    """Return the number of tasks that were up to date before this run."""
    return sum(stage["done"] for stage in run.get("stages", {}).values())


def _halo_m(run: Run) -> float:
    """Return the widest planned halo of the passes that the run did."""
    plan, survey = (
        run["plan"],
        (run.get("statistics") or {}).get("survey", {}).get("survey", {}),
    )
    return float(plan.get("halo_by_kind_m", {}).get(survey.get("kind"), plan["halo_m"]))


class ResolvedSetting(NamedTuple):
    """Setting that tiler can choose: its value, who chose it (``you`` or ``automatic``), and why."""

    setting: str
    value: str
    by: str
    why: str


SETTINGS = ("setting", "value", "by", "why")
OF_MACHINE = ("tile size", "halo", "workers", "memory")
"""Settings in `settled` about the division of the work, for the end of the report."""


def settled(run: Run) -> list[ResolvedSetting]:
    """Return the values of the settings that tiler can choose."""
    plan, config = run["plan"], run["configuration"]
    memory = plan["memory_bytes"]
    units = " and ".join(dict.fromkeys(plan.get("units", {}).values()))
    choices = {
        "resolution": (
            length(run, plan["resolution_m"]),
            "1 m (2 ft), or the point spacing if larger; finer for dense photogrammetric clouds",
        ),
        "tile_size": (length(run, plan["tile_m"]), "fits into the memory of a worker"),
        "halo": (length(run, _halo_m(run)), "the radius that the method needs"),
        "workers": (str(plan["workers"]), "the cores that tiler may use"),
        "memory": (size_text(memory), "a fair share of the machine, at most 4 GiB"),
        "units": (units, plan.get("units_from", "")),
        "crs": (
            name_in_wkt(plan["crs"], "none"),
            "declared by the files" if plan["crs"] else "the files declare none",
        ),
    }
    return [
        ResolvedSetting(
            name.replace("_", " "),
            value,
            *(("automatic", why) if config[name] is None else ("you", "")),
        )
        for name, (value, why) in choices.items()
    ]


def noted(run: Run) -> list[str]:
    """Return the notes of the plan and of the run, each once."""
    return list(dict.fromkeys([*run["plan"].get("notes", ()), *run.get("notes", ())]))


def warned(run: Run) -> list[str]:
    """Return warnings about the settings and the data."""
    doubts = [*run.get("canopy_doubts", ()), *run.get("water_doubts", ())]
    return [
        *run["plan"].get("warnings", ()),
        *run.get("doubts", ()),
        *(result["why"] for result in run.get("implausible", ())),
        *(doubt["text"] for doubt in doubts),
        *run.get("advice", ()),
    ]


def decisions(run: Run) -> Node:
    """Return the section about automatic decisions and their reasons."""
    told = [el("li", text) for text in noted(run)[:MAX_ROWS]]
    rows = [found for found in settled(run) if found.setting not in OF_MACHINE]
    notes = (el("h3", "Notes"), el("ul", *told)) if told else ()
    return section("decisions", "Decided automatically", table(SETTINGS, rows), *notes)


def measured(run: Run) -> Node | None:
    """Return the part about the figures that passes measured, or None without any."""
    rows = list(_measured(run))[:MAX_ROWS]
    found = table(("pass", "figure", "value"), rows)
    title = "Measured over the whole run"
    return section("measured", title, found, heading="h3") if rows else None


FIGURES_IN_WORDS = {
    "survey / kind": "kind of cloud",
    "survey / sure": "confidence of the kind",
    "survey / density_m2": "points per m2, without empty cells",
    "survey / sigma_m": "noise of heights",
    "survey / cell_sigma_m": "noise of heights within cells",
    "canopy / share": "share of the area in which a canopy hides the ground",
    "survey / cell_m": "side of cells",
    "places": "squares of 256 m with separate figures",
    "trees": "squares of 256 m with a height of trees",
    "survey / several": "share of points from pulses with several returns",
}
"""Readable names of figures that passes measure. Other figures keep the names that the passes
give them."""


def _measured(run: Run) -> Iterator[tuple[str, str, str]]:
    """Yield pass, figure and value.

    A figure that later passes only repeat is listed once, with the first pass.
    """
    known: dict[str, str] = {}
    states = {step: dict(_flat("", state)) for step, state in run.get("statistics", {}).items()}
    # The survey is sorted first, because later passes repeat its figures.
    for step, state in sorted(
        states.items(), key=lambda found: (found[0] != "survey", len(found[1]))
    ):
        new = {name: text for name, text in state.items() if known.get(name) != text}
        known |= new
        for name, text in new.items():
            if text != "-" and not name.startswith("run / ") and not name.endswith("notes"):
                if name in FIGURES_IN_WORDS and name.endswith("_m"):
                    text = length(run, float(text))
                yield step, FIGURES_IN_WORDS.get(name, name), text


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield nested facts as names and texts.

    For long lists and for facts by position, only the number of values is given.
    """
    if prefix in TABLES:
        yield prefix, f"{len(value):,}"
    elif isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _flat(f"{prefix} / {name}" if prefix else str(name), inner)
    elif isinstance(value, list) and len(value) > 12:
        yield prefix, f"{len(value):,} values"
    else:
        yield prefix, value_text(value)


def value_text(value: Any) -> str:
    """Return a plain value as readable text."""
    if isinstance(value, list | tuple):
        return ", ".join(value_text(v) for v in value) or "none"
    if value is None or isinstance(value, bool):
        return {None: "-", True: "yes", False: "no"}[value]
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def terrain_map(pictures: Pictures | None) -> Node:
    """Return the map of the script, and pictures with legends for printing and for browsers without scripts."""
    keys = "Drag or arrow keys: move. Wheel, + and -: zoom. 0: all. N and P: next and previous tile."
    frame = el(
        "div",
        el("div", id="controls", class_="controls"),
        el(
            "canvas",
            id="canvas",
            tabindex=0,
            role="img",
            aria_label=f"Map of the terrain. {keys}",
        ),
        el("output", keys, id="told", aria_live="polite"),
        el("div", id="legend", class_="legend"),
        id="viewer",
    )
    figures = [
        el(
            "figure",
            el(
                "img",
                src=p.uri,
                alt=p.title,
                width=p.size[0],
                height=p.size[1],
                id=f"picture-{p.name}",
            ),
            el(
                "figcaption",
                el("b", p.title),
                *(swatch(css(colour), text) for colour, text in p.legend),
            ),
        )
        for p in (pictures.pictures if pictures else ())
    ]
    if figures:
        return section("map", "Map", frame, el("div", *figures, class_="gallery"))
    missing = el(
        "p", "No terrain model was written yet, so the map shows only files and tiles."
    )
    return section("map", "Map", missing, frame)
