"""Parameters of methods: frozen dataclasses whose fields carry help, range, unit and source."""

from __future__ import annotations

import dataclasses
from dataclasses import field, fields
from typing import Any, TypeVar

UNIT_SUFFIXES = ("_m", "_deg")

DECIMALS = 6
"""Lengths in metres have at most this many decimals.

The size of a cell is an exact fraction of counts. With more decimals, products with the terms
of the fraction could exceed int64.
"""


def parameter(
    default: float | int | bool,
    help: str,
    minimum: float | None = None,
    maximum: float | None = None,
    unit: str = "",
    source: str = "",
) -> Any:
    """Return a dataclass field with help, closed range, unit and source in the literature."""
    metadata = {
        "help": help,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "source": source,
    }
    return field(default=default, metadata=metadata)


def like(cls: type[Any], name: str, default: float | int | bool | None = None) -> Any:
    """Return a field of the parameters of another method, optionally with another default."""
    spec = next(spec for spec in fields(cls) if spec.name == name)
    value: Any = default
    if default is None:
        value = spec.default
    return field(default=value, metadata=spec.metadata)


T = TypeVar("T")


def check(params: Any) -> None:
    """Refuse parameter values of the wrong type or out of range.

    Raises
    ------
    ValueError
        A value cannot be used. The message names the parameter, the value and the allowed values.
    """
    for spec in fields(params):
        value = getattr(params, spec.name)
        low, high = spec.metadata["minimum"], spec.metadata["maximum"]
        if not _is_of_kind(value, spec.default):
            raise ValueError(f"{spec.name} {value!r}: must be {_kind(spec.default)}")
        # The negated comparisons also refuse NaN.
        below = low is not None and not value >= low
        if below or (high is not None and not value <= high):
            unit = f" {spec.metadata['unit']}".rstrip()
            raise ValueError(
                f"{spec.name} {value:g}: must be between {low:g} and {high:g}{unit}"
            )
        if spec.metadata["unit"] == "m" and round(value, DECIMALS) != value:
            raise ValueError(
                f"{spec.name} {value!r}: write at most {DECIMALS} decimals, as {round(value, DECIMALS)!r}"
            )


def _is_of_kind(value: Any, default: Any) -> bool:
    if isinstance(default, bool) or isinstance(value, bool):
        return isinstance(default, bool) and isinstance(value, bool)
    return isinstance(value, int) or (isinstance(default, float) and isinstance(value, float))


def _kind(default: Any) -> str:
    if isinstance(default, bool):
        return "true or false"
    if isinstance(default, int):
        return "a whole number"
    return "a number"


def parse(cls: type[T], texts: dict[str, str]) -> T:
    """Make parameters from ``name=value`` texts, in which names may omit the unit suffix (``_m``, ``_deg``).

    Raises
    ------
    ValueError
        A text cannot be used. The message names the parameter, the value and the allowed values.
    """
    known = {spec.name: spec for spec in fields(cls)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for name, text in texts.items():
        full_names = (name, *(name + suffix for suffix in UNIT_SUFFIXES))
        full = next((full_name for full_name in full_names if full_name in known), None)
        if full is None:
            raise ValueError(f"no parameter {name!r}; there are {', '.join(known)}")
        if full in values:
            raise ValueError(f"{full}: given twice, with and without its unit; give it once")
        values[full] = _parse_value(full, text, known[full].default)
    return cls(**values)


def _parse_value(name: str, text: str, default: Any) -> Any:
    if isinstance(default, bool):
        words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
        if text.lower() not in words:
            raise ValueError(f"{name} {text!r}: must be {_kind(default)}")
        return words[text.lower()]
    try:
        return type(default)(text)
    except ValueError:
        raise ValueError(f"{name} {text!r}: must be {_kind(default)}") from None


def to_json(params: Any) -> dict[str, Any]:
    """Return the values of parameters by name, in the order of the fields."""
    return dataclasses.asdict(params)
