"""Tables of the report: what was delivered, in the terms of a tender, then counts, files, timings and settings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from tiler.config import RunConfig, without_folders
from tiler.core.crs import at_degrees, split_wkt, vertical_name
from tiler.core.dates import days_text
from tiler.core.products import NODATA, PRODUCTS
from tiler.core.units import Sides, Units, in_unit_of_crs
from tiler.core.words import GRID, counted
from tiler.io.result_folder import CLASSIFIED, REVIEW, written_rasters
from tiler.observe.progress import duration_text, rate_text, size_text
from tiler.report.document import Content, Node, bar, el, facts, link, more, section, table
from tiler.report.problems import MAX_ROWS, Run
from tiler.report.runfile import title_of, units_of
from tiler.report.sections import (
    OF_MACHINE,
    SETTINGS,
    area,
    done_before,
    length,
    settled,
    value_text,
)

_GIVEN_BY_NAME = "no EPSG code known"
_CLOUDS = {"laz": "LAZ", "las": "LAS", "copc": "COPC (LAZ)"}


def specification(run: Run) -> Node:
    """Return the section with CRS, heights, pixels, sheets, dates and formats."""
    plan = run["plan"]
    units = plan.get("units", {})
    vertical = vertical_name(plan["crs"]) or "not given"
    terrain = run.get("dtm")
    cut = "sheets cut from " if run.get("sheets") else ""
    size = f", {cut}{terrain['width']:,} x {terrain['height']:,} pixels" if terrain else ""
    pairs: dict[str, Content] = {
        "horizontal CRS": f"{_horizontal(run)}; unit: {units.get('horizontal', 'unknown')}",
        "vertical datum": f"{vertical}; unit: {units.get('vertical', 'unknown')}",
        "pixel": f"{length(run, plan['resolution_m'])}{size}",
        "nodata": _nodata(run),
        "sheets": _sheets(run),
        "products": "; ".join(_products(run)) or "none yet",
        "date of the survey": _survey_dates(run),
        "date of the run": str(run.get("written", "unknown"))[:10],
        "software": f"tiler {run['version']}, method {plan['method']}",
    }
    return section("specification", "Specification", facts(pairs))


def _horizontal(run: Run) -> str:
    wkt = run["plan"]["crs"]
    horizontal = split_wkt(wkt)[0]
    if horizontal is None:
        return "not given"
    west, south, east, north = run["plan"]["extent"]
    at = at_degrees(wkt, (west + east) / 2, (south + north) / 2)
    # The search for the code takes long, so only a finished run has it.
    code = f" ({run['crs_code'] or _GIVEN_BY_NAME})" if "crs_code" in run else ""
    return f"{horizontal.name}{code}{at}"


def _nodata(run: Run) -> str:
    """Return the nodata value of the heights, and the other values with the products that have them."""
    height = float(run["configuration"].get("nodata", NODATA))
    products: dict[str, list[str]] = {f"{height:.10g}": []}
    for name in written_rasters(run):
        value = PRODUCTS[name].nodata
        text = "none" if value is None else f"{height if value == NODATA else value:.10g}"
        products.setdefault(text, []).append(name)
    texts = [f"{text} ({', '.join(names)})" for text, names in products.items() if names]
    return "; ".join(texts) if len(texts) > 1 else next(iter(products))


def _sheets(run: Run) -> str:
    configuration = run["configuration"]
    renamed = configuration.get("product_name")
    names = f", with the names {renamed}" if renamed else ""
    if configuration.get("sheets") is None:
        return f"none, each product is one file{names}"
    config = RunConfig.from_mapping(
        {name: configuration.get(name) for name in ("sheets", "sheet_name")}
    )
    number = counted(run["sheets"], "sheet") if "sheets" in run else "sheets"
    if isinstance(config.sheets, Sides):
        sides = [length(run, float(side)) for side in config.sheets]
        kind = f"with sides of {' x '.join(dict.fromkeys(sides))}"
    else:
        kind = f"with the outlines in {Path(str(config.sheets)).name}"
    return f"{number} {kind}, files named {config.sheet_template}{names}"


def _products(run: Run) -> Iterator[str]:
    configuration, outputs = run["configuration"], run.get("outputs", {})
    rasters = [f"{name} ({PRODUCTS[name].dtype})" for name in written_rasters(run)]
    if rasters:
        compression = configuration.get("compress", "deflate")
        yield f"{', '.join(rasters)} as cloud-optimized GeoTIFF, compression {compression}"
    # Sheets of contours are one product.
    layers = dict.fromkeys(
        name.partition("/")[0].removesuffix(".gpkg")
        for name in outputs
        if name.endswith(".gpkg") and name != REVIEW
    )
    if layers:
        yield f"{', '.join(layers)} as GeoPackage"
    clouds = sum(name.startswith(f"{CLASSIFIED}/") for name in outputs)
    if clouds:
        form = _CLOUDS.get(configuration.get("classified", "laz"), "LAZ")
        yield f"{counted(clouds, 'classified cloud')} as {form}"


def _survey_dates(run: Run) -> str:
    if not (dates := run.get("dates")):
        return "unknown"
    return f"{days_text((dates['first'], dates['last']))} ({dates['by']})"


SLOWEST = 10

COUNTED = {
    "duplicates_within_files": "duplicates within files",
    "duplicates_between_files": "duplicates between files",
    "kept_out": "excluded from the filter",
    "participating": "used by the filter",
    "strays": "far from all other points",
}
"""Counts of points in run.json, and their names for users."""
LABELLED = {
    "ground": "ground, before edits and water",
    "unclassified": "unclassified",
    "low_noise": "low noise",
    "kept": "not filtered, with the class of the input",
    "marked": "label not certified",
}
"""Counts of labels in run.json, and their names for users."""


def counts(run: Run) -> Node:
    """Return the table of counts: points that were read, stored and dropped, their classes, and pixels."""
    run_counts = run.get("counts", {})
    pairs: dict[str, Content] = {
        "read": _count(run_counts.get("read")),
        "stored": _count(run_counts.get("stored")),
    }
    pairs |= {
        f"dropped: {reason}": _count(n) for reason, n in run_counts.get("dropped", {}).items()
    }
    pairs |= {text: _count(run_counts.get(name)) for name, text in COUNTED.items()}
    pairs |= {
        f"labelled: {text}": _count(run.get("filter", {}).get(name))
        for name, text in LABELLED.items()
    }
    kept = run.get("classes", {}).get("kept", {})
    pairs |= {
        f"points that keep class {code} of the input": _count(n) for code, n in kept.items()
    }
    pixels: dict[str, Content] = {text: _count(n) for text, n in run.get("mask", {}).items()}
    content: list[Content] = [el("h3", "Points"), facts(pairs)]
    if pixels:
        content += [el("h3", "Pixels of the DTM"), facts(pixels)]
    return section("counts", "Counts", *content)


def _count(n: int | None) -> str | None:
    return None if n is None else f"{n:,}"


def inputs(run: Run) -> Node:
    """Return the table of input files, with notes about each."""
    files = run.get("inputs", ())
    warned = run["plan"].get("notes", ())
    rows = [
        (
            f["path"],
            f"{f['points']:,}",
            f"{f['stored']:,}",
            f"LAS {f['version']}, format {f['point_format']}",
            size_text(f["size"]),
            f["crs"] or "-",
            "; ".join([*f["notes"], *(["salvaged"] if f["salvaged"] else [])]),
        )
        for f in files[:MAX_ROWS]
    ]
    columns = ("file", "points", "stored", "format", "size", "CRS", "warnings")
    notes = f", {counted(len(warned), 'note')}: see Decided automatically" if warned else ""
    about = f"{counted(len(files), 'file')}{notes}."
    listed = table(columns, rows, (1, 2, 4))
    return section(
        "inputs",
        "Input files",
        el("p", about),
        listed,
        more(len(files), MAX_ROWS),
        *_surveys(run),
        heading="h3",
    )


def _surveys(run: Run) -> list[Content]:
    """Return the table of surveys, the one that counts most first, if the run has a priority."""
    rows = [
        (
            survey["name"],
            days_text((survey["first"], survey["last"])) if survey["first"] else "unknown",
            f"{survey['files']:,}",
            f"{survey['points']:,}",
            f"{survey['used']:,}",
            area(run, survey["area_m2"]),
            "; ".join(_step(run, step) for step in survey["steps"]) or "-",
        )
        for survey in run.get("surveys", ())
    ]
    columns = (
        "survey",
        "days",
        "files",
        "points",
        "used",
        "cells with points",
        "height above others",
    )
    return [el("h4", "Surveys"), table(columns, rows, (2, 3, 4, 5))] if rows else []


def _step(run: Run, step: Mapping[str, Any]) -> str:
    """Return a step between surveys as text in the unit of the CRS, as in the log."""
    text = f"{step['median_m']:+.2f} m to {step['other']} (MAD {step['mad_m']:.2f} m)"
    return in_unit_of_crs(text, Units(*map(Fraction, units_of(run))))


def outputs(run: Run) -> Node:
    """Return the table of output files with relative links. Changed files are first, files in folders are last."""
    changes = run.get("changes", {})
    # A delivery has no places to review.
    sizes = {name: size for name, size in run.get("outputs", {}).items() if name != REVIEW}
    since = dict.fromkeys(changes.get("changed", ()), "changed")
    since |= dict.fromkeys(changes.get("added", ()), "new")
    order = sorted(sizes.items(), key=lambda file: (file[0] not in since, "/" in file[0]))
    rows: list[tuple[Content, ...]] = [
        (link(name), size_text(size), since.get(name, "")) for name, size in order[:MAX_ROWS]
    ]
    told = None
    if changes:
        unchanged = counted(changes["unchanged"], "file")
        told = el("p", f"{unchanged} unchanged since the run before, with the times of then.")
    columns = ("file", "size", "since the run before" if since else "")
    body = table(columns, rows, (1,)) if rows else el("p", "None yet.")
    return section(
        "outputs",
        "Results",
        told,
        body,
        more(len(sizes), MAX_ROWS),
    )


def timings(run: Run) -> Node:
    """Return the tables of time and memory by stage, and of the slowest tiles."""
    stages = run.get("stages", {})
    longest = max((s["seconds"] for s in stages.values()), default=0) or 1
    rows = [
        (
            title_of(run, name),
            f"{s['tasks']:,}",
            f"{s['computed']:,}",
            duration_text(s["seconds"]),
            bar(s["seconds"] / longest),
            _rate(s) or "-",
            size_text(s["peak_rss_bytes"]) if s["peak_rss_bytes"] else "-",
        )
        for name, s in sorted(stages.items(), key=lambda item: _order(item[0]))
    ]
    columns = ("stage", "tasks", "done in this run", "time", "", "rate", "peak memory")
    plan = run["plan"]
    projected = max(plan["projected_memory_bytes"].values(), default=0)
    memory: dict[str, Content] = {
        "peak of one process": size_text(run["peak_rss_bytes"]),
        "planned per worker": size_text(projected),
        "allowed per worker": size_text(plan["memory_bytes"]),
    }
    n_done, tasks = done_before(run), sum(s["tasks"] for s in stages.values())
    earlier = f"{n_done:,} of {tasks:,} tasks were done by earlier runs. The times of the stages are from the last run."
    return section(
        "timings",
        "Time and memory",
        el("p", earlier, class_="quiet") if n_done else None,
        table(columns, rows, (1, 2, 3, 5, 6)),
        el("h4", "Tiles and memory"),
        table(SETTINGS, [found for found in settled(run) if found.setting in OF_MACHINE]),
        facts(memory),
        *_slowest(run),
        heading="h3",
    )


def _rate(stage: Mapping[str, Any]) -> str:
    """Return the rate of pixels if a stage makes pixels, else of points. A stage that writes both has none."""
    pixels, points = stage.get("pixels", 0), stage["points"]
    if pixels and points and not stage["stage"].startswith(GRID):
        return ""
    if pixels:
        return rate_text(pixels, stage["seconds"], "pixels")
    return rate_text(points, stage["seconds"])


def _order(stage: str) -> tuple[int, str]:
    """Return the sort key of a stage by its position in a run."""
    known = ("spool", "surveys", "assemble", "filter", "grid-", "export", "mosaic")
    return next(
        (i for i, name in enumerate(known) if stage.startswith(name)), len(known)
    ), stage


def _slowest(run: Run) -> list[Content]:
    tiles = (
        (stage, tile)
        for stage, stage_tiles in run.get("tiles", {}).items()
        for tile in stage_tiles
    )
    timed = [(stage, tile) for stage, tile in tiles if tile["seconds"] is not None]
    timed.sort(key=lambda item: (-item[1]["seconds"], item[0], item[1]["key"]))
    if not timed:
        return []
    rows = [
        (
            title_of(run, stage),
            t["key"],
            f"{t['points']:,}",
            duration_text(t["seconds"]),
            f"{t['tries']}",
            f"{t['marked']:,}",
            size_text(t["peak_rss_bytes"]),
        )
        for stage, t in timed[:SLOWEST]
    ]
    columns = (
        "stage",
        "tile",
        "points",
        "time",
        "tries",
        "not certified",
        "memory of its worker",
    )
    return [el("h4", "The slowest tiles"), table(columns, rows, (2, 3, 4, 5, 6))]


def settings(run: Run) -> Node:
    """Return the tables needed to repeat the run: parameters, configuration, versions, CRS."""
    plan = run["plan"]
    parameters = [(name, value_text(value)) for name, value in plan["parameters"].items()]
    # The report is a part of deliveries, and run.json has the folders of files.
    values = without_folders(run["configuration"]).items()
    configuration = [(name, value_text(value)) for name, value in values]
    versions = [("tiler", run["version"]), *run.get("libraries", {}).items()]
    digests = {Path(f["path"]).name: f["content"] for f in run.get("inputs", ())[:MAX_ROWS]}
    pre = el("pre", json.dumps(digests, ensure_ascii=False))
    return section(
        "settings",
        "Parameters and versions",
        el("h4", f"Parameters of {plan['method']}"),
        table(("parameter", "value"), parameters)
        if parameters
        else el("p", "The method has no parameters."),
        el("h4", "Versions"),
        facts(dict(versions)),
        el(
            "details",
            el("summary", "Configuration"),
            table(("setting", "value"), configuration),
        ),
        el("details", el("summary", "CRS"), el("pre", plan["crs"] or "none")),
        el("details", el("summary", "Input files and the digests of their bytes"), pre),
        heading="h3",
    )
