"""Data that the map draws over the pictures: tiles with state and time, outlines of files, features, checkpoints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tiler.io.foreign_content import parse_json_object
from tiler.io.result_folder import EVENTS
from tiler.redaction import shown
from tiler.report.accuracy import checkpoints_on_map
from tiler.report.drawn import shapes
from tiler.report.pictures import VIRIDIS, Pictures, ramp_colour
from tiler.report.problems import marked_places
from tiler.report.runfile import title_of

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
            try:
                yield parse_json_object(line)
            except ValueError:
                continue


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
                "legend": [[_css(c), text] for c, text in p.legend],
            }
            for p in (pictures.pictures if pictures else ())
        ],
        "stages": _stages(run),
        "files": _files(run),
        "shapes": shapes(run),
        "problems": marked_places(run),
        **checkpoints_on_map(accuracy),
        "time_colours": [
            _css(ramp_colour(VIRIDIS, i / (TIME_COLOURS - 1))) for i in range(TIME_COLOURS)
        ],
    }


def _css(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


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
    """Return name and bounds of each input cloud."""
    inputs = [i for i in run.get("inputs", ()) if i.get("bounds")][:MAX_FILES]
    return [
        [shown(Path(i["path"]).name), *(i["bounds"][k] for k in (0, 1, 3, 4))] for i in inputs
    ]
