"""Exact lengths and linear units: every unit is a fraction of a metre."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from tiler.errors import ConfigError

METRE = Fraction(1)
FOOT = Fraction(3048, 10000)
US_SURVEY_FOOT = Fraction(1200, 3937)

FARTHEST = 9e12
"""Largest coordinate, in units of the CRS (see `tiler.inputs.requantise.BEYOND`)."""

FEET = ("ft", "foot", "feet")
"""Names of the foot that the CRS uses. `tiler.plan.make` decides which foot this is."""

_NAMES = {
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), METRE),
    "cm": METRE / 100,
    "mm": METRE / 1000,
    "km": METRE * 1000,
    **dict.fromkeys(("ft", "foot", "feet", "ift"), FOOT),
    **dict.fromkeys(
        ("usft", "us-ft", "ftus", "us_survey_foot", "us survey foot"), US_SURVEY_FOOT
    ),
}
_ACRE = 43560 * FOOT**2
_AREAS = {
    "": METRE,
    "m2": METRE,
    "ha": Fraction(10_000),
    "km2": Fraction(10**6),
    "ft2": FOOT**2,
    "acre": _ACRE,
    "acres": _ACRE,
}
_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+(?:/0*[1-9][0-9]*)?)\s*([a-zA-Z_-]*)\s*$")


class BareLength(Fraction):
    """Length in metres that was written without a unit."""


class FeetLength(Fraction):
    """Length in metres that was written in feet without the kind of foot."""


def unit_named(name: str) -> Fraction:
    """Return the metres in one unit ``name`` (``m``, ``ft``, ``usft``, ...). Raise ConfigError if it is unknown."""
    try:
        return _NAMES[name.strip().lower()]
    except KeyError:
        raise ConfigError(
            f"unknown unit {name!r}; use m, ft (international) or usft (US survey foot)"
        ) from None


def unit_label(metres: Fraction) -> str:
    """Return the name of a linear unit as in GDAL: ``metre``, ``foot``, ``US survey foot``, or metres per unit."""
    labels = {METRE: "metre", FOOT: "foot", US_SURVEY_FOOT: "US survey foot"}
    return labels.get(metres, f"{float(metres):.12g} m")


def unit_plural(metres: Fraction) -> str:
    """Return the plural of a linear unit: ``metres``, ``feet``, ``US survey feet``, or ``units of 0.9 m``."""
    labels = {METRE: "metres", FOOT: "feet", US_SURVEY_FOOT: "US survey feet"}
    return labels.get(metres, f"units of {float(metres):.12g} m")


def exact_unit(metres: float) -> Fraction:
    """Return the exact fraction of a floating-point conversion factor of a CRS (``0.3048006096...`` is 1200/3937)."""
    for known in (METRE, FOOT, US_SURVEY_FOOT):
        if abs(metres / float(known) - 1.0) < 1e-9:
            return known
    return Fraction(metres).limit_denominator(10**9)


def parse_length(text: str | float | Fraction) -> Fraction:
    """Return an exact length in metres from text like ``1``, ``0.5``, ``1/3``, ``3ft`` or ``50cm``.

    Raise ConfigError if the text is not a length.
    """
    if isinstance(text, Fraction):
        return text
    match = _LENGTH.match(str(text))
    if match is None:
        raise ConfigError(
            f"{text!r} is not a length; give a number in metres or with a unit (1, 0.5, 1/3, 3ft)"
        )
    number, unit = match.groups()
    dividend, _, divisor = number.partition("/")
    value = Fraction(dividend) / Fraction(divisor or 1)
    if not unit:
        return BareLength(value)
    length = value * unit_named(unit)
    return FeetLength(length) if unit.lower() in FEET else length


def parse_area(text: str | float | Fraction) -> Fraction:
    """Return an exact area in square metres from text like ``8000``, ``0.8ha`` or ``2 acres``.

    Raise ConfigError if the text is not an area.
    """
    if isinstance(text, Fraction):
        return text
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*([a-z0-9]*)\s*", str(text).lower())
    if match is None or match[2] not in _AREAS:
        raise ConfigError(
            f"{text!r} is not an area; give square metres, or a number with m2, ha, km2, ft2 or acre"
        )
    return Fraction(match[1]) * _AREAS[match[2]]


@dataclass(frozen=True)
class Units:
    """Horizontal and vertical units of a CRS, in metres per unit."""

    horizontal: Fraction = METRE
    vertical: Fraction = METRE
