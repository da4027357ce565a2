"""Lengths and linear units, exact: every unit is a fraction of a metre."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction

from tiler.errors import ConfigError

METRE = Fraction(1)
FOOT = Fraction(3048, 10000)
US_SURVEY_FOOT = Fraction(1200, 3937)

FARTHEST = 9e12
"""Units of the CRS: what is not nearer to its origin is no coordinate, see `tiler.ingest.requantise.BEYOND`."""

_NAMES = {
    "m": METRE, "metre": METRE, "meter": METRE, "metres": METRE, "meters": METRE,
    "cm": Fraction(1, 100), "mm": Fraction(1, 1000), "km": Fraction(1000),
    "ft": FOOT, "foot": FOOT, "feet": FOOT, "ift": FOOT,
    "usft": US_SURVEY_FOOT, "us-ft": US_SURVEY_FOOT, "ftus": US_SURVEY_FOOT, "us_survey_foot": US_SURVEY_FOOT,
    "us survey foot": US_SURVEY_FOOT,
}  # fmt: skip
_AREAS = {
    "": METRE, "m2": METRE, "ha": Fraction(10_000), "km2": Fraction(10**6), "ft2": FOOT**2, "acre": 43560 * FOOT**2,
    "acres": 43560 * FOOT**2,
}  # fmt: skip
_LENGTH = re.compile(r"\s*([0-9]*\.?[0-9]+(?:/0*[1-9][0-9]*)?)\s*([a-zA-Z_-]*)\s*$")


def unit_named(name: str) -> Fraction:
    """Metres in one unit called ``name`` (``m``, ``ft``, ``usft``, ...); raises ConfigError."""
    try:
        return _NAMES[name.strip().lower()]
    except KeyError:
        raise ConfigError(
            f"unknown unit {name!r}: use m, ft (international) or usft (US survey foot)"
        ) from None


def unit_label(metres: Fraction) -> str:
    """The GDAL-style name of a linear unit: ``metre``, ``foot``, ``US survey foot``, else metres per unit."""
    labels = {METRE: "metre", FOOT: "foot", US_SURVEY_FOOT: "US survey foot"}
    return labels.get(metres, f"{float(metres):.12g} m")


def exact_unit(metres: float) -> Fraction:
    """The exact fraction behind a floating conversion factor of a CRS (``0.3048006096...`` is 1200/3937)."""
    for known in (METRE, FOOT, US_SURVEY_FOOT):
        if abs(metres / float(known) - 1.0) < 1e-9:
            return known
    return Fraction(metres).limit_denominator(10**9)


def parse_length(text: str | float | Fraction) -> Fraction:
    """A length in metres, exact: ``1``, ``0.5``, ``1/3``, ``3ft``, ``1usft``, ``50cm``; raises ConfigError."""
    if isinstance(text, Fraction):
        return text
    match = _LENGTH.match(str(text))
    if match is None:
        raise ConfigError(
            f"{text!r} is no length: write a number, with a unit if it is not metres (1, 0.5, 1/3, 3ft)"
        )
    number, unit = match.groups()
    value = Fraction(number) if "/" not in number else Fraction(*map(Fraction, number.split("/")))
    return value * (unit_named(unit) if unit else METRE)


def parse_area(text: str | float | Fraction) -> Fraction:
    """An area in square metres, exact: ``8000``, ``0.8ha``, ``2 acres``; raises ConfigError."""
    if isinstance(text, Fraction):
        return text
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*([a-z0-9]*)\s*", str(text).lower())
    if match is None or match[2] not in _AREAS:
        raise ConfigError(
            f"{text!r} is no area: write square metres, or a number with m2, ha, km2, ft2 or acre"
        )
    return Fraction(match[1]) * _AREAS[match[2]]


@dataclass(frozen=True)
class Units:
    """Metres per unit of the CRS, horizontally and vertically."""

    horizontal: Fraction = METRE
    vertical: Fraction = METRE
