"""HTML of results for notebooks, in which all texts and attributes are escaped."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote
from xml.etree import ElementTree

from rasterio.errors import RasterioError

from tiler.core.words import counted
from tiler.io.locations import is_url, joined, state_at
from tiler.io.result_folder import written_rasters
from tiler.report.accuracy import seams_text, statement_text
from tiler.report.document import Content, el, facts, table
from tiler.report.pictures import small_hillshade
from tiler.report.sections import (
    figures,
    noted,
    sentence,
    settled,
    state_text,
    value_text,
    warned,
)

PICTURE_PIXELS = 480
"""Pixels of the longer side of a picture. A smaller raster is enlarged by a whole factor."""
MAX_LINKS = 12
MAX_NOTES = 20


def markup(title: str, *children: Content) -> str:
    """Return a titled block of HTML that does not load files or run scripts."""
    return ElementTree.tostring(
        el("div", el("b", title), *children), encoding="unicode", method="html"
    )


def run_markup(run: Mapping[str, Any], products: str, files: Mapping[str, str]) -> str:
    """Return HTML about a run: its state, figures, a picture of the DTM, decisions, and links to the files.

    Parameters
    ----------
    run : mapping
        Content of run.json.
    products : str
        Path or URL of OUT.
    files : mapping of str to str
        Path or URL of each file, by its name in OUT.
    """
    title = f"tiler.run: {state_text(run).lower()}"
    return markup(
        title,
        el("p", sentence(run)),
        table(("figure", "value"), list(figures(run)), (1,)),
        *_picture(run, products),
        _list("Warnings", warned(run)),
        el("p", "Settings chosen automatically or by you:"),
        table(("setting", "value", "by", "why"), settled(run)),
        _list("Notes", noted(run)),
        el("p", "Files: ", *_links(files)),
    )


def classified_markup(result: Mapping[str, Any], target: Path, notes: Sequence[str]) -> str:
    """Return HTML about a classified cloud: points by class, notes, and a link to the file.

    Parameters
    ----------
    result : mapping
        Result of `tiler.apps.classify.classify_file`.
    target : Path
    notes : sequence of str
        Notes and warnings.
    """
    rows = [(str(code), f"{points:,}") for code, points in result["classes"].items()]
    failed = [f"{task['key']}: {task['error']}" for task in result["failed_tasks"]]
    return markup(
        f"tiler.classify: {counted(result['points'], 'point')} by the method {result['method']}",
        table(("class", "points"), rows, (0, 1)),
        el("p", f"{counted(result['changed'], 'point')} got a new class."),
        _list("Failed tiles, whose points keep their classes", failed),
        _list("Notes", notes),
        el("p", "File: ", *_links({target.name: str(target)})),
    )


def check_markup(report: Mapping[str, Any]) -> str:
    """Return HTML about a check: errors of checkpoints, steps at seams, differences of strips, requirements."""
    accuracy = report.get("accuracy", {})
    names = ("points", "rmse_v", "bias", "median", "nmad", "p95_abs")
    rows = [
        (group.upper(), *(_rounded(accuracy[group][name]) for name in names))
        for group in ("nva", "vva", "all")
        if accuracy and accuracy[group]["points"]
    ]
    headings = ("", "points", "RMSEV", "mean", "median", "NMAD", "95 % within")
    required = [
        (r["name"], f"{r['limit']:g}", _rounded(r["value"]), "yes" if r["met"] else "NO")
        for r in report["requirements"]
    ]
    return markup(
        f"tiler.check: {report['dtm']}",
        el("p", f"DTM minus checkpoints, {accuracy['unit']}:") if rows else None,
        table(headings, rows, range(1, 7)) if rows else None,
        el("p", accuracy["constant_offset"], class_="warning")
        if accuracy and accuracy["constant_offset"]
        else None,
        el("p", statement_text(accuracy["asprs"])) if accuracy else None,
        facts(dict(_steps(report))),
        table(("required", "limit", "measured", "met"), required, (1, 2)) if required else None,
        _list("Notes", accuracy.get("notes", ())),
        el("p", "Figures: ", *_links({Path(p).name: p for p in report["figures"]}))
        if report["figures"]
        else None,
    )


def _steps(report: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield names and values of the figures that do not need checkpoints."""
    if "seams" in report:
        seams = report["seams"]
        for name in ("tiles", "interior"):
            yield f"mean step, {name}", f"{_rounded(seams[name]['mean_step'])} {seams['unit']}"
        yield "seams", seams_text(seams)
    if "strips" in report and report["strips"]["pairs"]:
        strips = report["strips"]
        yield "RMSE between strips", f"{_rounded(strips['all']['rmse'])} {strips['unit']}"


def _rounded(value: float | None) -> str:
    return f"{value:.3f}" if isinstance(value, float) else value_text(value)


def _picture(run: Mapping[str, Any], products: str) -> Iterator[Content]:
    """Yield the hillshade of the DTM, or an error if the DTM cannot be read."""
    name = written_rasters(run).get("dtm")
    if name is None or state_at(location := joined(products, name)) is None:
        return
    try:
        picture = small_hillshade(location, run, PICTURE_PIXELS)
    except (RasterioError, OSError) as error:
        yield el("p", f"{location}: cannot be drawn ({error})")
        return
    times = max(PICTURE_PIXELS // max(picture.size), 1)
    size = dict(zip(("width", "height"), (times * side for side in picture.size), strict=True))
    alt = "Hillshade of the terrain model"
    yield el(
        "p", el("img", src=picture.uri, alt=alt, **size, style="image-rendering: pixelated")
    )


def _list(title: str, texts: Sequence[str]) -> Content:
    if not texts:
        return None
    more = [f"and {len(texts) - MAX_NOTES} more"] if len(texts) > MAX_NOTES else []
    items = [el("li", text) for text in (*texts[:MAX_NOTES], *more)]
    return el("div", el("p", f"{title}:"), el("ul", *items))


def _links(files: Mapping[str, str]) -> Iterator[Content]:
    """Yield links to files, separated by spaces. Links into folders are last, because there may be many."""
    for name, location in sorted(files.items(), key=lambda file: "/" in file[0])[:MAX_LINKS]:
        yield el("a", name, href=_href(location), target="_blank", rel="noopener")
        yield " "
    if len(files) > MAX_LINKS:
        yield f"and {len(files) - MAX_LINKS} more"


def _href(place: str) -> str:
    """Return the link to a file.

    It is relative if the file is in the current folder, which the server of a notebook serves.
    """
    if is_url(place):
        return place
    path = Path(os.path.abspath(place))
    try:  # browsers would read the text before a colon as the scheme of a URL
        return quote(os.fsencode(path.relative_to(Path.cwd())))
    except (ValueError, OSError):
        return path.as_uri()
