"""Parsers of plain values of settings (TOML, JSON, options). A wrong value raises ConfigError."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, TypeVar

from tiler.core.file_names import check_template, product_names
from tiler.core.products import MAX_RESOLUTIONS, parse_nodata
from tiler.core.selection import parse_angle, parse_numbers, parse_returns, parse_sources
from tiler.core.units import FARTHEST, Sides, parse_area, parse_length, parse_sides, sides_text
from tiler.errors import ConfigError

Value = TypeVar("Value")

_BYTES = {"": 1, "b": 1}
for _power, _letter in enumerate("kmgt", start=1):
    _BYTES |= {_letter: 1000**_power, f"{_letter}b": 1000**_power, f"{_letter}ib": 1024**_power}


MIN_BYTES = 2**20
"""Smallest memory size. Who writes less has left out the unit."""


def parse_bytes(value: Any) -> int:
    """Parse a memory size (``1000000``, ``4GB``, ``2GiB``, ``512M``) into bytes, or raise ConfigError."""
    text = str(value).strip()
    number = text.rstrip("bBkKmMgGtTiI")
    try:
        size = int(float(number) * _BYTES[text[len(number) :].lower()])
    except (ValueError, KeyError, OverflowError):
        raise ConfigError(
            f"{value!r} is not a memory size; give 4GB, 512MiB or a number of bytes"
        ) from None
    if size < MIN_BYTES:
        raise ConfigError(f"{value!r} is a memory size of {size} bytes; give a unit, as in 4GB")
    return size


def parse_classes(value: Any) -> tuple[int, ...]:
    """Parse ASPRS classes from ``7,18``, ``3-5``, 7 or a list, or raise ConfigError.

    ``none`` and an empty text give an empty tuple.
    """
    if value == "none":
        return ()
    return parse_numbers(value, "classes", 0, 255)


def parse_names(
    name: str, text: str | list[str] | tuple[str, ...], choices: tuple[str, ...]
) -> tuple[str, ...]:
    """Parse names among ``choices`` from one or several texts, or raise ConfigError.

    The result has the order of the choices.
    """
    texts = [text] if isinstance(text, str) else text
    found: list[str] = []
    for each in texts:
        found += [part.strip() for part in str(each).split(",") if part.strip()]
    for item in found:
        if item not in choices:
            raise ConfigError(f"{name} {item!r}: choose from {', '.join(choices)}")
    if not found:
        raise ConfigError(f"{name} is empty; give at least one of {', '.join(choices)}")
    return tuple(c for c in choices if c in found)


def parse_surface(value: Any) -> str:
    """Return the value if it is ``all``, ``median`` or ``p0`` to ``p100``, or raise ConfigError."""
    if value in ("all", "median"):
        return str(value)
    if (
        isinstance(value, str)
        and value[:1] == "p"
        and value[1:].isdecimal()
        and int(value[1:]) <= 100
    ):
        return value
    raise ConfigError(
        f"surface {value!r} is not valid; give all, median, or a percentile of the heights like p10"
    )


def parse_pairs(value: Any) -> tuple[tuple[str, str], ...]:
    """Parse names and values of parameters from strings ``name=value`` or a mapping, or raise ConfigError."""
    if isinstance(value, Mapping):
        return tuple((str(k), str(v)) for k, v in value.items())
    if not isinstance(value, list | tuple):
        raise ConfigError(
            f"parameters {value!r}: must be a table of name = value, or a list of 'name=value'"
        )
    pairs = []
    for item in value:
        if isinstance(item, list | tuple) and len(item) == 2:
            name, sign, text = str(item[0]), "=", str(item[1])
        else:
            name, sign, text = str(item).partition("=")
        if not sign or not name:
            raise ConfigError(
                f"--set {item} is not valid; give name=value (`tiler methods` lists the names)"
            )
        pairs.append((name.strip(), text.strip()))
    return tuple(pairs)


def _named(name: str, parse: Callable[[Any], Value], value: Any) -> Value:
    """Parse a value, and begin an error with the name of the setting."""
    try:
        return parse(value)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error


def _positive_length(name: str, value: Any) -> Fraction:
    length = _named(name, parse_length, value)
    may_be_zero = name in ("halo", "erode", "contour_smooth")
    if length < 0 or (length == 0 and not may_be_zero):
        raise ConfigError(
            f"{name} {value}: must be {'0 or above' if may_be_zero else 'above 0'}"
        )
    return length


def _lengths(name: str, value: Any) -> Fraction | tuple[Fraction, ...]:
    """Return one length, or several in ascending order, from ``0.5,2`` or a list."""
    parts = value.split(",") if isinstance(value, str) else value
    if not isinstance(parts, list | tuple):
        parts = [parts]
    found = tuple(_positive_length(name, part) for part in parts)
    if not found:
        raise ConfigError(f"{name} {value!r}: is empty; give at least one length")
    if len(found) > MAX_RESOLUTIONS:
        raise ConfigError(
            f"{name} {value!r}: has {len(found)} lengths; give at most {MAX_RESOLUTIONS}"
        )
    if len(set(found)) < len(found):
        raise ConfigError(f"{name} {value!r}: has a length twice; give each once")
    return tuple(sorted(found)) if len(found) > 1 else found[0]


def _sheets(value: Any) -> Sides | str:
    """Return the sides of sheets, or the name of a file: a text that ends in a suffix or begins as a path (``./1000``).

    A length is not the name of a file.
    """
    try:
        sides = parse_sides(value)
    except ConfigError as error:
        if isinstance(value, str) and re.search(r"\.[a-zA-Z]\w*$|^\.{0,2}[/\\]", value):
            return value
        raise ConfigError(
            f"sheets: {error}, width x height (1000x1250), or a file of polygons (sheets.gpkg)"
        ) from error
    if min(sides) <= 0:
        raise ConfigError(f"sheets {value}: must be above 0")
    return sides


def _bounds(value: Any) -> tuple[float, float, float, float]:
    try:
        x0, y0, x1, y1 = (float(v) for v in value)
    except (TypeError, ValueError):
        raise ConfigError(
            f"bounds {value!r} are not valid; give four numbers X0 Y0 X1 Y1 in units of the CRS"
        ) from None
    if not (x0 < x1 and y0 < y1):
        raise ConfigError(f"bounds {value!r}: X0 must be below X1 and Y0 below Y1")
    if not all(abs(v) < FARTHEST for v in (x0, y0, x1, y1)):
        raise ConfigError(
            f"bounds {value!r}: exceed {FARTHEST:g}; give coordinates in units of the CRS"
        )
    return x0, y0, x1, y1


def _crs(value: Any) -> str:
    """Return a CRS as text, where a whole number is an EPSG code."""
    if isinstance(value, str):
        return value
    if isinstance(value, int) and not isinstance(value, bool):
        return f"EPSG:{value}"
    raise ConfigError(f"crs {value!r} is not valid; give EPSG:2154, 2154, WKT or none")


def parse_files(name: str, value: Any) -> tuple[str, ...]:
    """Parse one name of a file or a list of names, without repetitions, or raise ConfigError."""
    files = [value] if isinstance(value, str) else value
    if not isinstance(files, list | tuple) or not all(isinstance(f, str) and f for f in files):
        raise ConfigError(f"{name} {value!r}: must be the name of a file, or a list of names")
    return tuple(dict.fromkeys(files))


Parser = Callable[[Any], Any]
_NAMELESS_PARSERS: dict[str, Parser] = {
    "area": parse_area,
    "bytes": parse_bytes,
    "classes": parse_classes,
    "returns": parse_returns,
    "sources": parse_sources,
    "angle": parse_angle,
}
"""Parsers by kind of setting whose errors do not name the setting."""
_PARSERS: dict[str, Parser] = {
    "nodata": parse_nodata,
    "surface": parse_surface,
    "pairs": parse_pairs,
    "bounds": _bounds,
    "sheets": _sheets,
    "crs": _crs,
}
"""Parsers by kind of setting whose errors name the setting."""


def parse_value(spec: dataclasses.Field[Any], value: Any) -> Any:
    """Parse a plain value for a field of `RunConfig` by the ``kind`` of the field, or raise ConfigError."""
    kind = spec.metadata["kind"]
    texts = value if isinstance(value, list | tuple) else [value]
    if any(isinstance(text, str) and "\0" in text for text in texts):
        raise ConfigError(f"{spec.name} {value!r}: holds a NUL character; remove it")
    if value is None:
        if spec.default is not None:
            raise ConfigError(f"{spec.name}: has no value; give one")
        return None
    if kind == "length":
        return _positive_length(spec.name, value)
    if kind == "lengths":
        return _lengths(spec.name, value)
    if kind in _NAMELESS_PARSERS:
        return _named(spec.name, _NAMELESS_PARSERS[kind], value)
    if kind in _PARSERS:
        return _PARSERS[kind](value)
    if kind == "names":
        if not isinstance(value, str | list | tuple):
            raise ConfigError(f"{spec.name} {value!r}: must be names separated by commas")
        return parse_names(spec.name, value, spec.metadata["choices"])
    if kind == "files":
        return parse_files(spec.name, value)
    if kind == "template" and isinstance(value, str):
        return check_template(value)
    if kind == "product_names" and isinstance(value, str):
        product_names(value)
        return value
    if kind == "int" and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
        raise ConfigError(f"{spec.name} {value!r}: must be a whole number above 0")
    if kind == "flag" and not isinstance(value, bool):
        raise ConfigError(f"{spec.name} {value!r}: must be true or false")
    if kind == "choice" and value not in spec.metadata["choices"]:
        raise ConfigError(
            f"{spec.name} {value!r}: choose one of {', '.join(spec.metadata['choices'])}"
        )
    texts_only = ("text", "choice", "preset", "file", "template", "product_names")
    if kind in texts_only and not isinstance(value, str):
        raise ConfigError(f"{spec.name} {value!r}: must be text")
    return value


def plain_value(value: Any) -> Any:
    """Return a value of a setting for JSON and TOML."""
    if isinstance(value, Fraction):
        decimal = f"{float(value):.12g}"
        if "e" in decimal or Fraction(decimal) != value:
            return str(value)
        return decimal
    if isinstance(value, Sides):
        return sides_text(value, plain_value)
    if isinstance(value, tuple):
        return [plain_value(v) for v in value]
    if isinstance(value, float) and math.isnan(value):
        return "nan"  # because JSON has no number for NaN
    return value
