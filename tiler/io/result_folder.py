"""The folder of a run's results: the names in it, and which of its files runs of that folder made.

A file is a run's own if ``run.json`` lists it, and that file counts only where it is one that tiler wrote. A run lists
what it is about to write before the first of it is written, so that a run that was killed knows its own files again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tiler.io.locations import is_url, joined, names_in, read_bytes, sizes_at
from tiler.redaction import without_secrets

RUN, EVENTS, REPORT = "run.json", "events.jsonl", "report.html"
STORE = "store.zarr"
"""Folder of the tile store, unless the user names another place."""
OUTLINE = "outline.gpkg"
"""The outline of the survey."""
WATER = "water.gpkg"
"""Bodies of water, with their heights."""
BRIDGES = "bridges.gpkg"
"""Decks of bridges that were left out of the terrain."""
SHEETS = "sheets.gpkg"
"""Where the sheets lie, if products are cut into some."""
LEGEND = ".aux.xml"
"""What follows the name of a raster of classes in that of the file with their names, where GDAL looks for it."""

CLASSIFIED = "classified"
"""Folder of the classified clouds."""
COPC_SUFFIX = ".copc.laz"
CLOUD_SUFFIXES = {"laz": ".laz", "las": ".las", "copc": COPC_SUFFIX, "none": ".laz"}
"""How names of classified clouds end, by what `--classified` says."""
VIRTUAL = "classified.vpc"
"""These clouds as one, for QGIS."""
STAC, SHEET_ITEMS = "stac.json", "stac"
"""What OUT holds, for catalogues, and the folder of what sheets hold."""
CHECK, EVALUATION = "check.json", "evaluate.json"
"""What `tiler check` and `tiler evaluate` found, for the report."""
ASIDE = "outdated"
"""Folder of what earlier runs made and later ones did not replace."""

_KEYS = frozenset(("state", "version", "configuration", "plan", "stages"))
"""What every version of tiler writes into ``run.json``."""


def raster_file(product: str, sheet: str | None = None) -> str:
    """Path in OUT of the raster of a product, ``dtm.tif``; of one of its sheets ``dtm/<sheet>.tif``."""
    return f"{product}.tif" if sheet is None else f"{product}/{sheet}.tif"


def mosaic_file(product: str) -> str:
    """Path in OUT of what shows the sheets of a product as one raster: ``dtm.vrt``."""
    return f"{product}.vrt"


def folder_here(products: str) -> Path:
    """The folder of this machine for run.json, the log and the report: OUT, or one of the last name of its URL."""
    if not is_url(products):
        return Path(products)
    return Path(without_secrets(products).rstrip("/").rpartition("/")[2])


def read_run(place: str) -> dict[str, Any] | None:
    """The content of ``run.json`` in a folder or at a URL; None where there is none that tiler wrote."""
    try:
        found = json.loads(read_bytes(joined(place, RUN)) or b"null")
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and found.keys() >= _KEYS else None


def is_results(place: str) -> bool:
    """Whether a folder or URL holds results of a run, also where its run.json was damaged since."""
    if read_run(place) is not None:
        return True
    return all(size is not None for size in sizes_at([joined(place, name) for name in (RUN, EVENTS)]))


def below(out: str, place: str) -> str:
    """The path in OUT of a file at a path or URL."""
    return place.removeprefix(out.rstrip("/")).lstrip("/")


def _earlier_run(out: Path, products: str) -> dict[str, Any]:
    """What run.json says of the last run of OUT; empty where there was none, or it is not one that tiler wrote."""
    at = without_secrets(products).rstrip("/") if is_url(products) else None
    for place in (str(out), products):
        found = read_run(place)
        # A folder here may hold the run.json of results at another URL.
        if found is not None and (found.get("products_at") or "").rstrip("/") == (at or ""):
            return found
    return {}


def earlier_outputs(out: Path, products: str) -> dict[str, str | None]:
    """Files that earlier runs wrote in OUT, by their path in it, and what each was made of.

    Empty where there was no run, or its run.json is not one that tiler wrote.

    Parameters
    ----------
    out : Path
        Folder of this machine with the run.json of runs from here, which is the newest.
    products : str
        Path or URL of OUT: of a run from elsewhere run.json lies there.
    """
    found = _earlier_run(out, products)
    made_of, earlier, outputs = (_mapping(found, n) for n in ("made_of", "earlier_outputs", "outputs"))
    return {**earlier, **{path: made_of.get(path) for path in outputs}}


def earlier_digests(out: Path, products: str) -> dict[str, str]:
    """Digest of all bytes of the files that earlier runs wrote in OUT, where they noted it."""
    return _mapping(_earlier_run(out, products), "digests")


def foreign_files(
    out: Path, products: str, wanted: Iterable[str], sheets_of: Mapping[str, str] | None = None
) -> list[str]:
    """Files that a run would replace and that no earlier run of OUT made, as paths in OUT.

    Parameters
    ----------
    out : Path
        Folder of this machine for run.json, the log and the report.
    products : str
        Path or URL of the other files.
    wanted : iterable of str
        Files that the run is to write, as paths in OUT, without run.json, the log and the report.
    sheets_of : mapping of str to str, optional
        Products that are cut into sheets, and what the names of these begin with: more is not yet known.
    """
    ours = earlier_outputs(out, products)
    names = [name for name in wanted if name not in ours]
    for product, start in (sheets_of or {}).items():
        names.append(f"{product}/{start or product}.")  # no file, but its folder may be one
        sheets = (f"{product}/{name}" for name in names_in(joined(products, product)))
        names += [
            s
            for s in sheets
            if s.startswith(f"{product}/{start}") and s.endswith((".tif", ".json")) and s not in ours
        ]
    found = _there(products, names)
    for place in dict.fromkeys((str(out), products)):
        if read_run(place) is None:
            found += _there(place, [RUN, EVENTS, REPORT])
    return list(dict.fromkeys(found))


def _there(place: str, names: list[str]) -> list[str]:
    """Those of some files that are there, and files that are where a folder of theirs is to be."""
    if is_url(place):
        sizes = sizes_at([joined(place, name) for name in names])
        return [name for name, size in zip(names, sizes, strict=True) if size is not None]
    found = []
    for name in names:
        folders = [str(f) for f in reversed(Path(name).parents) if str(f) != "."]
        blocked = [f for f in folders if os.path.lexists(Path(place, f)) and not Path(place, f).is_dir()]
        found += blocked[:1] or ([name] if os.path.lexists(Path(place, name)) else [])
    return found


def _mapping(found: dict[str, Any], name: str) -> dict[str, Any]:
    value = found.get(name)
    return value if isinstance(value, dict) else {}
