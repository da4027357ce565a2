"""Conversion of a source's integers to absolute counts of 1/1000 unit.

It is exact for decimal scales and offsets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np

from ptd.arrays import Bool, Int64, Integer
from tiler.core.lattice import COUNTS_PER_UNIT, INT32_LIMIT, Bounds

_SAFE = 2**62
BEYOND = 2**53
"""Absolute counts at and above which a coordinate is not usable: 9e12 units."""


@dataclass(frozen=True)
class AxisCounts:
    """Coordinates of one axis in absolute counts.

    Attributes
    ----------
    counts : int64, shape (n,)
        ``round(coordinate * 1000)``; 0 if the coordinate is not `usable`.
    usable : bool, shape (n,)
        Whether the coordinate is finite and smaller than `BEYOND`.
    largest_rounding : float
        Largest distance of a count from the source's coordinate, in units of the CRS.
    """

    counts: Int64
    usable: Bool
    largest_rounding: float


@cache
def decimal_terms(scale: float, offset: float) -> tuple[int, int, int] | None:
    """Return integers ``(a, c, d)`` such that a record's integer X is ``(X*a + c) / d`` counts.

    The doubles of the header are taken as the decimal numbers that they print as, for example
    0.01 as 1/100. The result is None if some int32 X would overflow int64, for example with
    scales of seventeen digits.
    """
    a = Fraction(repr(float(scale))) * COUNTS_PER_UNIT
    c = Fraction(repr(float(offset))) * COUNTS_PER_UNIT
    d = math.lcm(a.denominator, c.denominator)
    whole_a, whole_c = int(a * d), int(c * d)
    if 2 * (2**31 * abs(whole_a) + abs(whole_c)) + d >= _SAFE:
        return None
    return whole_a, whole_c, d


def to_counts(values: Integer, scale: float, offset: float) -> AxisCounts:
    """Convert the coordinates of one axis to absolute counts.

    Parameters
    ----------
    values : int32, shape (n,)
        Integers of the records.
    scale, offset : float
        Scale and offset in the source's header.

    Notes
    -----
    The counts are ``floor((2(Xa + c) + d) / 2d)`` in int64 (halves are rounded up) if `decimal_terms` finds a, c, d,
    else ``rint`` in float64. Both are monotonic in X and do not depend on the origin of the frame.
    """
    terms = decimal_terms(scale, offset)
    if terms is None:
        return _in_floats(values, scale, offset)
    a, c, d = terms
    exact = values.astype(np.int64)
    exact *= a
    exact += c
    counts = exact if d == 1 else (2 * exact + d) // (2 * d)
    largest = 0.0
    if d != 1 and counts.size:
        largest = int(np.abs(exact - counts * d).max()) / d / COUNTS_PER_UNIT
    usable = np.abs(counts) < BEYOND
    if not usable.all():
        counts = np.where(usable, counts, 0)
    return AxisCounts(counts, usable, largest)


def _in_floats(values: Integer, scale: float, offset: float) -> AxisCounts:
    with np.errstate(over="ignore", invalid="ignore"):
        exact = (values.astype(np.float64) * scale + offset) * COUNTS_PER_UNIT
        usable = np.isfinite(exact) & (np.abs(exact) < BEYOND)
    exact = np.where(usable, exact, 0.0)
    counts = np.rint(exact)
    largest = float(np.abs(exact - counts).max()) / COUNTS_PER_UNIT if counts.size else 0.0
    return AxisCounts(counts.astype(np.int64), usable, largest)


def fits_int32(local: Int64) -> Bool:
    """Return a mask of the local counts that fit into int32, without the lowest int32."""
    return np.abs(local) <= INT32_LIMIT


def bounds_in_counts(bounds: tuple[float, float, float, float]) -> Bounds:
    """Convert bounds X0 Y0 X1 Y1 in units of the CRS to half-open bounds in absolute counts."""
    return Bounds(*(math.ceil(Fraction(repr(float(v))) * COUNTS_PER_UNIT) for v in bounds))
