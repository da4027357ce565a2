"""Printed lengths: in the unit of the CRS, followed by metres if the number of feet is not round."""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction

from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, Units

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
