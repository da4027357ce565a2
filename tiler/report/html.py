"""Writes ``report.html``: a page about a run that does not need a server, a network or other files."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from rasterio.errors import RasterioError

from tiler.errors import InputError, ProcessingError, write_error
from tiler.io.atomic_files import write_atomic
from tiler.io.foreign_content import parse_json_object
from tiler.io.locations import is_url, joined, state_at, upload_file
from tiler.io.result_folder import (
    AGAIN_WITHOUT_RUN,
    CHECK,
    EVALUATION,
    REPORT,
    RUN,
    local_folder,
    read_run,
    written_rasters,
)
from tiler.report import accuracy, document, sections, tables
from tiler.report.document import el, section
from tiler.report.drawn import drawn
from tiler.report.expected import at_checkpoints, expected
from tiler.report.mapdata import map_data, with_earlier_times
from tiler.report.pictures import draw
from tiler.report.problems import problems
from tiler.report.runfile import run_file_errors, write_run_file
from tiler.report.specification import specification
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
    try:
        with run_file_errors(out):
            page = _page(out, content, products or content.get("products_at") or str(out))
    except (RasterioError, OSError) as error:
        raise ProcessingError(
            f"{out}: a raster cannot be read ({' '.join(str(error).split())}); run again"
        ) from error
    target = out / REPORT
    try:
        write_atomic(target, page)
    except OSError as error:
        raise write_error(str(target), error, out) from error
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
            f"{path}: cannot be read ({error.strerror}); give the OUT folder of a run"
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
    title = run.get("report_title") or f"Terrain of {out.resolve().name}"
    parts = [
        specification(run),
        problems(run),
        sections.terrain_map(pictures),
        section(
            "accuracy",
            "Accuracy",
            *expected(run, at_checkpoints(check, rasters)),
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


def _rasters(place: str, run: Mapping[str, Any]) -> dict[str, str]:
    """Return the path or URL of the raster of each product, or of the VRT over its sheets, if it exists."""
    named = {product: joined(place, name) for product, name in written_rasters(run).items()}
    return {
        product: raster for product, raster in named.items() if state_at(raster) is not None
    }
