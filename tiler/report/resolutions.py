"""Page of a run with several resolutions, which links to the folder and the report of each."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import quote

from tiler.core.words import counted
from tiler.io.result_folder import REPORT, written_rasters
from tiler.report.client_map import client_map
from tiler.report.document import Content, Node, el, page, section, table
from tiler.report.pictures import reading_rasters
from tiler.report.problems import Run, kinds_text
from tiler.report.sections import is_good, length, made_text, share_with_height, state_text

MAKER = "tiler run"
"""Command in the head of the page, which recognises an earlier page by it."""


def resolutions_page(out: Path, runs: Mapping[str, Run]) -> bytes:
    """Return the page.

    Parameters
    ----------
    out : Path
    runs : mapping of str to mapping
        Content of the run.json in each folder of ``out``, by the name of the folder.

    Returns
    -------
    bytes
        UTF-8.

    Raises
    ------
    ProcessingError
        A raster cannot be read.
    """
    title = f"Terrain of {out.resolve().name}"
    folder, first = next(iter(runs.items()))
    states = {state_text(run): is_good(run) for run in runs.values()}
    header = el(
        "header",
        *(
            el("p", text, class_=f"state {'good' if good else 'bad'}")
            for text, good in states.items()
        ),
        el("h1", title),
        el(
            "p",
            f"{made_text(first)}. Coarser terrains have the same ground and water.",
            class_="lead",
        ),
    )
    columns = ("pixel", "terrain", "pixels", "with a height", "problems", "report")
    rows = [tuple(_cells(folder, run)) for folder, run in runs.items()]
    sections = [section("resolutions", "Resolutions", table(columns, rows, ()))]
    if terrain := written_rasters(first).get("dtm"):
        with reading_rasters(out):
            drawn = client_map(first, (), str(out / folder / terrain))
        sections.append(section("map", "Map", drawn))
    return page(title, header, sections, maker=MAKER)


def _cells(folder: str, run: Run) -> Iterator[Content]:
    """Yield the cells of a row: the links are relative to the page."""
    terrain, dtm = written_rasters(run).get("dtm"), run.get("dtm")
    yield length(run, run["plan"]["resolution_m"])
    yield _link(f"{folder}/{terrain}") if terrain else "none"
    yield f"{dtm['width']:,} x {dtm['height']:,}" if dtm else "-"
    yield share_with_height(run["voids"]) if "voids" in run else "-"
    problems = run.get("problems") or ()
    yield kinds_text(problems) if problems else "none"
    yield _link(f"{folder}/{REPORT}") if run.get("report") else counted(0, "report")


def _link(path: str) -> Node:
    return el("a", path, href=quote(os.fsencode(path)))
