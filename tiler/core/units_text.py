"""Lengths as they are printed: in the unit of the CRS, with metres beside them where those are the rounder number."""

from __future__ import annotations

import re
from fractions import Fraction

from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, Units

SQUARE_KM, ACRE, ACRES_PER_SQUARE_MILE = 1e6, float(43_560 * FOOT**2), 640
ROUND = 3e-6
"""A number of feet that is nearer than this share to one with two decimals, or above ten to one with one, is printed
alone: the two feet differ by 2e-6."""

_METRES = re.compile(r"(?<![\w.,(])(?:([\d.]+) to )?([\d.]+(?:e-?\d+)?) m\b(?! =|[/\\]|\.\w)")
"""A length in metres. One in brackets, and one before ``=``, has its feet already; ``5 m.laz`` is a name."""


def short_unit(metres: Fraction | float) -> str:
    """``m`` or ``ft``; of another unit how many metres it has."""
    for unit, name in ((METRE, "m"), (FOOT, "ft"), (US_SURVEY_FOOT, "ft")):
        if abs(float(metres) / float(unit) - 1) < 1e-9:
            return name
    return f"units of {float(metres):g} m"


def written_unit(metres: Fraction) -> str:
    """The unit as it is written behind a length on the command line."""
    return "usft" if metres == US_SURVEY_FOOT else short_unit(metres)


def length_option(metres: Fraction, unit: Fraction) -> str:
    """A length as a value on the command line: ``2``, or ``3ft`` where the unit of the CRS is the foot."""
    if short_unit(unit) != "ft":
        return f"{float(metres):g}"
    return f"{float(metres / unit):g}{written_unit(unit)}"


def area_text(square_metres: float, unit: float | Fraction) -> str:
    """An area: ``0.25 km2``; on a CRS in feet ``62 acres``, or square miles where it is larger."""
    if short_unit(unit) != "ft":
        return f"{square_metres / SQUARE_KM:,.3g} km2"
    acres = square_metres / ACRE
    return (
        f"{acres:,.3g} acres"
        if acres < ACRES_PER_SQUARE_MILE
        else f"{acres / ACRES_PER_SQUARE_MILE:,.3g} sq mi"
    )


def small_area_text(square_metres: float, unit: float | Fraction) -> str:
    """An area of some pixels: ``9,200 m2``, or ``99,000 ft2``."""
    name = short_unit(unit)
    return f"{square_metres / float(unit) ** 2:,.0f} ft2" if name == "ft" else f"{square_metres:,.0f} m2"


def length_text(metres: float | Fraction, unit: float | Fraction) -> str:
    """A length: ``2 m``; on a CRS in feet ``3 ft``, or ``3.28 ft (1 m)`` where that is no round number of feet.

    Parameters
    ----------
    metres : number
    unit : number
        Metres of a unit of the CRS.
    """
    name = short_unit(unit)
    if name == "m":
        return f"{float(metres):.6g} m"
    number = float(metres) / float(unit)
    nearest = round(number, 2 if number < 10 else 1)
    if nearest and abs(number / nearest - 1) < ROUND:
        return f"{nearest:,g} {name}"
    text = f"{number:,.0f}" if number >= 100 else f"{number:.3g}"
    return f"{text} {name} ({float(metres):.6g} m)"


def in_unit_of_crs(text: str, units: Units) -> str:
    """Return a text whose lengths in metres (``0.12 m``) are in feet as well, if the CRS is: ``0.394 ft (0.12 m)``.

    The text stays as it is if heights have another unit than x and y, as a length may be one of either.
    """
    if short_unit(units.horizontal) != "ft" or units.vertical != units.horizontal:
        return text

    def length(found: re.Match[str]) -> str:
        lengths = [length_text(float(number), units.horizontal) for number in found.groups() if number]
        return " to ".join(lengths)

    return _METRES.sub(length, text)
