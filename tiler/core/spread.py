"""Mean, RMSE and percentiles of height differences, exactly or in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

STEP = 1e-4
"""Differences are counted in steps of this size, in units of the heights: a tenth of a millimetre in metres."""

MOST_STEPS = 2_000_000
"""Different values that a tally keeps apart; beyond, its step becomes ten times as large."""

NMAD_FACTOR = 1.4826
"""Makes the median absolute deviation an estimate of the standard deviation where errors are normal."""

NAMES = ("rmse", "bias", "median", "nmad", "p5", "p25", "p75", "p95", "p95_abs", "max_abs")

Float64s = npt.NDArray[np.float64]
Int64s = npt.NDArray[np.int64]


class SpreadTally:
    """Differences that come in pieces; memory is bounded by `MOST_STEPS`, however many there are.

    Mean and root mean square are those of the values as they come; medians and percentiles are of the values rounded
    to `step`.
    """

    def __init__(self) -> None:
        self.n = 0
        self.step = STEP
        self._sum = self._squares = self._largest = 0.0
        self._values: Int64s = np.empty(0, np.int64)
        self._counts: Int64s = np.empty(0, np.int64)

    def add(self, differences: Float64s) -> None:
        """Count finite differences, float64 of any shape, units of the heights."""
        if differences.size == 0:
            return
        self.n += differences.size
        self._sum += float(differences.sum())
        self._squares += float((differences**2).sum())
        self._largest = max(self._largest, float(np.abs(differences).max()))
        found, counts = np.unique(np.rint(differences / self.step).astype(np.int64), return_counts=True)
        self._merge(np.concatenate((self._values, found)), np.concatenate((self._counts, counts)))
        while self._values.size > MOST_STEPS:
            self.step *= 10
            self._merge(np.rint(self._values / 10).astype(np.int64), self._counts)

    def _merge(self, values: Int64s, counts: Int64s) -> None:
        self._values, at = np.unique(values, return_inverse=True)
        self._counts = np.bincount(at.ravel(), counts, self._values.size).astype(np.int64)

    def summary(self) -> dict[str, float | None]:
        """Number, mean, RMSE and percentiles, as `spread` gives them."""
        if self.n == 0:
            return dict.fromkeys(NAMES)
        moments = (self._squares / self.n, self._sum / self.n, self._largest)
        values = self._values.astype(np.float64) * self.step
        return _summary(values, self._counts, *moments)


def spread(differences: Float64s) -> dict[str, float | None]:
    """Describe differences that fit into memory.

    Parameters
    ----------
    differences : float64, any shape
        Finite, in units of the heights.

    Returns
    -------
    dict
        In the same unit: ``rmse``; ``bias`` (the mean); ``median``; ``nmad``, 1.4826 times the median absolute
        deviation from the median (Hoehle and Hoehle 2009, ISPRS J. 64, table 2); percentiles ``p5``, ``p25``,
        ``p75``, ``p95`` (linear between order statistics); ``p95_abs``, ``max_abs`` of the absolute values. All
        None without a value.
    """
    values = np.sort(np.asarray(differences, np.float64), axis=None)
    if values.size == 0:
        return dict.fromkeys(NAMES)
    counts = np.ones(values.size, np.int64)
    largest = float(np.abs(values).max())
    return _summary(values, counts, float(np.mean(values**2)), float(np.mean(values)), largest)


def _summary(values: Float64s, counts: Int64s, square: float, mean: float, largest: float) -> dict[str, Any]:
    """The figures of ascending values with their counts, mean square, mean and largest absolute value."""
    low, quarter, middle, three_quarters, high = quantiles(values, counts, (5, 25, 50, 75, 95))
    (deviation,) = _quantiles_of_absolute(values - middle, counts, (50,))
    (absolute,) = _quantiles_of_absolute(values, counts, (95,))
    figures = (
        np.sqrt(square),
        mean,
        middle,
        NMAD_FACTOR * deviation,
        low,
        quarter,
        three_quarters,
        high,
        absolute,
        largest,
    )
    return {name: float(value) for name, value in zip(NAMES, figures, strict=True)}


def _quantiles_of_absolute(values: Float64s, counts: Int64s, percents: Sequence[float]) -> list[float]:
    absolute = np.abs(values)
    order = np.argsort(absolute, kind="stable")
    return quantiles(absolute[order], counts[order], percents)


def quantiles(values: Float64s, counts: Int64s, percents: Sequence[float]) -> list[float]:
    """Percentiles of ascending values that occur so many times, linear between order statistics as numpy's."""
    ends = np.cumsum(counts)
    found = []
    for percent in percents:
        place = percent / 100 * (int(ends[-1]) - 1)
        below, above = (
            values[np.searchsorted(ends, int(rank), side="right")]
            for rank in (np.floor(place), np.ceil(place))
        )
        found.append(float(below + (above - below) * (place % 1.0)))
    return found
