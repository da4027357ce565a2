"""The folder of a run's results (OUT): the names in it, and which of its files earlier runs wrote.

An earlier run wrote a file if ``run.json`` lists it, provided that tiler wrote this ``run.json``. A run lists its files
before it writes the first of them, so that the files of a killed run are known, too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tiler.errors import ConfigError
from tiler.io.json_text import read_object
from tiler.io.locations import is_url, joined, names_in, read_bytes, sizes_at
from tiler.redaction import without_secrets

RUN = "run.json"
EVENTS = "events.jsonl"
REPORT = "report.html"
STORE = "store.zarr"
"""Folder of the tile store, unless the user names another place."""
OUTLINE = "outline.gpkg"
"""The outline of the survey."""
WATER = "water.gpkg"
"""Bodies of water, with their heights."""
BRIDGES = "bridges.gpkg"
"""Decks of bridges that were left out of the terrain."""
SHEETS = "sheets.gpkg"
"""The places of the sheets, if products are cut into sheets."""
LEGEND = ".aux.xml"
"""GDAL looks for the names of a raster's classes in the file with this after the name of the raster."""

CLASSIFIED = "classified"
"""Folder of the classified clouds."""
COPC_SUFFIX = ".copc.laz"
CLOUD_SUFFIXES = {"laz": ".laz", "las": ".las", "copc": COPC_SUFFIX, "none": ".laz"}
"""Suffixes of classified clouds by the value of `--classified`."""
VIRTUAL = "classified.vpc"
"""Shows the classified clouds as one layer in QGIS."""
STAC = "stac.json"
"""Describes the content of OUT for catalogues."""
SHEET_ITEMS = "stac"
"""Folder of the descriptions of the sheets."""
CHECK = "check.json"
"""Results of `tiler check`, for the report."""
EVALUATION = "evaluate.json"
"""Results of `tiler evaluate`, for the report."""
ASIDE = "outdated"
"""Folder of files that earlier runs wrote and later runs did not replace."""

_KEYS = frozenset(("state", "version", "configuration", "plan", "stages"))
"""Keys that every version of tiler writes into ``run.json``."""


def raster_file(product: str, sheet: str | None = None) -> str:
    """Path in OUT of the raster of a product, ``dtm.tif``, or of one of its sheets, ``dtm/<sheet>.tif``."""
    return f"{product}.tif" if sheet is None else f"{product}/{sheet}.tif"


def mosaic_file(product: str) -> str:
    """Path in OUT of the file that shows the sheets of a product as one raster: ``dtm.vrt``."""
    return f"{product}.vrt"


def folder_here(products: str) -> Path:
    """The folder on this machine for run.json, log and report: OUT, or one named like the end of its URL."""
    if not is_url(products):
        return Path(products)
    return Path(without_secrets(products).rstrip("/").rpartition("/")[2])


def read_run(place: str) -> dict[str, Any] | None:
    """The content of ``run.json`` in a folder or at a URL; None if tiler wrote none there."""
    try:
        found = json.loads(read_bytes(joined(place, RUN)) or b"null")
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or not found.keys() >= _KEYS:
        return None
    return found


def is_results(place: str) -> bool:
    """Whether a folder or URL holds the results of a run, even if its run.json is damaged."""
    if read_run(place) is not None:
        return True
    return None not in sizes_at([joined(place, RUN), joined(place, EVENTS)])


def below(out: str, place: str) -> str:
    """The path in OUT of a file at a path or URL."""
    return place.removeprefix(out.rstrip("/")).lstrip("/")


def _earlier_run(out: Path, products: str) -> dict[str, Any]:
    """The run.json of the last run of OUT; empty if tiler wrote none."""
    url = without_secrets(products).rstrip("/") if is_url(products) else ""
    for place in (str(out), products):
        found = read_run(place)
        # The folder on this machine may hold the run.json of results at another URL.
        if found is not None and (found.get("products_at") or "").rstrip("/") == url:
            return found
    return {}


def earlier_outputs(out: Path, products: str) -> dict[str, str | None]:
    """Files that earlier runs wrote in OUT, and the digest of what each was made of; empty without an earlier run.

    Parameters
    ----------
    out : Path
        Folder on this machine with the run.json of runs from here, which is the newest.
    products : str
        Path or URL of OUT, where the run.json of a run from another machine lies.
    """
    found = _earlier_run(out, products)
    made_of = _mapping(found, "made_of")
    files = dict(_mapping(found, "earlier_outputs"))
    for path in _mapping(found, "outputs"):
        files[path] = made_of.get(path)
    return files


def earlier_facts(out: Path, products: str) -> tuple[dict[str, str], dict[str, Any]]:
    """Digests of the files that earlier runs wrote in OUT, as far as noted, and the settings of the last run."""
    found = _earlier_run(out, products)
    return _mapping(found, "digests"), _mapping(found, "configuration")


def earlier_statistics(out: Path, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
    """State after each pass of a run that was done in ``out`` with the same method.

    Raises
    ------
    ConfigError
        There is no such run, it was not finished, or its method or parameters are others.
    """
    try:
        found = read_object((out / RUN).read_text(encoding="utf-8"))
        before, statistics, state = found["plan"], dict(found["statistics"]), found["state"]
        same = (before["method"], before["parameters"]) == (method, parameters)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"--statistics {out}: holds no run.json of a finished run; give an OUT folder"
        ) from error
    if state != "done":
        raise ConfigError(f"--statistics {out}: that run is not finished; run it to its end first")
    if not same:
        raise ConfigError(
            f"--statistics {out}: that run used {before['method']} with other parameters or another method; "
            "use the same --method and --set"
        )
    return statistics


def foreign_files(
    out: Path, products: str, wanted: Iterable[str], sheets_of: Mapping[str, str] | None = None
) -> list[str]:
    """Files that a run would replace although no earlier run of OUT wrote them, as paths in OUT.

    Parameters
    ----------
    out : Path
        Folder on this machine for run.json, log and report.
    products : str
        Path or URL of the other files.
    wanted : iterable of str
        Files that the run will write, as paths in OUT, without run.json, log and report.
    sheets_of : mapping of str to str, optional
        Products that are cut into sheets, and the text with which the names of their sheets begin; the names
        themselves are not known yet.
    """
    ours = earlier_outputs(out, products)
    names = [name for name in wanted if name not in ours]
    for product, start in (sheets_of or {}).items():
        names.append(f"{product}/{start or product}.")  # never a file itself, but its folder may be one
        for name in names_in(joined(products, product)):
            path = f"{product}/{name}"
            if name.startswith(start) and name.endswith((".tif", ".json")) and path not in ours:
                names.append(path)
    found = _existing(products, names)
    for place in dict.fromkeys((str(out), products)):
        if read_run(place) is None:
            found += _existing(place, [RUN, EVENTS, REPORT])
    return list(dict.fromkeys(found))


def _existing(place: str, names: list[str]) -> list[str]:
    """The ``names`` that exist in a folder or at a URL, and files in place of one of their folders."""
    if is_url(place):
        sizes = sizes_at([joined(place, name) for name in names])
        return [name for name, size in zip(names, sizes, strict=True) if size is not None]
    found = []
    for name in names:
        folders = [str(f) for f in reversed(Path(name).parents) if str(f) != "."]
        blocked = [f for f in folders if os.path.lexists(Path(place, f)) and not Path(place, f).is_dir()]
        if blocked:
            found.append(blocked[0])
        elif os.path.lexists(Path(place, name)):
            found.append(name)
    return found


def _mapping(found: dict[str, Any], name: str) -> dict[str, Any]:
    value = found.get(name)
    return value if isinstance(value, dict) else {}
