"""Sheets of a grid that the clouds do not cover."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tiler.apps.acceptance.counts import Cells, Keys, places_of
from tiler.core.units import parse_sides
from tiler.core.words import listed
from tiler.errors import ConfigError, InputError
from tiler.io.vector import CUT, POLYGONS
from tiler.io.vector.reading import Feature, read_features, read_in_crs
from tiler.schedule import call_isolated

MAX_FIELDS = 20
"""Number of fields that an error lists."""
LEAST_SHARE = 0.5
"""Covered share of a sheet below which it is missing. Files of the sheets around often reach into it."""
PIECE_CELLS = 1_000_000
"""Number of cells whose centres are in memory as points at the same time."""
SPACINGS = 2.0
"""Least side of the cells in pulse spacings. Complete surveys leave many smaller cells empty."""
TOLERANCE = 0.25
"""Amount by which cells may be smaller, so that an inexact spacing does not double them."""
LEAST_CELLS = 25
"""Area in cells below which the share of a sheet is not known."""


@dataclass(frozen=True)
class Sheets:
    """Sheets that clouds must cover: their file, name and polygon of each, and notes about the file."""

    path: Path
    names: tuple[str, ...]
    polygons: tuple[BaseGeometry, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Coverage:
    """Names and shares of sheets that are not covered, and numbers of all sheets and of those that are too small."""

    missing: list[str]
    number: int
    n_small: int
    path: Path


def validate_not_grid(text: str) -> None:
    """Raise ConfigError if sheets are given by a length, with which a run makes a grid, and not by a file."""
    try:
        parse_sides(text)
    except ConfigError:
        return
    raise ConfigError(
        f"--sheets {text}: is a grid, which does not say which sheets were ordered; give a file with their polygons"
    )


def read_sheets(path: Path, field: str | None, wkt: str | None) -> Sheets:
    """Read the sheets from a file of polygons.

    Parameters
    ----------
    path : Path
        GeoPackage, GeoJSON, shapefile or FlatGeobuf.
    field : str, optional
        Field with the names. Without it, the names are the numbers of the polygons.
    wkt : str or None
        CRS of the clouds. If it is unknown, the coordinates of both are taken as those of one CRS.

    Raises
    ------
    InputError
        The file cannot be read, or does not have the field.
    """
    notes: tuple[str, ...] = ()
    if wkt is None:
        found = call_isolated(read_features, path, POLYGONS, paths=(path,), smaller=CUT)
        notes = (
            f"{path}: its coordinates are taken as those of the clouds, which have no CRS",
        )
    else:
        found = call_isolated(read_in_crs, path, POLYGONS, wkt, paths=(path,), smaller=CUT)
    if field is not None and not any(field.lower() in f.attributes for f in found.features):
        titles = sorted({title for f in found.features for title in f.attributes})
        there = f"its fields are {listed(titles, MAX_FIELDS)}" if titles else "it has no fields"
        raise InputError(
            f"{path}: has no field {field!r}, {there}; give one of them with --sheet-field"
        )
    names = tuple(_name(feature, field) for feature in found.features)
    polygons = tuple(shapely.make_valid([f.geometry for f in found.features]))
    return Sheets(path, names, polygons, (*found.notes, *notes))


def _name(feature: Feature, field: str | None) -> str:
    """Return the value of a field, or the number of the polygon in its file if there is none."""
    value = None if field is None else feature.attributes.get(field.lower())
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    name = "" if value is None else str(value).strip()
    number = re.search(r"(\d+)$", feature.place)
    return name or f"polygon {number[1] if number else feature.place}"


def covered_sheets(sheets: Sheets, keys: Keys, cells: Cells, spacing: float) -> Coverage:
    """Return the sheets that first returns cover by less than `LEAST_SHARE`, the emptiest first.

    A cell with a first return covers the sheet that contains its centre.

    Parameters
    ----------
    sheets : Sheets
    keys : uint64
        Keys of the cells with first returns.
    cells : Cells
    spacing : float
        Measured pulse spacing in units of the CRS.
    """
    factor = max(math.ceil(SPACINGS * spacing / cells.side - TOLERANCE), 1)
    side = factor * cells.side
    columns, rows = places_of(keys, factor)
    x = cells.column * cells.side + (columns + 0.5) * side
    y = cells.row * cells.side + (rows + 0.5) * side
    numbers = np.zeros(len(sheets.polygons), np.int64)
    for first in range(0, x.size, PIECE_CELLS):
        piece = slice(first, first + PIECE_CELLS)
        tree = shapely.STRtree(shapely.points(x[piece], y[piece]))
        # A polygon as the query is prepared, so that its vertices do not count for each cell.
        reached, _ = tree.query(np.array(sheets.polygons, object), predicate="intersects")
        numbers += np.bincount(reached, minlength=numbers.size)
    areas = shapely.area(sheets.polygons)
    is_small = areas < LEAST_CELLS * side**2
    shares = numbers * side**2 / np.maximum(areas, 1e-9)
    named = np.flatnonzero((shares < LEAST_SHARE) & ~is_small)
    order = named[np.argsort(shares[named], kind="stable")].tolist()
    missing = [f"{sheets.names[i]} ({math.floor(100 * shares[i])} %)" for i in order]
    return Coverage(missing, len(sheets.names), int(is_small.sum()), sheets.path)
