"""Checkpoints from CSV files and from vector files."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from tiler.core.units import FARTHEST
from tiler.core.words import counted
from tiler.errors import InputError
from tiler.io.json_text import excerpt
from tiler.io.vector import POINTS, Feature, Kind, read_features

NVA = "NVA"  # non-vegetated vertical accuracy
VVA = "VVA"  # vegetated vertical accuracy

_COLUMNS = {
    "x": ("x", "e", "east", "easting", "lon", "longitude", "long"),
    "y": ("y", "n", "north", "northing", "lat", "latitude"),
    "z": ("z", "h", "height", "elevation", "elev", "ele", "altitude"),
    "kind": ("type", "nva_vva", "nva/vva", "accuracy"),
    "cover": ("cover", "land_cover", "landcover", "land cover", "surface", "class"),
    "name": ("id", "name", "point", "pt", "fid", "label"),
}
"""Accepted names of each column, in lower case."""

_ORDER = ("x", "y", "z", "type", "cover")
"""Order of the columns of a CSV file without a heading."""

CHECKPOINTS = Kind("checkpoints", POINTS.types)

Floats = npt.NDArray[np.float64]


class Row(NamedTuple):
    """One checkpoint, with the values as in its file."""

    x: float
    y: float
    z: float
    kind: str
    cover: str
    name: str


@dataclass(frozen=True)
class PointOptions:
    """Properties of checkpoints that their file does not contain.

    Attributes
    ----------
    crs : str or None
        CRS of x and y. None: the CRS of the file, or of the DTM if the file has none.
    unit : Fraction or None
        Metres in one unit of the heights. None: the unit of the DTM.
    rmse : float
        RMSE of the checkpoints' own heights, metres.
    """

    crs: str | None = None
    unit: Fraction | None = None
    rmse: float = 0.0


@dataclass(frozen=True)
class Checkpoints:
    """Checkpoints of one file.

    Attributes
    ----------
    xy : float64 [2, n]
        Coordinates in the CRS of the file.
    z : float64 [n]
        Heights in units of the file.
    kinds : tuple of str
        ``NVA`` or ``VVA`` for each checkpoint.
    covers : tuple of str
        Land cover of each checkpoint, empty if the file has none.
    names : tuple of str
    crs : str or None
        CRS in the file: WKT or authority code.
    notes : tuple of str
    has_types : bool
        Whether the file gives the type of every checkpoint.
    """

    xy: Floats
    z: Floats
    kinds: tuple[str, ...]
    covers: tuple[str, ...]
    names: tuple[str, ...]
    crs: str | None = None
    notes: tuple[str, ...] = ()
    has_types: bool = True

    def __len__(self) -> int:
        return len(self.z)


def read_checkpoints(path: Path | str) -> Checkpoints:
    """Read the checkpoints of a file.

    Parameters
    ----------
    path : path
        ``.csv`` or ``.txt``: comma, semicolon or tab between the columns x, y, z and, optionally, type (NVA or VVA),
        land cover, id. A heading gives the names of the columns. Without a heading, the columns are x, y, z, type and
        land cover, and an id is not read. Lines that begin with # are skipped. ``.geojson``, ``.gpkg``, ``.shp``,
        ``.fgb``: the only layer of points, with heights in the geometry or in a column.

    Raises
    ------
    InputError
        The file cannot be read, has another format or no checkpoint, or a checkpoint has invalid values.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError(
            f"{path}: no such file; give a CSV, GeoJSON or GeoPackage file of checkpoints"
        )
    if suffix in (".csv", ".txt"):
        rows, crs, notes = list(_csv_rows(path)), None, []
    else:
        layer = read_features(path, CHECKPOINTS)
        rows = [_row_of(feature) for feature in layer.features]
        crs, notes = layer.crs, list(layer.notes)
    if not rows:
        raise InputError(f"{path}: holds no checkpoint")
    kinds = tuple(_kind(path, row.kind) for row in rows)
    n_untyped = sum(not row.kind for row in rows)
    if n_untyped == len(rows):
        notes.append(
            "no column contains NVA or VVA: all checkpoints are assumed to be non-vegetated (NVA)"
        )
    elif n_untyped:
        notes.append(
            f"{counted(n_untyped, 'checkpoint')} without a type assumed to be non-vegetated (NVA)"
        )
    return Checkpoints(
        np.array([[row.x for row in rows], [row.y for row in rows]], np.float64),
        np.array([row.z for row in rows], np.float64),
        kinds,
        tuple(row.cover for row in rows),
        tuple(row.name or str(number) for number, row in enumerate(rows, start=1)),
        crs,
        tuple(notes),
        has_types=not n_untyped,
    )


def _row_of(feature: Feature) -> Row:
    """Return the row of a point, whose height is its third coordinate or an attribute."""
    has_z = bool(feature.geometry.has_z)
    coordinates = shapely.get_coordinates(feature.geometry, include_z=has_z)[0].tolist()
    named = dict(zip(("x", "y", "z"), coordinates, strict=False))
    return row_of({**feature.attributes, **named}, feature.place)


def row_of(values: Mapping[str, Any], place: str) -> Row:
    """Return a row from named values.

    Raise InputError if x, y or z is missing, is not a finite number, or is too large.
    """
    row_values = {column: _value(values, names) for column, names in _COLUMNS.items()}
    numbers = []
    for axis in ("x", "y", "z"):
        text = row_values[axis]
        if text is None:
            raise InputError(f"{place}: {axis} is missing")
        try:
            number = float(text)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise InputError(
                f"{place}: {axis} {excerpt(text)} is not a number (1234.5, with a point)"
            )
        if abs(number) >= FARTHEST:
            raise InputError(
                f"{place}: {axis} {excerpt(text)} is beyond {FARTHEST:g}, the largest coordinate; check it"
            )
        numbers.append(number)
    texts = []
    for name in ("kind", "cover", "name"):
        text = row_values[name]
        texts.append("" if text is None else str(text).strip())
    x, y, z = numbers
    return Row(x, y, z, *texts)


def _value(values: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((values[name] for name in names if values.get(name) is not None), None)


def _kind(path: Path, text: str) -> str:
    kind = text.upper() or NVA
    if kind not in (NVA, VVA):
        raise InputError(
            f"{path}: type {excerpt(text)} is neither NVA nor VVA; give land cover in a column `cover`"
        )
    return kind


def _csv_rows(path: Path) -> Iterator[Row]:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); save it as UTF-8 text") from error
    numbered = [
        (i, s)
        for i, s in enumerate(lines, start=1)
        if s.strip() and not s.lstrip().startswith("#")
    ]
    if not numbered:
        return
    first = numbered[0][1]
    delimiter = max(";\t,", key=first.count)
    # Lines are split one by one, so that an unclosed quote does not swallow the lines after it.
    head = [
        cell.strip().lower()
        for cell in _cells(first, delimiter, f"{path}: line {numbered[0][0]}")
    ]
    names: Sequence[str] = head
    if _is_number(head[0]) or (len(head) > 1 and _is_number(head[1])):
        names = _ORDER
    else:
        numbered = numbered[1:]
    for number, line in numbered:
        place = f"{path}: line {number}"
        cells = zip(names, _cells(line, delimiter, place), strict=False)
        yield row_of({name: text.strip() for name, text in cells if text.strip()}, place)


def _cells(line: str, delimiter: str, place: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise InputError(
            f"{place}: is not a line of a table ({error}); check its quotes"
        ) from error


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
