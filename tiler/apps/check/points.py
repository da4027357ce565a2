"""Checkpoints from CSV, GeoJSON and GeoPackage files."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tiler.apps.check.checkpoint_row import Row, row_of
from tiler.apps.check.vector import geojson_rows, geopackage_rows
from tiler.errors import InputError
from tiler.io.json_text import excerpt

NVA, VVA = "NVA", "VVA"
"""Non-vegetated and vegetated vertical accuracy."""

_ORDER = ("x", "y", "z", "type", "cover")
"""Order of the columns of a CSV file without a heading."""

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PointOptions:
    """What a file of checkpoints does not say itself.

    Attributes
    ----------
    crs : str or None
        Of x and y; None: what the file says, else that of the DTM.
    unit : Fraction or None
        Metres in one unit of the heights; None: that of the DTM.
    rmse : float
        RMSE of the checkpoints' own heights, metres.
    """

    crs: str | None = None
    unit: Fraction | None = None
    rmse: float = 0.0


@dataclass(frozen=True)
class Checkpoints:
    """Points of known height.

    Attributes
    ----------
    xy : float64 [2, n]
    z : float64 [n]
        In units of the file.
    kinds : tuple of str
        ``NVA`` or ``VVA``.
    covers : tuple of str
        Land cover; empty where the file has none.
    names : tuple of str
    crs : str or None
        What the file says of itself: WKT or authority code.
    notes : tuple of str
    """

    xy: Floats
    z: Floats
    kinds: tuple[str, ...]
    covers: tuple[str, ...]
    names: tuple[str, ...]
    crs: str | None = None
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.z)


def read_checkpoints(path: Path | str) -> Checkpoints:
    """The points of a file.

    Parameters
    ----------
    path : path
        ``.csv`` or ``.txt``: comma, semicolon or tab between columns x, y, z and, if wanted, type (NVA or VVA), land
        cover, id, found by their heading or, without one, by this order; lines that begin with # are skipped.
        ``.geojson``, ``.json``: features that are points, heights in the geometry or a property. ``.gpkg``: the
        one layer of points.

    Raises
    ------
    InputError
        The file cannot be read, is of another format, or a line has no coordinates.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError(f"{path}: no such file; name a CSV, GeoJSON or GeoPackage file of checkpoints")
    crs: str | None = None
    notes: list[str] = []
    if suffix in (".csv", ".txt"):
        rows = list(_csv_rows(path))
    elif suffix in (".geojson", ".json"):
        rows, crs = geojson_rows(path)
    elif suffix == ".gpkg":
        rows, crs = geopackage_rows(path)
    else:
        raise InputError(
            f"{path}: checkpoints are read from .csv, .txt, .geojson, .json and .gpkg files; "
            "convert it, for example with `ogr2ogr points.gpkg FILE`"
        )
    if not rows:
        raise InputError(f"{path}: holds no checkpoint")
    kinds = tuple(_kind(path, row.kind) for row in rows)
    if not any(row.kind for row in rows):
        notes.append("no column says NVA or VVA: all checkpoints count as non-vegetated (NVA)")
    return Checkpoints(
        np.array([[row.x for row in rows], [row.y for row in rows]], np.float64),
        np.array([row.z for row in rows], np.float64),
        kinds,
        tuple(row.cover for row in rows),
        tuple(row.name or str(number) for number, row in enumerate(rows, start=1)),
        crs,
        tuple(notes),
    )


def _kind(path: Path, text: str) -> str:
    """NVA or VVA; empty is NVA."""
    kind = text.upper() or NVA
    if kind not in (NVA, VVA):
        raise InputError(
            f"{path}: type {excerpt(text)} is neither NVA nor VVA; name land cover in a column `cover`"
        )
    return kind


def _csv_rows(path: Path) -> Iterator[Row]:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); save it as UTF-8 text") from error
    numbered = [(i, s) for i, s in enumerate(lines, start=1) if s.strip() and not s.lstrip().startswith("#")]
    if not numbered:
        return
    first = numbered[0][1]
    delimiter = max(";\t,", key=first.count)
    # Each line alone: a quote that is never closed must not swallow the lines after it.
    head = [cell.strip().lower() for cell in _cells(first, delimiter, f"{path}: line {numbered[0][0]}")]
    names: Sequence[str] = head
    if _is_number(head[0]) or (len(head) > 1 and _is_number(head[1])):
        names = _ORDER
    for number, line in numbered if names is _ORDER else numbered[1:]:
        place = f"{path}: line {number}"
        cells = zip(names, _cells(line, delimiter, place), strict=False)
        yield row_of({name: text.strip() for name, text in cells if text.strip()}, place)


def _cells(line: str, delimiter: str, place: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise InputError(f"{place}: is no line of a table ({error}); see to its quotes") from error


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
