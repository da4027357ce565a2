"""Exact lengths and linear units: every unit is a fraction of a metre.

Printed lengths are in the unit of the CRS, followed by metres if the number of feet is not round.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

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


class Sides(NamedTuple):
    """Width and height of a rectangle in metres."""

    width: Fraction
    height: Fraction


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


def parse_sides(text: str | float | Fraction) -> Sides:
    """Return the sides of a square from a length, or those of a rectangle from text like ``1000x1250`` or ``2x3km``.

    A number without a unit has the unit of the other number. Raise ConfigError if the text is not a length.
    """
    if isinstance(text, Fraction):
        return Sides(text, text)
    width, by, height = str(text).lower().partition("x")
    if not by:
        length = parse_length(text)
        return Sides(length, length)
    sides = Sides(parse_length(width), parse_length(height))
    units = [side.strip().lstrip("0123456789./ ") for side in (width, height)]
    if not units[0]:
        return Sides(parse_length(width.strip() + units[1]), sides.height)
    if not units[1]:
        return Sides(sides.width, parse_length(height.strip() + units[0]))
    return sides


def sides_text(sides: Sides, text: Callable[[Fraction], str]) -> str:
    """Return ``WIDTHxHEIGHT``, or one length for a square, where ``text`` writes a length."""
    return "x".join(dict.fromkeys(map(text, sides)))


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


SQUARE_KM, ACRE, ACRES_PER_SQUARE_MILE = 1e6, float(43_560 * FOOT**2), 640
ROUND = 3e-6
"""Largest relative rounding error with which a number of feet counts as round and is printed without metres.

The rounded value has two decimals, or one from ten feet on. The two kinds of foot differ by
2e-6."""

_METRES = re.compile(r"(?<![\w.,(])(?:([\d.]+) to )?([\d.]+(?:e-?\d+)?) m\b(?! =|[/\\]|\.\w)")
"""Length in metres without feet. Lengths in brackets and before ``=`` have feet already, and
``5 m.laz`` is a name."""


def short_unit(metres: Fraction | float) -> str:
    """Return ``m`` or ``ft``, or the metres per unit of another unit."""
    for unit, name in ((METRE, "m"), (FOOT, "ft"), (US_SURVEY_FOOT, "ft")):
        if abs(float(metres) / float(unit) - 1) < 1e-9:
            return name
    return f"units of {float(metres):g} m"


def written_unit(metres: Fraction) -> str:
    """Return the unit as it is written after a length on the command line."""
    return "usft" if metres == US_SURVEY_FOOT else short_unit(metres)


def length_option(metres: Fraction, unit: Fraction) -> str:
    """Return a length as a value on the command line: ``2``, or ``3ft`` if the unit of the CRS is the foot."""
    if short_unit(unit) != "ft":
        return f"{float(metres):g}"
    return f"{float(metres / unit):g}{written_unit(unit)}"


def whole_length(
    metres: Fraction | float, unit: Fraction, rounding: Callable[[Fraction], int]
) -> Fraction:
    """Return a length in metres that is a whole number of metres, or of feet if the unit of the CRS is the foot."""
    step = unit if short_unit(unit) == "ft" else METRE
    return rounding(Fraction(metres) / step) * step


def area_text(square_metres: float, unit: float | Fraction) -> str:
    """Return an area as text: ``0.25 km2``, or for a CRS in feet ``62 acres`` or square miles."""
    if short_unit(unit) != "ft":
        return f"{square_metres / SQUARE_KM:,.3g} km2"
    acres = square_metres / ACRE
    return (
        f"{acres:,.3g} acres"
        if acres < ACRES_PER_SQUARE_MILE
        else f"{acres / ACRES_PER_SQUARE_MILE:,.3g} sq mi"
    )


def small_area_text(square_metres: float, unit: float | Fraction) -> str:
    """Return a small area as text: ``9,200 m2``, or for a CRS in feet ``99,000 ft2``."""
    name = short_unit(unit)
    return (
        f"{square_metres / float(unit) ** 2:,.0f} ft2"
        if name == "ft"
        else f"{square_metres:,.0f} m2"
    )


def length_text(metres: float | Fraction, unit: float | Fraction) -> str:
    """Return a length as text: ``2 m``, or for a CRS in feet ``3 ft`` or ``3.28 ft (1 m)``.

    Metres are added if the number of feet is not round.

    Parameters
    ----------
    metres : number
    unit : number
        Metres per unit of the CRS.
    """
    name = short_unit(unit)
    if name == "m":
        return f"{float(metres):.6g} m"
    number = float(metres) / float(unit)
    nearest = round(number, 2 if number < 10 else 1)
    if nearest and abs(number / nearest - 1) < ROUND:
        return f"{nearest:,g} {name}"
    return f"{number_text(number)} {name} ({float(metres):.6g} m)"


def number_text(number: float) -> str:
    """Return a positive number with three digits, or rounded to a whole number if it is large."""
    return f"{number:,.0f}" if number >= 100 else f"{number:.3g}"


def in_unit_of_crs(text: str, units: Units) -> str:
    """Add feet to the lengths in metres of a text if the CRS is in feet: ``0.12 m`` becomes ``0.394 ft (0.12 m)``.

    The text does not change if heights have another unit than x and y, since a length may be in
    either direction.
    """
    if short_unit(units.horizontal) != "ft" or units.vertical != units.horizontal:
        return text

    def length(found: re.Match[str]) -> str:
        lengths = [
            length_text(float(number), units.horizontal) for number in found.groups() if number
        ]
        return " to ".join(lengths)

    return _METRES.sub(length, text)
