"""Sheets of a grid that the clouds do not cover."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from tiler.apps.acceptance.counts import Cells, Keys, decoded
from tiler.core.words import listed
from tiler.errors import InputError
from tiler.io.vector import CUT, POLYGONS
from tiler.io.vector.reading import Feature, read_in_crs
from tiler.schedule import call_isolated

MAX_FIELDS = 20
"""Number of fields that an error lists."""
LEAST_SHARE = 0.5
"""Covered share of a sheet below which it is missing. Files of the sheets around often reach into it."""
PIECE_CELLS = 1_000_000
"""Number of cells whose centres are in memory as points at the same time."""


@dataclass(frozen=True)
class Sheets:
    """Sheets that clouds must reach: name and polygon of each, and notes about the file."""

    names: tuple[str, ...]
    polygons: tuple[BaseGeometry, ...]
    notes: tuple[str, ...]


def read_sheets(path: Path, field: str | None, wkt: str | None) -> Sheets:
    """Read the sheets from a file of polygons.

    Parameters
    ----------
    path : Path
        GeoPackage, GeoJSON, shapefile or FlatGeobuf.
    field : str, optional
        Field with the names. Without it, the names are the numbers of the polygons.
    wkt : str or None
        CRS of the clouds.

    Raises
    ------
    InputError
        The file cannot be read, or does not have the field.
    """
    found = call_isolated(read_in_crs, path, POLYGONS, wkt, paths=(path,), smaller=CUT)
    names = tuple(_name(number, f, field) for number, f in enumerate(found.features, start=1))
    if field is not None and not any(field.lower() in f.attributes for f in found.features):
        titles = sorted({title for f in found.features for title in f.attributes})
        there = f"its fields are {listed(titles, MAX_FIELDS)}" if titles else "it has no fields"
        raise InputError(
            f"{path}: has no field {field!r}, {there}; give one of them with --sheet-field"
        )
    return Sheets(names, tuple(f.geometry for f in found.features), found.notes)


def _name(number: int, feature: Feature, field: str | None) -> str:
    value = None if field is None else feature.attributes.get(field.lower())
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return f"polygon {number}" if value is None else str(value)


def missing_sheets(sheets: Sheets, keys: Keys, cells: Cells) -> list[str]:
    """Return name and covered share of the sheets that are covered by less than `LEAST_SHARE`, the emptiest first.

    A cell with a first return covers the sheet that contains its centre.
    """
    _, columns, rows = decoded(keys)
    places = np.unique(np.stack((columns, rows), axis=1), axis=0)
    x = (cells.column + places[:, 0] + 0.5) * cells.side
    y = (cells.row + places[:, 1] + 0.5) * cells.side
    tree = shapely.STRtree(sheets.polygons)
    numbers = np.zeros(len(sheets.polygons), np.int64)
    for first in range(0, len(places), PIECE_CELLS):
        piece = slice(first, first + PIECE_CELLS)
        _, reached = tree.query(shapely.points(x[piece], y[piece]), predicate="intersects")
        numbers += np.bincount(reached, minlength=numbers.size)
    shares = numbers * cells.side**2 / np.maximum(shapely.area(sheets.polygons), 1e-9)
    order = np.argsort(shares, kind="stable")
    return [f"{sheets.names[i]} ({shares[i]:.0%})" for i in order if shares[i] < LEAST_SHARE]
