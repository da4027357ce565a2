"""The client's page of a delivery: specification, map, accuracy, completeness and files, on two screens."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tiler.core.products import MASK_VALUES, OUTSIDE
from tiler.core.units import area_text, small_area_text
from tiler.core.words import counted
from tiler.io.result_folder import results_name, written_rasters
from tiler.observe.progress import size_text
from tiler.report.accuracy import (
    AtCheckpoints,
    accuracy_content,
    at_checkpoints,
    rule_of_thumb,
    seams_text,
)
from tiler.report.client_map import client_map
from tiler.report.document import Content, Node, el, facts, page, section, table
from tiler.report.pictures import reading_rasters
from tiler.report.places import units_of
from tiler.report.problems import MAX_ROWS, Run
from tiler.report.sections import is_good, left_out, made_text, share_with_height, state_text
from tiler.report.tables import specification

KINDS = ("raster", "vector", "page", "description", "cloud")
"""Kinds of files in the order of the list."""


def client_page(out: Path, run: Run, entries: Sequence[Mapping[str, Any]]) -> bytes:
    """Return the page.

    Parameters
    ----------
    out : Path
        Folder of the run.
    run : mapping
        Content of run.json, with the measurements of `tiler check` under ``check``.
    entries : sequence of mapping
        Entries of the files in the manifest.

    Returns
    -------
    bytes
        UTF-8.

    Raises
    ------
    ProcessingError
        A raster cannot be read.
    """
    rasters = {product: str(out / name) for product, name in written_rasters(run).items()}
    title = run.get("report_title") or f"Terrain of {results_name(out)}"
    with reading_rasters(out):
        checked = at_checkpoints(run["check"], rasters)
        if terrain := rasters.get("dtm"):
            drawn = client_map(run, entries, terrain)
        else:
            drawn = el("p", "No terrain model is delivered, so there is no map.")
    header = el(
        "header",
        el("p", state_text(run), class_=f"state {'good' if is_good(run) else 'bad'}"),
        el("h1", title),
        el("p", f"{made_text(run)}.", class_="lead") if "dtm" in rasters else None,
        class_="screens",
    )
    sections = [
        specification(run),
        section("map", "Map", drawn),
        section("accuracy", "Accuracy", *_accuracy(run, checked)),
        section("completeness", "Completeness", *_completeness(run)),
        section("files", "Files", *_files(entries)),
    ]
    return page(title, header, sections, maker="tiler deliver")


def _accuracy(run: Run, checked: AtCheckpoints | None) -> Iterator[Content]:
    check = {} if run["check"].get("older") else run["check"]
    if "unreadable" in check:
        text = "The measurements of this terrain cannot be read, so its accuracy is not stated."
        yield el("p", text, class_="warning")
        return
    measured = {name: check[name] for name in ("accuracy", "requirements") if check.get(name)}
    if "accuracy" in measured:
        # Notes are advice to those who measured.
        measured["accuracy"] = {**measured["accuracy"], "notes": ()}
    else:
        yield el("p", "This terrain was not measured at checkpoints.")
    if measured:
        yield from accuracy_content(measured, {})
    yield from rule_of_thumb(run, checked)
    seams = check.get("seams")
    yield el("p", seams_text(seams) if seams else "Seams between tiles were not checked.")


def _completeness(run: Run) -> Iterator[Node]:
    water, edits = run.get("water") or (), run.get("edits") or ()
    yield facts(
        {
            **_voids(run),
            "water": counted(len(water), "body", "bodies") if water else None,
            "edits": counted(len(edits), "edit") if edits else None,
            "left out": left_out(run) or "nothing",
            "places to review": _review_text(run.get("review")),
        }
    )
    sources = {
        text: number
        for text, number in run.get("mask", {}).items()
        if number and text != MASK_VALUES[OUTSIDE]
    }
    if sources:
        yield el("h3", "Sources of heights, shares of the survey")
        pixels = sum(sources.values())
        yield facts({text: _share(number / pixels) for text, number in sources.items()})


def _share(share: float) -> str:
    return "less than 0.1 %" if share < 0.001 else f"{100 * share:.1f} %"


def _voids(run: Run) -> dict[str, Content]:
    """Return facts about the pixels with a height and without one."""
    voids, metres = run.get("voids"), units_of(run)[0]
    if not voids or not run.get("dtm"):
        return {}
    pixel_m2 = run["dtm"]["resolution_m"] ** 2

    def area(pixels: int) -> str | None:
        return small_area_text(pixels * pixel_m2, metres) if pixels else None

    text = "none"
    if voids["number"]:
        largest = max(void["area_m2"] for void in voids["largest"])
        text = f"{voids['number']:,}, together {area(voids['pixels'])}; the largest has "
        text += small_area_text(largest, metres)
    empty = run.get("without_returns", ())
    empty_m2 = sum(place["area_m2"] for place in empty)
    at_least = "at least " if len(empty) >= MAX_ROWS else ""
    return {
        "surveyed": area_text(voids["surveyed_pixels"] * pixel_m2, metres),
        "with a height": share_with_height(voids),
        "voids": text,
        "left without heights by edits": area(voids["asked_pixels"]),
        "interpolated where no return lies": (
            f"{at_least}{small_area_text(empty_m2, metres)}" if empty_m2 else None
        ),
    }


def _review_text(review: Mapping[str, int] | None) -> str | None:
    if not review:
        return None
    return f"{review['open']:,} open, {review['ok']:,} found right, {review['fixed']:,} changed"


def _files(entries: Sequence[Mapping[str, Any]]) -> Iterator[Content]:
    rows = [
        (
            el("a", entry["path"], href=quote(os.fsencode(entry["path"]))),
            _content(entry),
            ", ".join(f"{edge:.12g}" for edge in entry.get("bounds", ())),
            size_text(entry["bytes"]),
        )
        for entry in sorted(entries, key=lambda entry: KINDS.index(entry["kind"]))[:MAX_ROWS]
    ]
    yield table(("file", "content", "west, south, east, north", "size"), rows, (3,))
    if len(entries) > MAX_ROWS:
        yield el("p", f"{len(entries) - MAX_ROWS:,} more are in manifest.json.")
    yield el(
        "p",
        "manifest.json has the SHA-256 of each file, the settings and the versions of the software. ",
        el("code", "tiler verify FOLDER"),
        " reports missing and changed files.",
    )


def _content(entry: Mapping[str, Any]) -> str:
    if entry["kind"] == "cloud":
        return counted(entry["points"], "point")
    if entry["kind"] == "raster":
        return f"{entry['product']}, {entry['columns']:,} x {entry['rows']:,} pixels"
    return str(entry["kind"])
