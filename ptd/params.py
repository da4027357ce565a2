"""Parameters of methods: frozen dataclasses whose fields say what people need to know."""

from __future__ import annotations

import dataclasses
from dataclasses import field, fields
from typing import Any, TypeVar

UNIT_SUFFIXES = ("_m", "_deg")


def parameter(
    default: float | int | bool,
    help: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    source: str = "",
) -> Any:
    """A field with help, unit, closed range and the place in the literature that it comes from."""
    metadata = {"help": help, "unit": unit, "minimum": minimum, "maximum": maximum, "source": source}
    return field(default=default, metadata=metadata)


T = TypeVar("T")


def check(params: Any) -> None:
    """Raise ValueError, naming parameter, value and range, if a value of a parameter dataclass is out of range."""
    for spec in fields(params):
        value = getattr(params, spec.name)
        low, high = spec.metadata["minimum"], spec.metadata["maximum"]
        if isinstance(spec.default, bool) != isinstance(value, bool):
            raise ValueError(
                f"{spec.name} {value!r}: must be {'true or false' if spec.default in (True, False) else 'a number'}"
            )
        below = low is not None and not value >= low
        if below or (high is not None and not value <= high):
            unit = f" {spec.metadata['unit']}" if spec.metadata["unit"] else ""
            raise ValueError(f"{spec.name} {value:g}: must be between {low:g} and {high:g}{unit}")


def parse(cls: type[T], texts: dict[str, str]) -> T:
    """Parameters from ``name=value`` texts; a name may leave out its unit suffix (``_m``, ``_deg``).

    Raises
    ------
    ValueError
        One line that names the parameter, the value and what would be right.
    """
    known = {spec.name: spec for spec in fields(cls)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for name, text in texts.items():
        full = next((n for n in (name, *(name + s for s in UNIT_SUFFIXES)) if n in known), None)
        if full is None:
            raise ValueError(f"no parameter {name!r}; there are {', '.join(known)}")
        values[full] = _parse_value(full, text, known[full].default)
    return cls(**values)


def _parse_value(name: str, text: str, default: Any) -> Any:
    if isinstance(default, bool):
        words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
        if text.lower() not in words:
            raise ValueError(f"{name} {text!r}: must be true or false")
        return words[text.lower()]
    try:
        return type(default)(text)
    except ValueError:
        kind = "a whole number" if isinstance(default, int) else "a number"
        raise ValueError(f"{name} {text!r}: must be {kind}") from None


def to_json(params: Any) -> dict[str, Any]:
    """Plain values by name, in the order of the fields."""
    return dataclasses.asdict(params)
