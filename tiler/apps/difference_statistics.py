"""Mean, RMSE and percentiles of height differences, exact or estimated in bounded memory, and sums per cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict, TypeVar

import numpy as np
import numpy.typing as npt

from ptd.arrays import Float64, Int64

STEP = 1e-4
"""Step to which a tally rounds differences, in units of the heights: a tenth of a millimetre in
metres."""

MAX_STEPS = 2_000_000
"""Maximum number of different values in a tally. If there are more, its step becomes ten times
as large."""

NMAD_FACTOR = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of normally distributed
errors."""


class Spread(TypedDict):
    """Statistics of differences in their unit, all None if there are no differences.

    ``bias`` is the mean. ``nmad`` is 1.4826 times the median absolute deviation from the median (Hoehle and Hoehle
    2009, ISPRS J. 64, table 2). ``p5`` to ``p95`` are percentiles, linear between order statistics. ``p95_abs`` is the
    95th percentile of the absolute values, and ``max_abs`` the largest one.
    """

    rmse: float | None
    bias: float | None
    median: float | None
    nmad: float | None
    p5: float | None
    p25: float | None
    p75: float | None
    p95: float | None
    p95_abs: float | None
    max_abs: float | None


_NO_SPREAD = Spread(
    rmse=None, bias=None, median=None, nmad=None, p5=None, p25=None, p75=None, p95=None, p95_abs=None, max_abs=None
)  # fmt: skip
"""Statistics of no differences."""


class SpreadTally:
    """Counter of differences that arrive in pieces. `MAX_STEPS` limits its memory.

    Mean and root mean square use the unrounded values. Medians and percentiles use the values
    rounded to `step`.
    """

    def __init__(self) -> None:
        self.n = 0
        self.step = STEP
        self._sum = 0.0
        self._squares = 0.0
        self._largest = 0.0
        self._values: Int64 = np.empty(0, np.int64)
        self._counts: Int64 = np.empty(0, np.int64)

    def add(self, differences: Float64) -> None:
        """Count finite differences, float64 of any shape, in units of the heights."""
        if differences.size == 0:
            return
        self.n += differences.size
        self._sum += float(differences.sum())
        self._squares += float((differences**2).sum())
        self._largest = max(self._largest, float(np.abs(differences).max()))
        steps, counts = np.unique(
            np.rint(differences / self.step).astype(np.int64), return_counts=True
        )
        self._merge(
            np.concatenate((self._values, steps)), np.concatenate((self._counts, counts))
        )
        while self._values.size > MAX_STEPS:
            self.step *= 10
            self._merge(np.rint(self._values / 10).astype(np.int64), self._counts)

    def _merge(self, values: Int64, counts: Int64) -> None:
        self._values, at = np.unique(values, return_inverse=True)
        self._counts = np.bincount(at.ravel(), counts, self._values.size).astype(np.int64)

    def summary(self) -> Spread:
        """Return the same figures as `spread`."""
        if self.n == 0:
            return _NO_SPREAD.copy()
        values = self._values.astype(np.float64) * self.step
        return _summary(
            values, self._counts, self._squares / self.n, self._sum / self.n, self._largest
        )


def spread(differences: Float64) -> Spread:
    """Compute statistics of finite differences, float64 of any shape, that fit into memory."""
    values = np.sort(np.asarray(differences, np.float64), axis=None)
    if values.size == 0:
        return _NO_SPREAD.copy()
    counts = np.ones(values.size, np.int64)
    largest = float(np.abs(values).max())
    return _summary(values, counts, float(np.mean(values**2)), float(np.mean(values)), largest)


def _summary(
    values: Float64, counts: Int64, square: float, mean: float, largest: float
) -> Spread:
    """Return the statistics of ascending values that occur ``counts`` times each. ``square`` is their mean square."""
    p5, p25, median, p75, p95 = quantiles(values, counts, (5, 25, 50, 75, 95))
    return {
        "rmse": math.sqrt(square),
        "bias": mean,
        "median": median,
        "nmad": NMAD_FACTOR * _quantile_of_absolute(values - median, counts, 50),
        "p5": p5,
        "p25": p25,
        "p75": p75,
        "p95": p95,
        "p95_abs": _quantile_of_absolute(values, counts, 95),
        "max_abs": largest,
    }


def _quantile_of_absolute(values: Float64, counts: Int64, percent: float) -> float:
    absolute = np.abs(values)
    order = np.argsort(absolute, kind="stable")
    return quantiles(absolute[order], counts[order], (percent,))[0]


def quantiles(values: Float64, counts: Int64, percents: Sequence[float]) -> list[float]:
    """Return percentiles, linear between order statistics, of ascending values that occur ``counts`` times each."""
    ends = np.cumsum(counts)
    percentiles = []
    for percent in percents:
        rank = percent / 100 * (int(ends[-1]) - 1)
        below = values[np.searchsorted(ends, int(np.floor(rank)), side="right")]
        above = values[np.searchsorted(ends, int(np.ceil(rank)), side="right")]
        percentiles.append(float(below + (above - below) * (rank % 1.0)))
    return percentiles


Figure = TypeVar("Figure", np.int64, np.float64)


def summed(cells: Int64, sums: npt.NDArray[Figure]) -> tuple[Int64, npt.NDArray[Figure]]:
    """Return the distinct cells and the sums of their values.

    The cells are sorted by the last row of ``cells``, then by the row before it, and so on.

    Parameters
    ----------
    cells : int64, shape (k, n)
        Indices of the cell of each value, one row per axis.
    sums : array, shape (m, n)
        Values to add up per cell.
    """
    if cells.shape[1] == 0:
        return cells, sums
    order = np.lexsort(cells)
    cells = cells[:, order]
    first = np.flatnonzero(np.r_[True, np.any(cells[:, 1:] != cells[:, :-1], axis=0)])
    return cells[:, first], np.add.reduceat(sums[:, order], first, axis=1)
