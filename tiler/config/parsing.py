"""Plain values of settings (TOML, JSON, options) as what they stand for; what makes no sense raises ConfigError."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any, TypeVar

from tiler.core.nodata import parse_nodata
from tiler.core.sheet_names import check_template
from tiler.core.units import FARTHEST, parse_area, parse_length
from tiler.errors import ConfigError

Value = TypeVar("Value")

_BYTES = {"": 1, "b": 1, "k": 1000, "kb": 1000, "kib": 1024, "m": 10**6, "mb": 10**6, "mib": 1 << 20,
          "g": 10**9, "gb": 10**9, "gib": 1 << 30, "t": 10**12, "tb": 10**12, "tib": 1 << 40}  # fmt: skip


def parse_bytes(value: Any) -> int:
    """A memory size in bytes: ``1000000``, ``4GB``, ``2GiB``, ``512M``; raises ConfigError."""
    text = str(value).strip()
    number = text.rstrip("bBkKmMgGtTiI")
    try:
        size = int(float(number) * _BYTES[text[len(number) :].lower()])
    except (ValueError, KeyError, OverflowError):
        raise ConfigError(f"{value!r} is no memory size: write 4GB, 512MiB or a number of bytes") from None
    if size <= 0:
        raise ConfigError(f"{value!r} is no memory size: it must be above 0")
    return size


def parse_classes(value: Any) -> tuple[int, ...]:
    """ASPRS classes: ``7,18``, 7 or a list; ``none`` or an empty text is no class; raises ConfigError."""
    if value == "none":
        return ()
    parts = value if isinstance(value, list | tuple) else [p for p in str(value).split(",") if p.strip()]
    try:
        classes = tuple(sorted({int(str(p)) for p in parts}))
    except ValueError:
        raise ConfigError(f"{value!r} are no classes: write numbers with commas, like 7,18") from None
    if any(not 0 <= c <= 255 for c in classes):
        raise ConfigError(f"{value!r}: classes are 0 to 255")
    return classes


def parse_names(
    name: str, text: str | list[str] | tuple[str, ...], choices: tuple[str, ...]
) -> tuple[str, ...]:
    """Some of ``choices``, in their order: ``dtm,slope``; raises ConfigError."""
    parts = text.split(",") if isinstance(text, str) else list(text)
    found = [str(p).strip() for p in parts if str(p).strip()]
    for item in found:
        if item not in choices:
            raise ConfigError(f"{name} {item!r}: choose from {', '.join(choices)}")
    if not found:
        raise ConfigError(f"{name}: names at least one of {', '.join(choices)}")
    return tuple(c for c in choices if c in found)


def parse_surface(value: Any) -> str:
    """``all``, ``median`` or ``p0`` to ``p100``; raises ConfigError."""
    if value in ("all", "median"):
        return str(value)
    if isinstance(value, str) and value[:1] == "p" and value[1:].isdecimal() and int(value[1:]) <= 100:
        return value
    raise ConfigError(f"surface {value!r}: write all, median, or a percentile of the heights like p10")


def parse_pairs(value: Any) -> tuple[tuple[str, str], ...]:
    """``name=value`` settings of a method, from strings or a mapping; raises ConfigError."""
    if isinstance(value, Mapping):
        return tuple((str(k), str(v)) for k, v in value.items())
    if not isinstance(value, list | tuple):
        raise ConfigError(f"parameters {value!r}: must be a table of name = value, or a list of 'name=value'")
    pairs = []
    for item in value:
        pair = isinstance(item, list | tuple) and len(item) == 2
        name, sign, text = (str(item[0]), "=", str(item[1])) if pair else str(item).partition("=")
        if not sign or not name:
            raise ConfigError(f"--set {item}: write name=value; `tiler methods` lists the names")
        pairs.append((name.strip(), text.strip()))
    return tuple(pairs)


def _named(name: str, parse: Callable[[Any], Value], value: Any) -> Value:
    """What a parser makes of a value; an error says of which setting it is."""
    try:
        return parse(value)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error


def _positive_length(name: str, value: Any) -> Fraction:
    length = _named(name, parse_length, value)
    if length < 0 or (length == 0 and name not in ("halo", "erode", "contour_smooth")):
        raise ConfigError(f"{name} {value}: must be above 0")
    return length


def _bounds(value: Any) -> tuple[float, float, float, float]:
    try:
        x0, y0, x1, y1 = (float(v) for v in value)
    except (TypeError, ValueError):
        raise ConfigError(f"bounds {value!r}: write four numbers X0 Y0 X1 Y1 in units of the CRS") from None
    if not (x0 < x1 and y0 < y1):
        raise ConfigError(f"bounds {value!r}: X0 must be below X1 and Y0 below Y1")
    if not all(abs(v) < FARTHEST for v in (x0, y0, x1, y1)):
        raise ConfigError(
            f"bounds {value!r}: nothing lies farther than {FARTHEST:g}; write coordinates of the CRS"
        )
    return x0, y0, x1, y1


def parse_files(name: str, value: Any) -> tuple[str, ...]:
    """Names of files, one or a list, each once; raises ConfigError."""
    files = [value] if isinstance(value, str) else value
    if not isinstance(files, list | tuple) or not all(isinstance(f, str) and f for f in files):
        raise ConfigError(f"{name} {value!r}: must be the name of a file, or a list of them")
    return tuple(dict.fromkeys(files))


Parser = Callable[[Any], Any]
_NAMED_PARSERS: dict[str, Parser] = {"area": parse_area, "bytes": parse_bytes, "classes": parse_classes}
_PARSERS: dict[str, Parser] = {
    "nodata": parse_nodata,
    "surface": parse_surface,
    "pairs": parse_pairs,
    "bounds": _bounds,
}
"""By kind of setting; those of the first table do not name it."""


def parse_value(spec: dataclasses.Field[Any], value: Any) -> Any:
    """One plain value as its field of `RunConfig` wants it, by the field's ``kind``; raises ConfigError."""
    kind = spec.metadata["kind"]
    if value is None:
        if spec.default is not None:
            raise ConfigError(f"{spec.name}: needs a value")
        return None
    if kind == "length":
        return _positive_length(spec.name, value)
    if kind in _NAMED_PARSERS:
        return _named(spec.name, _NAMED_PARSERS[kind], value)
    if kind in _PARSERS:
        return _PARSERS[kind](value)
    if kind == "names":
        if not isinstance(value, str | list | tuple):
            raise ConfigError(f"{spec.name} {value!r}: must be names with commas")
        return parse_names(spec.name, value, spec.metadata["choices"])
    if kind == "files":
        return parse_files(spec.name, value)
    if kind == "template" and isinstance(value, str):
        return check_template(value)
    if kind == "int" and (not isinstance(value, int) or isinstance(value, bool) or value < 1):
        raise ConfigError(f"{spec.name} {value!r}: must be a whole number above 0")
    if kind == "flag" and not isinstance(value, bool):
        raise ConfigError(f"{spec.name} {value!r}: must be true or false")
    if kind == "choice" and value not in spec.metadata["choices"]:
        raise ConfigError(f"{spec.name} {value!r}: choose one of {', '.join(spec.metadata['choices'])}")
    if kind in ("text", "choice", "preset", "file", "template") and not isinstance(value, str):
        raise ConfigError(f"{spec.name} {value!r}: must be text")
    return value


def plain_value(value: Any) -> Any:
    """A value of a setting as JSON and TOML can hold it."""
    if isinstance(value, Fraction):
        decimal = f"{float(value):.12g}"
        return decimal if "e" not in decimal and Fraction(decimal) == value else str(value)
    if isinstance(value, tuple):
        return [plain_value(v) for v in value]
    return value
