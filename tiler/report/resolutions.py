"""Page of a run with several resolutions, which links to the folder and the report of each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from tiler.io.result_folder import REPORT, REVIEW, results_name, written_rasters
from tiler.report.client import client_map
from tiler.report.document import Content, el, link, page, section, table
from tiler.report.pictures import reading_rasters
from tiler.report.problems import Run, kinds_text
from tiler.report.runfile import run_file_errors
from tiler.report.sections import is_good, length, made_text, share_with_height, state_text

MAKER = "tiler run"
"""Command in the head of the page, which recognises an earlier page by it."""
NOT_FINISHED = "Not finished"


def resolutions_page(
    out: Path, runs: Mapping[str, Run | None], is_running: bool = False
) -> bytes:
    """Return the page.

    Parameters
    ----------
    out : Path
    runs : mapping of str to mapping or None
        Content of the run.json in each folder of ``out``, by the name of the folder. None if there is none.
    is_running : bool
        Whether the runs are still under way. Then the page has no map.

    Returns
    -------
    bytes
        UTF-8.

    Raises
    ------
    ProcessingError
        A raster cannot be read.
    InputError
        A run.json has other content than this version writes.
    """
    title = f"Terrain of {results_name(out)}"
    folder, first = next(iter(runs.items()))
    shown = dict.fromkeys(runs) if is_running else runs
    states = {NOT_FINISHED: False} if None in shown.values() else {}
    rows = []
    for name, run in shown.items():
        with run_file_errors(out / name):
            rows.append((name, *_cells(name, run)))
            states |= {state_text(run): is_good(run)} if run else {}
    header = el(
        "header",
        *(
            el("p", text, class_=f"state {'good' if good else 'bad'}")
            for text, good in states.items()
        ),
        el("h1", title),
    )
    text = (
        f"All have the surface and the water of {folder}. Decide about places to review in {folder}/{REVIEW}, and give "
        "it to the whole run with --edits."
    )
    columns = ("folder", "terrain", "pixels", "with a height", "problems", "report")
    sections = [section("resolutions", "Resolutions", table(columns, rows, ()), el("p", text))]
    if not is_running and first and first["state"] == "done":
        with run_file_errors(out / folder), reading_rasters(out):
            header.append(el("p", f"{made_text(first)}.", class_="lead"))
            terrain = written_rasters(first).get("dtm")
            if terrain and (out / folder / terrain).is_file():
                drawn = client_map(out / folder, first, (), str(out / folder / terrain))
                sections.append(section("map", "Map", drawn))
    return page(title, header, sections, maker=MAKER)


def _cells(folder: str, run: Run | None) -> Iterator[Content]:
    """Yield the cells of a row after the first: the links are relative to the page."""
    if run is None or run["state"] != "done":
        yield from (NOT_FINISHED, "-", "-", "-", "-")
        return
    terrain, dtm = written_rasters(run).get("dtm"), run.get("dtm")
    yield link(f"{folder}/{terrain}") if terrain else "none"
    size = f"{dtm['width']:,} x {dtm['height']:,}" if dtm else "-"
    yield f"{size} of {length(run, run['plan']['resolution_m'])}"
    yield share_with_height(run["voids"]) if "voids" in run else "-"
    problems = run.get("problems") or ()
    yield kinds_text(problems) if problems else "none"
    yield link(f"{folder}/{REPORT}") if run.get("report") else "none"
