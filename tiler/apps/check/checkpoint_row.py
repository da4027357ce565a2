"""One checkpoint as a row of its file, whatever the format: the names of its columns, and what its values may be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tiler.config.parsing import FARTHEST
from tiler.errors import InputError
from tiler.io.json_text import excerpt

_COLUMNS = {
    "x": ("x", "e", "east", "easting", "lon", "longitude", "long"),
    "y": ("y", "n", "north", "northing", "lat", "latitude"),
    "z": ("z", "h", "height", "elevation", "elev", "ele", "altitude"),
    "kind": ("type", "nva_vva", "nva/vva", "accuracy"),
    "cover": ("cover", "land_cover", "landcover", "land cover", "surface", "class"),
    "name": ("id", "name", "point", "pt", "fid", "label"),
}
"""Names of columns, in lower case."""


class Row(NamedTuple):
    """One checkpoint as its file has it."""

    x: float
    y: float
    z: float
    kind: str
    cover: str
    name: str


def row_of(values: Mapping[str, Any], place: str) -> Row:
    """A row from named values; raises InputError where x, y or z is no finite number."""
    found = {wanted: _value(values, names) for wanted, names in _COLUMNS.items()}
    numbers = []
    for axis in ("x", "y", "z"):
        text = found[axis]
        try:
            number = float(text if text is not None else "")
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            what = "is missing" if text is None else f"{excerpt(text)} is no number (1234.5, with a point)"
            raise InputError(f"{place}: {axis} {what}")
        if abs(number) >= FARTHEST:
            raise InputError(
                f"{place}: {axis} {excerpt(text)} is farther than {FARTHEST:g}, where nothing lies"
            )
        numbers.append(number)
    kind, cover, name = ("" if (v := found[k]) is None else str(v).strip() for k in ("kind", "cover", "name"))
    return Row(numbers[0], numbers[1], numbers[2], kind, cover, name)


def _value(values: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((values[name] for name in names if values.get(name) is not None), None)
