"""Folder of a run's results (OUT): names of its files, and the files that earlier runs wrote.

An earlier run wrote a file if ``run.json`` lists it, provided that tiler wrote this
``run.json``. A run lists its files before it writes the first of them, so the files of a killed
run are known as well.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tiler.core.file_names import product_names
from tiler.core.products import PRODUCTS, VECTOR_PRODUCTS
from tiler.errors import ConfigError
from tiler.io.foreign_content import parse_json_object
from tiler.io.locations import (
    is_url,
    joined,
    names_in,
    read_bytes,
    sizes_at,
    with_slashes,
    without_local_scheme,
)
from tiler.redaction import without_secrets

RUN = "run.json"
EVENTS = "events.jsonl"
REPORT = "report.html"
STORE = "store.zarr"
"""Folder of the tile store, unless the user gives another location."""
OUTLINE = "outline.gpkg"
"""Outline of the survey."""
WATER = "water.gpkg"
"""Bodies of water, with their heights."""
BRIDGES = "bridges.gpkg"
"""Bridge decks that were left out of the terrain."""
REVIEW = "review.gpkg"
"""Places to review, with the status that a user gives them."""
REVIEW_PAGE = "review.html"
"""Page of `tiler review`."""
STATEMENT_PAGE = "statement.html"
"""Page of `tiler review --statement`."""
SHEETS = "sheets.gpkg"
"""Outlines of the sheets, if products are cut into sheets."""
LEGEND = ".aux.xml"
"""Suffix, after the name of a raster, of the file in which GDAL expects the names of the
raster's classes."""

CLASSIFIED = "classified"
"""Folder of the classified clouds."""
COPC_SUFFIX = ".copc.laz"
CLOUD_SUFFIXES = {"laz": ".laz", "las": ".las", "copc": COPC_SUFFIX, "none": ".laz"}
"""Suffixes of classified clouds by the value of `--classified`."""
VIRTUAL = "classified.vpc"
"""Virtual point cloud that shows the classified clouds as one layer in QGIS."""
OVERVIEW = "classified-overview.copc.laz"
"""Thin cloud of all classified clouds, next to `VIRTUAL` and with its name, as `pdal_wrench build_vpc` writes it."""
STAC = "stac.json"
"""Description of the content of OUT for catalogues."""
SHEET_ITEMS = "stac"
"""Folder of the descriptions of the sheets."""
CHANGED = "changed.json"
"""Files that changed since the run before."""
CHECK = "check.json"
"""Results of `tiler check`, for the report."""
EVALUATION = "evaluate.json"
"""Results of `tiler evaluate`, for the report."""
OUTDATED = "outdated"
"""Folder of files that earlier runs wrote and later runs did not replace."""

RESULTS = (
    RUN,
    EVENTS,
    REPORT,
    STORE,
    OUTLINE,
    WATER,
    BRIDGES,
    REVIEW,
    REVIEW_PAGE,
    STATEMENT_PAGE,
    SHEETS,
    CLASSIFIED,
    OVERVIEW,
    STAC,
    CHANGED,
    CHECK,
    EVALUATION,
    OUTDATED,
)
"""Files and folders of OUT, in addition to the products."""

_KEYS = frozenset(("state", "version", "configuration", "plan", "stages"))
"""Keys that every version of tiler writes to ``run.json``."""
_RESOLUTION = re.compile(r"[0-9.e+-]+(m|ft)$")
"""Name of the folder of a resolution (`tiler.apps.resolutions.folder_name`)."""
_KEYS_OF_CHANGES = frozenset(("changed", "added", "removed", "unchanged", "sheets"))
"""Keys that every version of tiler writes to ``changed.json``."""


def raster_file(product: str, product_name: str | None = None) -> str:
    """Return the path in OUT of the raster of a product: ``dtm.tif``, ``MNT.tif`` with the setting ``dtm=MNT``."""
    return f"{product_names(product_name)[product]}.tif"


def sheet_file(product: str, sheet: str) -> str:
    """Return the path in OUT of a sheet of a product: ``dtm/<sheet>.tif`` or ``contours/<sheet>.gpkg``."""
    return f"{product}/{sheet}{'.gpkg' if product in VECTOR_PRODUCTS else '.tif'}"


def mosaic_file(product: str) -> str:
    """Return the path in OUT of the file that shows the sheets of a product as one raster: ``dtm.vrt``."""
    return f"{product}.vrt"


def raster_places(run: Mapping[str, Any] | None, product: str) -> tuple[str, str]:
    """Return where a run writes the raster of a product: as one file, or as VRT over its sheets.

    Parameters
    ----------
    run : mapping or None
        Content of ``run.json``, or None if there is none. Names that no run writes are ignored.
    product : str
    """
    renamed = _mapping(run or {}, "configuration").get("product_name")
    try:
        whole = raster_file(product, renamed)
    except (ConfigError, AttributeError):
        whole = raster_file(product)
    return whole, mosaic_file(product)


def written_rasters(run: Mapping[str, Any]) -> dict[str, str]:
    """Return the path in OUT of each raster that a run wrote, by product: a GeoTIFF, or the VRT over its sheets."""
    written = run.get("outputs", {})
    return {
        product: path
        for product in PRODUCTS
        for path in reversed(raster_places(run, product))
        if path in written
    }


def local_folder(products: str) -> Path:
    """Return the folder on this machine for run.json, log and report.

    This is OUT, or a folder with the last name of the URL if OUT is a URL.
    """
    if not is_url(products):
        return Path(products)
    return Path(without_secrets(products).rstrip("/").rpartition("/")[2])


def read_run(place: str) -> dict[str, Any] | None:
    """Return the content of ``run.json`` in a folder or at a URL, or None if tiler did not write one there."""
    content = _read_json(place, RUN)
    return content if content.keys() >= _KEYS else None


def _read_json(place: str, name: str) -> dict[str, Any]:
    """Return the content of a JSON file of OUT, or an empty dict if it cannot be read."""
    try:
        content = json.loads(read_bytes(joined(place, name)) or b"null")
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


AGAIN_WITHOUT_RUN = (
    "run the same command again with --force, which replaces the files of that run"
)
"""Remedy for a damaged run.json, without which a run does not know its own files."""


def is_results(place: str) -> bool:
    """Return whether a folder or URL contains the results of a run, even if its run.json is damaged."""
    if read_run(place) is not None:
        return True
    try:
        return None not in sizes_at([joined(place, RUN), joined(place, EVENTS)])
    except OSError:  # Reading the place itself reports the error.
        return False


def resolution_folders(out: str | Path) -> list[str]:
    """Return the paths of the results in ``out`` of a run with several resolutions, or an empty list."""
    if not Path(out, REPORT).is_file():  # It is written before the first of them.
        return []
    folders = sorted(path for path in Path(out).glob("[0-9]*") if _RESOLUTION.match(path.name))
    return [str(path) for path in folders if read_run(str(path)) is not None]


def results_name(out: Path) -> str:
    """Return the name of a folder of results for titles: ``town``, or ``town, 2m`` for one of several resolutions."""
    out = out.resolve()
    if _RESOLUTION.match(out.name) and str(out) in resolution_folders(out.parent):
        return f"{out.parent.name}, {out.name}"
    return out.name


def store_of(out: str | Path, run: Mapping[str, Any], given: str | None = None) -> str:
    """Return the location of the store of a run: the given one, that of its settings, or `STORE` in its folder.

    The store of several resolutions moves together with their folders.
    """
    location = given or _mapping(run, "configuration").get("store")
    if is_url(str(out)):
        return str(location or joined(str(out), STORE))
    folder = Path(out).resolve()
    beside = folder.parent / STORE
    is_moved = location and not given and _RESOLUTION.match(folder.name)
    if is_moved and not os.path.exists(str(location)) and beside.is_dir():
        return str(beside)
    return str(location or folder / STORE)


def give_results(out: str | Path, of: str = "run") -> str:
    """Return the remedy if ``out`` has no results of a run, which the OUT of a ``of`` has."""
    folders = [] if is_url(str(out)) else resolution_folders(out)
    if folders:
        return f"give the folder of one of its resolutions: {', '.join(folders)}"
    return f"give the OUT of a {of}"


def below(out: str, place: str) -> str:
    """Return the path in ``out`` of the file at ``place``, a path or URL. It has slashes, as in run.json."""
    return with_slashes(place).removeprefix(with_slashes(out).rstrip("/")).lstrip("/")


def _earlier_run(out: Path, products: str) -> dict[str, Any]:
    """Return the run.json of the last run of OUT, or an empty dict if tiler did not write one."""
    url = without_secrets(products).rstrip("/") if is_url(products) else ""
    for place in (str(out), products):
        run = read_run(place)
        if run is None:
            continue
        # The folder on this machine may contain the run.json of results at another URL.
        at = without_local_scheme((run.get("products_at") or "").rstrip("/"))
        if (at if is_url(at) else "") == url:
            return run
    return {}


def earlier_outputs(out: Path, products: str) -> dict[str, str | None]:
    """Return the files that earlier runs wrote in OUT, with the digest of the data from which each was made.

    The result is empty without an earlier run.

    Parameters
    ----------
    out : Path
        Folder on this machine. Its run.json is used first, since it is the newest if it is of the same OUT.
    products : str
        Path or URL of OUT, which may contain a run.json from another machine.
    """
    run = _earlier_run(out, products)
    made_of = _mapping(run, "made_of")
    files = dict(_mapping(run, "earlier_outputs"))
    for path in _mapping(run, "outputs"):
        files[path] = made_of.get(path)
    return files


class EarlierFacts(NamedTuple):
    """Digests of the files that earlier runs wrote and delivered, and settings and notes of the last run."""

    digests: dict[str, str]
    delivered: dict[str, str]
    settings: dict[str, Any]
    notes: tuple[str, ...]


def earlier_facts(out: Path, products: str) -> EarlierFacts:
    """Return what run.json records of the earlier runs in OUT."""
    run = _earlier_run(out, products)
    notes = (*_notes(_mapping(run, "plan")), *_notes(run))
    digests, delivered = _mapping(run, "digests"), _mapping(run, "delivered")
    return EarlierFacts(digests, delivered, _mapping(run, "configuration"), notes)


def _notes(found: Mapping[str, Any]) -> list[str]:
    notes = found.get("notes")
    return notes if isinstance(notes, list) else []


def earlier_statistics(out: Path, method: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state after each pass of the run in ``out``, which must have used the same method.

    Raises
    ------
    ConfigError
        There is no run in ``out``, it was not finished, or its method or parameters differ.
    """
    try:
        run = parse_json_object((out / RUN).read_text(encoding="utf-8"))
        plan, statistics, state = run["plan"], dict(run["statistics"]), run["state"]
        same = (plan["method"], plan["parameters"]) == (method, parameters)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"--statistics {out}: contains no run.json of a finished run; give an OUT folder"
        ) from error
    if state != "done":
        raise ConfigError(f"--statistics {out}: its run is not finished; finish that run first")
    if not same:
        raise ConfigError(
            f"--statistics {out}: its run used {plan['method']}, and its method or parameters differ from this run; "
            "use the same --method and --set"
        )
    return statistics


def foreign_files(
    out: Path, products: str, wanted: Iterable[str], sheets_of: Mapping[str, str] | None = None
) -> list[str]:
    """Return the files that a run would replace although no earlier run of OUT wrote them, as paths in OUT.

    Parameters
    ----------
    out : Path
        Folder on this machine for run.json, log and report.
    products : str
        Path or URL of the other files.
    wanted : iterable of str
        Files that the run will write, as paths in OUT, without run.json, log and report.
    sheets_of : mapping of str to str, optional
        Beginning of the names of the sheets, by product that is cut into sheets. The complete names are not known yet.
    """
    earlier_files = earlier_outputs(out, products)
    names = [name for name in wanted if name not in earlier_files]
    for product, start in (sheets_of or {}).items():
        # No file has this name, but there may be a file in place of its folder.
        names.append(f"{product}/{start or product}.")
        for name in names_in(joined(products, product)):
            path = f"{product}/{name}"
            if (
                name.startswith(start)
                and name.endswith((".tif", ".gpkg", ".json"))
                and path not in earlier_files
            ):
                names.append(path)
    foreign = _existing(products, names)
    for place in dict.fromkeys((str(out), products)):
        if read_run(place) is None:
            foreign += _existing(place, [RUN, EVENTS, REPORT])
        # A second run writes it, and run.json does not list it.
        if not _read_json(place, CHANGED).keys() >= _KEYS_OF_CHANGES:
            foreign += _existing(place, [CHANGED])
    return list(dict.fromkeys(foreign))


def _existing(place: str, names: list[str]) -> list[str]:
    """Return the ``names`` that exist in a folder or at a URL, and files in place of their folders."""
    if is_url(place):
        sizes = sizes_at([joined(place, name) for name in names])
        return [name for name, size in zip(names, sizes, strict=True) if size is not None]
    existing = []
    for name in names:
        folders = [str(f) for f in reversed(Path(name).parents) if str(f) != "."]
        blocked = [
            f
            for f in folders
            if os.path.lexists(Path(place, f)) and not Path(place, f).is_dir()
        ]
        if blocked:
            existing.append(blocked[0])
        elif os.path.lexists(Path(place, name)):
            existing.append(name)
    return existing


def _mapping(found: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = found.get(name)
    return value if isinstance(value, dict) else {}
