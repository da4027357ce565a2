"""Checks before GDAL opens a vector file of other people: it goes by the content, and follows what that points to."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pyproj import CRS
from pyproj.exceptions import ProjError
from shapely.errors import ShapelyError

from tiler.errors import InputError
from tiler.io.json_text import excerpt, member, read_object
from tiler.redaction import printable

SIGNATURES = {
    ".gpkg": b"SQLite format 3\0",
    ".geojson": b"",
    ".json": b"",
    ".shp": b"\0\0\x27\x0a",
    ".fgb": b"fgb\x03fgb",
}
"""Formats that are read, and how their files begin; what a GeoJSON file holds is looked at as a whole."""


def check_file(path: Path, wanted: str) -> list[bool] | None:
    """Raise InputError for a file that GDAL must not open; of GeoJSON, which features have a geometry.

    GDAL goes by what a file holds, not by its name: a list of links to other files or hosts (VRT, WFS) named
    ``area.gpkg`` would be followed. So a file has to begin as its suffix says.
    """
    signature = SIGNATURES.get(path.suffix.lower())
    if signature is None:
        *most, last = SIGNATURES
        raise InputError(
            f"{path}: {wanted} are read from {', '.join(most)} and {last} files; "
            f"convert it, for example with `ogr2ogr {wanted}.gpkg FILE`"
        )
    if not path.is_file():
        raise InputError(f"{path}: no such file; name a GeoPackage, GeoJSON or Shapefile with {wanted}")
    if "!" in str(path.resolve()) or str(path.resolve()).startswith("/vsi"):
        raise InputError(f"{path}: GDAL would take its name for that of an archive; rename it")
    try:
        with path.open("rb") as stream:
            start = stream.read(len(signature))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); name a readable file") from error
    if start != signature:
        raise InputError(
            f"{path}: does not begin as a {path.suffix.lower()} file does; get the file again, "
            f"or convert it with `ogr2ogr {wanted}.gpkg FILE`"
        )
    return _check_geojson(path, wanted) if not signature else None


def _check_geojson(path: Path, wanted: str) -> list[bool]:
    """GDAL takes features with an unknown CRS, or with damaged geometries, for something else, without a word."""
    try:
        content = read_object(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: not valid GeoJSON ({printable(str(error))}); write {wanted} as features"
        ) from error
    features = content.get("features")
    if content.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise InputError(f"{path}: no GeoJSON FeatureCollection; write {wanted} as features")
    for number, feature in enumerate(features, start=1):
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise InputError(f"{path}: feature {number}: is no GeoJSON Feature; write {wanted} as features")
    # Before RFC 7946 a member named the CRS, which is still what most programs write.
    named = member(member(content, "crs"), "properties").get("name")
    try:
        if named is not None:
            CRS.from_user_input(str(named))
    except (ProjError, UnicodeError, RecursionError) as error:
        raise InputError(f"{path}: its CRS {excerpt(named)} is not known; write it with another") from error
    return [feature.get("geometry") is not None for feature in features]


@contextmanager
def reading(path: Path) -> Iterator[list[str]]:
    """What libraries raise while a file is read becomes one line, and what they warn of is collected."""
    told: list[str] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield told
    # pyogrio's errors are RuntimeErrors; names and text that are no UTF-8 are UnicodeDecodeErrors.
    except (RuntimeError, ValueError, OverflowError, ShapelyError) as error:
        raise InputError(f"{path}: cannot be read ({_short(error)}); get the file again") from error
    told += sorted({_short(warning.message) for warning in caught})


def _short(problem: Any) -> str:
    """What a library says, on one line and without the advice that follows."""
    return printable(" ".join(str(problem).split(";")[0].split()))[:150]
