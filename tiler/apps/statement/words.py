"""Text of a statement."""

from __future__ import annotations

import math

from tiler.apps.statement.rising import OPENING_M
from tiler.apps.statement.sample import Sample, draws_needed
from tiler.core.units import area_text, length_text, small_area_text
from tiler.core.words import counted

OBJECT_M = 1.0
"""Least height of the objects of a statement."""


def rounded_up(number: float) -> int:
    """Return a number rounded up to two digits."""
    step = 10 ** max(math.floor(math.log10(number)) - 1, 0) if number > 0 else 1
    return math.ceil(number / step) * step


def statement_text(
    sample: Sample | None, pixels: int, rising: int, pixel_m2: float, units: tuple[float, float]
) -> str:
    """Return the sentence on the objects left in a terrain.

    Parameters
    ----------
    sample : Sample or None
        None if no pixel rises.
    pixels, rising : int
        Numbers of pixels with a height, and of those that rise.
    pixel_m2 : float
        Area of a pixel in square metres.
    units : (float, float)
        Metres in a unit of the coordinates, and in one of the heights.
    """
    wide, high = units
    objects = (
        f"objects that rise by {length_text(OBJECT_M, high)} or more, "
        f"up to {length_text(OPENING_M, wide)} wide, are left"
    )
    land = f"{area_text(pixels * pixel_m2, wide)} of terrain"
    if sample is None:
        return f"no square to look at: none of {land} rises above the land around"
    rises = f"{small_area_text(rising * pixel_m2, wide)} rises above the land around"
    later = f"; {counted(sample.waiting, 'later answer')} will count once all squares before are answered"
    if not sample.shares:
        begin = f"no answer counts yet: of {land}, {rises}; "
        return begin + _needed(sample, rising * pixel_m2, wide) + later * bool(sample.waiting)
    bound = small_area_text(rounded_up(sample.max_pixels * pixel_m2 / wide**2) * wide**2, wide)
    if sample.seen == sample.squares:
        basis = f"as every square that rises was looked at ({sample.squares:,})"
    else:
        with_objects = sum(share > 0 for share in sample.shares)
        number = counted(len(sample.shares), "random draw")
        basis = f"95 % sure ({number}, {with_objects:,} with objects)"
    text = f"at most {bound} of {objects} in {land}, of which {rises}, {basis}"
    return text + later * bool(sample.waiting)


def _needed(sample: Sample, rising_m2: float, wide: float) -> str:
    """Return how many squares without an object give round bounds."""
    rising = rising_m2 / wide**2
    power = math.ceil(math.log10(rising)) - 1
    bounds = []
    for bound in (10**power, 10 ** (power - 1)):
        needed = draws_needed(bound / rising)
        if bound >= 1 and needed < sample.squares:
            bounds.append(f"{needed:,} for at most {small_area_text(bound * wide**2, wide)}")
    if not bounds:
        return f"look at {'the square' if sample.squares == 1 else f'all {sample.squares:,} squares'}"
    return f"draws without an object that are needed, 95 % sure: {', '.join(bounds)}"
