"""Writes ``report.html``: a page about a run that does not need a server, a network or other files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rasterio.errors import RasterioError

from tiler.core.products import PRODUCTS
from tiler.errors import InputError, ProcessingError, write_error
from tiler.io.atomic_files import write_atomic
from tiler.io.json_text import parse_json_object
from tiler.io.locations import is_url, joined, state_at, upload_file
from tiler.io.result_folder import (
    AGAIN_WITHOUT_RUN,
    CHECK,
    EVALUATION,
    REPORT,
    RUN,
    local_folder,
    read_run,
)
from tiler.report import accuracy, document, sections, tables
from tiler.report.document import el, section
from tiler.report.drawn import drawn
from tiler.report.expected import expected
from tiler.report.mapdata import map_data, with_earlier_times
from tiler.report.pictures import draw
from tiler.report.problems import problems


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
        page = _page(out, content, products or content.get("products_at") or str(out))
    except (
        KeyError,
        TypeError,
        AttributeError,
        ValueError,
        OverflowError,
        IndexError,
    ) as error:
        remedy = "run again" if read_run(str(out)) is not None else AGAIN_WITHOUT_RUN
        raise InputError(
            f"{out / RUN}: was not written by this version of tiler ({type(error).__name__}: {error}); {remedy}"
        ) from error
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


def write_report_at(out: str) -> str:
    """Write the report of a run into its OUT.

    If OUT is a URL, the report is written in a local folder and copied to OUT.

    Returns
    -------
    str
        Path or URL of the report.
    """
    if not is_url(out):
        return str(write_report(Path(out)))
    run = read_run(out)
    if run is None:
        raise InputError(f"{joined(out, RUN)}: cannot be read; give the OUT folder of a run")
    here = local_folder(out)
    here.mkdir(parents=True, exist_ok=True)
    upload_file(write_report(here, run, out), joined(out, REPORT))
    return joined(out, REPORT)


def _read_run(out: Path) -> dict[str, Any]:
    path = out / RUN
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
    pictures = draw(_rasters(products, run), run)
    check = accuracy.read_measured(out, CHECK)
    run = {**run, "check": check}
    evaluation = accuracy.read_measured(out, EVALUATION)
    title = f"Terrain of {out.resolve().name}"
    parts = [
        problems(run),
        sections.terrain_map(pictures),
        section(
            "accuracy",
            "Accuracy",
            *expected(run),
            *accuracy.accuracy_content(check, evaluation),
        ),
        sections.decisions(run),
        *drawn(run),
        tables.counts(run),
        tables.outputs(run),
        tables.inputs(run),
        tables.timings(run),
        tables.settings(run),
    ]
    made = f"Made by tiler {run['version']} from run.json, written {run.get('written', 'at an unknown time')} (UTC)."
    about = (el("p", made), el("p", "This page does not load or send any data."))
    parts.append(section("about", "About this page", *about))
    return document.page(
        title, sections.header(run, title), parts, map_data(run, pictures, check)
    )


def _rasters(place: str, run: Mapping[str, Any]) -> dict[str, str]:
    """Return the path or URL of the raster of each product, or of the VRT over its sheets, if it exists."""
    written = run.get("outputs", {})
    named = {
        product: joined(place, f"{product}.{kind}")
        for product in PRODUCTS
        for kind in ("vrt", "tif")
        if f"{product}.{kind}" in written
    }
    return {
        product: raster for product, raster in named.items() if state_at(raster) is not None
    }
