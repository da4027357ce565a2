"""Writes ``report.html``: a page about a run that does not need a server, a network or other files.

Last come the data that its map draws over the pictures: tiles with state and time, outlines of files, features,
checkpoints.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

from tiler.core.words import counted
from tiler.errors import InputError
from tiler.io.foreign_content import parse_json_object
from tiler.io.locations import is_url, joined, local_or_url, state_at, upload_file
from tiler.io.result_folder import (
    AGAIN_WITHOUT_RUN,
    CHECK,
    EVALUATION,
    EVENTS,
    REPORT,
    REVIEW,
    RUN,
    give_results,
    local_folder,
    read_run,
    results_name,
    store_of,
    written_rasters,
)
from tiler.redaction import shown
from tiler.report import accuracy, document, sections, tables
from tiler.report.accuracy import (
    at_checkpoints,
    checkpoints_on_map,
    rule_of_thumb,
    standard_errors,
)
from tiler.report.cards import small_card
from tiler.report.document import Node, el, section
from tiler.report.drawn import drawn, shapes
from tiler.report.pictures import VIRIDIS, Pictures, css, draw, ramp_colour, reading_rasters
from tiler.report.places import Detail, read_open_places
from tiler.report.problems import marked_places, problems
from tiler.report.runfile import (
    run_file_errors,
    title_of,
    units_of,
    write_run_file,
    write_whole,
)
from tiler.report.tables import specification
from tiler.schedule import call_isolated, half_of_memory
from tiler.store import locked_folder


def write_report(
    out: Path, run: Mapping[str, Any] | None = None, products: str | None = None
) -> Path:
    """Write ``OUT/report.html``, which appears only once it is complete.

    Parameters
    ----------
    out : Path
        The result folder of a run.
    run : mapping, optional
        Content of its run.json, which is read by default.
    products : str, optional
        Path or URL of the folder of the rasters. By default the one in run.json, which has no passwords or tokens.

    Returns
    -------
    Path
        Path of the report.

    Raises
    ------
    InputError
        ``out`` does not contain a run.json that tiler wrote.
    ProcessingError
        A raster cannot be read, or the report cannot be written.
    """
    content = _read_run(out) if run is None else run
    with reading_rasters(out), run_file_errors(out):
        page = _page(out, content, products or content.get("products_at") or str(out))
    target = out / REPORT
    write_whole(target, page)
    return target


def write_report_at(out: str, title: str | None = None) -> str:
    """Write the report of a run into its OUT.

    If OUT is a URL, the report is written in a local folder and copied to OUT.

    Parameters
    ----------
    out : str
    title : str, optional
        Title of this report and of all later ones, kept in run.json. A text without a character restores the default.

    Returns
    -------
    str
        Path or URL of the report.
    """
    out = local_or_url(out)
    run, here, is_remote = _read_run(out), local_folder(out), is_url(out)
    if is_remote:
        here.mkdir(parents=True, exist_ok=True)
    # A run keeps the title that it read at its start, so none may be at work.
    with nullcontext() if title is None else locked_folder(out):
        changed = [REPORT]
        if title is not None:
            run = {**_read_run(out), "report_title": " ".join(title.split()) or None}
            changed.append(RUN)
        write_report(here, run, out if is_remote else None)
        if title is not None:
            write_run_file(here, run)
        for name in changed if is_remote else ():
            upload_file(here / name, joined(out, name))
    return joined(out, REPORT) if is_remote else str(here / REPORT)


def _read_run(out: Path | str) -> dict[str, Any]:
    if is_url(out):
        run = read_run(str(out))
        if run is None:
            raise InputError(
                f"{joined(str(out), RUN)}: cannot be read; give the OUT folder of a run"
            )
        return run
    path = Path(out, RUN)
    try:
        return parse_json_object(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); {give_results(out)}"
        ) from error
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({error}); {AGAIN_WITHOUT_RUN}") from error


def _page(out: Path, run: Mapping[str, Any], products: str) -> bytes:
    run = with_earlier_times(run, out)
    rasters = _rasters(products, run)
    pictures = draw(rasters, run)
    check = accuracy.read_measured(out, CHECK, run)
    run = {**run, "check": check}
    evaluation = accuracy.read_measured(out, EVALUATION, run)
    title = run.get("report_title") or f"Terrain of {results_name(out)}"
    parts = [
        specification(run),
        problems(run),
        *_places(out, run, rasters),
        sections.terrain_map(pictures),
        section(
            "accuracy",
            "Accuracy",
            *rule_of_thumb(run, at_checkpoints(check, rasters)),
            *standard_errors(run),
            *accuracy.accuracy_content(check, evaluation),
        ),
        sections.decisions(run),
        *drawn(run),
        tables.counts(run),
        tables.outputs(run),
        section(
            "making",
            "How it was made",
            sections.measured(run),
            tables.inputs(run),
            tables.timings(run),
            tables.settings(run),
        ),
    ]
    made = f"Made by tiler {run['version']} from run.json, written {run.get('written', 'at an unknown time')} (UTC)."
    about = (el("p", made), el("p", "This page does not load or send any data."))
    parts.append(section("about", "About this page", *about))
    return document.page(
        title, sections.header(run, title), parts, map_data(run, pictures, check)
    )


def _places(out: Path, run: Mapping[str, Any], rasters: Mapping[str, str]) -> list[Node]:
    """Return the section with pictures of the first open places, or an empty list if no place is open."""
    path, dtm = out / REVIEW, rasters.get("dtm")
    is_open = (run.get("review") or {}).get("open")
    if not is_open or dtm is None or is_url(dtm) or not path.is_file():
        return []
    try:
        found = call_isolated(
            read_open_places,
            path,
            dtm,
            run,
            store_of(out, run),
            SMALL,
            paths=(path, Path(dtm)),
            memory_bytes=half_of_memory(),
        )
    except InputError as error:  # Somebody else may have changed the file.
        return [section("places", "Places to look at", el("p", str(error), class_="warning"))]
    if not found.cards:
        return []
    rest = "" if found.number == len(found.cards) else f" of {found.number:,}"
    text = (
        f"{counted(len(found.cards), 'place')}{rest}, the most serious first; `tiler review` makes a page on which you "
        "decide about them. Sections along the dashed lines show the terrain (line), the suggested edit (red), ground "
        "points (brown) and other points (blue)."
    )
    views = el(
        "div",
        *(small_card(place, run, units_of(run)) for place in found.cards),
        class_="places",
    )
    return [section("places", "Places to look at", el("p", text), views)]


def _rasters(place: str, run: Mapping[str, Any]) -> dict[str, str]:
    """Return the path or URL of the raster of each product, or of the VRT over its sheets, if it exists."""
    named = {product: joined(place, name) for product, name in written_rasters(run).items()}
    return {
        product: raster for product, raster in named.items() if state_at(raster) is not None
    }


SMALL = Detail(places=50, pixels=128, points=300)
"""Places in a report: all together take up to 2 MB of the page."""
MAX_TILES = 20_000
"""Maximum number of tiles on the map in all stages, so that the page stays below 5 MB.

A stage is shown with all its tiles or not at all.
"""

MAX_FILES = 5_000
TIME_COLOURS = 16


Extent = tuple[float, float, float, float]


def with_earlier_times(run: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Return the content of run.json, with time and memory of tiles of earlier runs from the log of events.

    The last event of a task belongs to the current result, because each repetition of a task
    logs a new event.
    """
    tiles = {
        stage: [dict(tile) for tile in of_stage]
        for stage, of_stage in run.get("tiles", {}).items()
    }
    unknown: dict[tuple[str, str], dict[str, Any]] = {
        (stage, tile["key"]): tile
        for stage, of_stage in tiles.items()
        for tile in of_stage
        if tile["state"] == "done" and tile["seconds"] is None
    }
    for event in _events(out / EVENTS) if unknown else ():
        if event.get("event") == "task_done":
            tile = unknown.get((str(event.get("stage")), str(event.get("key"))))
            figures = {name: event.get(name) for name in ("seconds", "peak_rss_bytes")}
            if tile is not None and all(isinstance(v, int | float) for v in figures.values()):
                tile.update(figures)
    return {**run, "tiles": tiles}


def _events(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the events of a log, without incomplete lines of killed runs and damaged lines."""
    if not path.is_file():
        return
    with open(path, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            with suppress(ValueError):
                yield parse_json_object(line)


def map_data(
    run: Mapping[str, Any], pictures: Pictures | None, accuracy: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the data for page.js, with coordinates in units of the CRS.

    Parameters
    ----------
    run : mapping
        Content of run.json, with the times of `with_earlier_times`.
    pictures : Pictures or None
    accuracy : mapping
        Result of `tiler.apps.check`, with the checkpoints under ``accuracy``. It may be empty.
    """
    return {
        "extent": pictures.extent if pictures else _extent(run),
        "unit": run["plan"].get("units", {}).get("horizontal", ""),
        "pictures": [
            {
                "name": p.name,
                "title": p.title,
                "legend": [[css(c), text] for c, text in p.legend],
            }
            for p in (pictures.pictures if pictures else ())
        ],
        "stages": _stages(run),
        "files": _files(run),
        "shapes": shapes(run),
        "problems": marked_places(run),
        **checkpoints_on_map(accuracy),
        "time_colours": [
            css(ramp_colour(VIRIDIS, i / (TIME_COLOURS - 1))) for i in range(TIME_COLOURS)
        ],
    }


def _extent(run: Mapping[str, Any]) -> Extent:
    """Return the bounds of the plan, for runs without a raster."""
    west, south, east, north = run["plan"].get("extent") or (0.0, 0.0, 1.0, 1.0)
    return west, south, east, north


def _stages(run: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the stages with their tiles. The last pass of the filter is first, because it made the labels."""
    stages, room = [], MAX_TILES
    tiles = run.get("tiles", {})
    passes = sum(name.startswith("filter") for name in tiles)
    errors = {(f["stage"], f["key"]): f["error"] for f in run.get("failed_tasks", ())}
    order = sorted(tiles, key=lambda name: (not name.startswith("filter"), name != "grid-dtm"))
    for stage in [*reversed(order[:passes]), *order[passes:]]:
        fact_names = ("state", "points", "seconds", "tries", "marked")
        rows = [
            [
                t["key"],
                *t["bounds"],
                *(t[fact] for fact in fact_names),
                errors.get((stage, t["key"]), ""),
            ]
            for t in tiles[stage]
            if t["bounds"] is not None
        ]
        if rows and len(rows) <= room:
            room -= len(rows)
            stages.append({"name": stage, "title": title_of(run, stage), "tiles": rows})
    return stages


def _files(run: Mapping[str, Any]) -> list[list[Any]]:
    inputs = [i for i in run.get("inputs", ()) if i.get("bounds")][:MAX_FILES]
    return [
        [shown(Path(i["path"]).name), *(i["bounds"][k] for k in (0, 1, 3, 4))] for i in inputs
    ]
