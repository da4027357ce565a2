"""Checkpoints from CSV files and from vector files."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from ptd.arrays import Float64
from tiler.core.units import FARTHEST
from tiler.core.words import counted, listed
from tiler.errors import InputError
from tiler.io.foreign_content import excerpt, packing_of
from tiler.io.locations import no_such_file
from tiler.io.vector import POINTS, Feature, Kind, read_features

NVA = "NVA"  # non-vegetated vertical accuracy
VVA = "VVA"  # vegetated vertical accuracy

MAX_TABLE_BYTES = 64 << 20
"""Largest table of checkpoints in bytes: about a million lines."""

_COLUMNS = {
    "x": (
        "x", "e", "east", "easting", "xcoord", "pointx", "lon", "longitude", "long", "lng",
        "rechtswert", "ostwert", "est", "este",
    ),
    "y": (
        "y", "n", "north", "northing", "ycoord", "pointy", "lat", "latitude",
        "hochwert", "nordwert", "nord", "norte",
    ),
    "z": (
        "z", "h", "height", "elevation", "elev", "ele", "alt", "altitude", "zcoord", "pointz",
        "höhe", "hoehe", "cota", "quota",
    ),
    "kind": ("type", "nvavva", "accuracy"),
    "cover": ("cover", "landcover", "surface", "class"),
    "name": (
        "id", "name", "point", "pt", "fid", "label", "pointid", "number", "nr", "no",
        "station", "punkt", "punktnummer",
    ),
}  # fmt: skip
"""Accepted names of each column as `_plain` returns them; the first that a row has a value for counts."""

_MEANING = {"x": "eastings", "y": "northings", "z": "heights"}
"""Contents of the columns that every table needs."""

CHECKPOINTS = Kind("checkpoints", POINTS.types)


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

    xy: Float64
    z: Float64
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
        ``.csv`` or ``.txt``: columns x, y, z and, optionally, type (NVA or VVA), land cover, id, separated by commas,
        semicolons, tabs or blanks. A header line gives the names of the columns. Without one, the order must be
        unambiguous, see `_order_without_header`. Lines that begin with # are skipped. ``.geojson``, ``.gpkg``,
        ``.shp``, ``.fgb``: the only layer of points, with heights in the geometry or in a column.

    Raises
    ------
    InputError
        The file cannot be read, has another format or no checkpoint, or a checkpoint has invalid values.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        raise no_such_file(path, "give a CSV, GeoJSON or GeoPackage file of checkpoints")
    notes: list[str] = []
    if suffix in (".csv", ".txt"):
        crs = None
        rows = list(_csv_rows(path, notes))
    else:
        layer = read_features(path, CHECKPOINTS)
        rows = [_row_of(feature) for feature in layer.features]
        crs = layer.crs
        notes += layer.notes
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
    attributes = {_plain(name): value for name, value in feature.attributes.items()}
    if not has_z and all(attributes.get(name) is None for name in _COLUMNS["z"]):
        found = _found("attributes", list(feature.attributes))
        raise InputError(
            f"{feature.place}: has no height ({found}); give the point a z or an attribute named z"
        )
    return row_of({**attributes, **named}, feature.place)


def row_of(values: Mapping[str, Any], place: str) -> Row:
    """Return a row from named values.

    Raise InputError if x, y or z is missing, is not a finite number, or is too large.
    """
    row_values = {
        column: next((values[name] for name in names if values.get(name) is not None), None)
        for column, names in _COLUMNS.items()
    }
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
    texts = (
        "" if row_values[name] is None else str(row_values[name]).strip()
        for name in ("kind", "cover", "name")
    )
    x, y, z = numbers
    return Row(x, y, z, *texts)


def _kind(path: Path, text: str) -> str:
    kind = text.upper() or NVA
    if kind not in (NVA, VVA):
        raise InputError(
            f"{path}: type {excerpt(text)} is neither NVA nor VVA; give land cover in a column `cover`"
        )
    return kind


def _csv_rows(path: Path, notes: list[str]) -> Iterator[Row]:
    """Yield the rows of a table, and add a note if it has no header line."""
    try:
        with path.open("rb") as stream:
            content = stream.read(MAX_TABLE_BYTES + 1)
        if packing := packing_of(content):
            raise InputError(
                f"{path}: is packed with {packing}; unpack it and give the table in it"
            )
        if len(content) > MAX_TABLE_BYTES:
            raise InputError(f"{path}: has more than {MAX_TABLE_BYTES >> 20} MiB; divide it")
        lines = content.decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); save it as UTF-8 text") from error
    numbered = [
        (i, s)
        for i, s in enumerate(lines, start=1)
        if s.strip() and not s.lstrip().startswith("#")
    ]
    if not numbered:
        return
    delimiter = _delimiter(numbered[0][1])
    # Lines are split one by one, so that an unclosed quote does not swallow the lines after it.
    table = [
        (f"{path}: line {i}", _cells(line, delimiter, f"{path}: line {i}"))
        for i, line in numbered
    ]
    head = table[0][1]
    if any(map(_is_number, head[:2])):
        names = _order_without_header(path, [cells for _, cells in table])
        order = ", ".join("type" if name == "kind" else name for name in names)
        notes.append(f"{path.name} has no header line: its columns are read as {order}")
        names = [_COLUMNS[name][0] for name in names]
    else:
        names = [_plain(cell) for cell in head]
        _validate_header(path, head, names)
        table = table[1:]
    for place, cells in table:
        if len(cells) > len(names) or (delimiter == " " and len(cells) < len(names)):
            raise InputError(
                f"{place}: has {counted(len(cells), 'value')}, but the table has {counted(len(names), 'column')}; "
                "check its separators"
            )
        values = zip(names, cells, strict=False)
        yield row_of({name: text for name, text in values if text}, place)


def _delimiter(line: str) -> str:
    """Return the separator of the columns: the first that makes three of them, or a blank."""
    usual = ";\t,"
    several = [separator for separator in usual if line.count(separator) > 1]
    return (several + [separator for separator in usual if separator in line] + [" "])[0]


def _order_without_header(path: Path, table: Sequence[Sequence[str]]) -> Sequence[str]:
    """Return the columns of a table that has no header line, or raise InputError if they are ambiguous.

    The orders are x y z, id x y z, and x y z with a type (NVA or VVA) and a land cover. An id
    contains letters, or is a whole number while heights are not.
    """
    columns = list(zip_longest(*table, fillvalue=""))
    are_numbers = [all(map(_is_number, column)) for column in columns]
    if are_numbers == [True] * 3:
        return ("x", "y", "z")
    if len(columns) == 4 and all(are_numbers[1:]):
        whole = [all(text.isdecimal() for text in columns[i]) for i in (0, 3)]
        if not are_numbers[0] or whole == [True, False]:
            return ("name", "x", "y", "z")
    has_types = len(columns) in (4, 5) and {text.upper() for text in columns[3]} <= {
        NVA,
        VVA,
        "",
    }
    if has_types and all(are_numbers[:3]):
        return ("x", "y", "z", "kind", "cover")[: len(columns)]
    raise InputError(
        f"{path}: has no header line, and the order of its columns is not clear ({_found('first values', table[0])}); "
        "add a first line such as id,x,y,z"
    )


def _validate_header(path: Path, head: Sequence[str], names: Sequence[str]) -> None:
    """Raise InputError if a header line lacks a column of coordinates or has two of the same name."""
    missing = [axis for axis in _MEANING if not set(_COLUMNS[axis]) & set(names)]
    if missing:
        contents = " and ".join(f"a column of {_MEANING[axis]}" for axis in missing)
        ways = " and ".join(
            f"one {', '.join(_COLUMNS[axis][:3])} or {_COLUMNS[axis][3]}" for axis in missing
        )
        raise InputError(f"{path}: needs {contents} ({_found('columns', head)}); name {ways}")
    for axis, meaning in _MEANING.items():
        twice = [name for name in _COLUMNS[axis] if names.count(name) > 1]
        if twice:
            raise InputError(
                f"{path}: has several columns of {meaning} ({_found('columns', head)}); name only one {twice[0]}"
            )


def _found(kind: str, names: Sequence[str]) -> str:
    texts = [excerpt(name, 20).strip("'") for name in names if name]
    return f"{kind} found: {listed(texts, 6) or 'none'}"


def _plain(name: str) -> str:
    """Return the name of a column in lower case, without its unit in brackets and with letters and digits only."""
    return "".join(c for c in re.sub(r"(?<=\w)\s*[\[(].*", "", name).lower() if c.isalnum())


def _cells(line: str, delimiter: str, place: str) -> list[str]:
    """Return the values of a line without blanks around them, and without empty ones at its end."""
    try:
        reader = csv.reader(
            [line], delimiter=delimiter, skipinitialspace=delimiter != " ", strict=True
        )
        cells = [cell.strip() for cell in next(reader)]
    except csv.Error as error:
        raise InputError(
            f"{place} is not a line of a table ({error}); check its quotes"
        ) from error
    if delimiter == " ":
        return [cell for cell in cells if cell]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _is_number(text: str) -> bool:
    """Return whether a text is a number, perhaps with a decimal comma, which `row_of` refuses."""
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
