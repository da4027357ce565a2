"""Comparison of a raster of standard errors with the actual errors of a DTM."""

from __future__ import annotations

from math import sqrt

import numpy as np
import numpy.typing as npt

from ptd.gridding.shape import gradients, slope_deg
from tiler.apps.evaluate.labels import ratio
from tiler.apps.evaluate.results import SigmaFigures, SigmaReport, SlopeFigures

SLOPES_DEG = (0, 5, 15, 30, 90)
"""Edges of the classes of slope, degrees."""
PER_DECADE = 100
"""Number of classes of standard errors and errors per factor of ten.

Values in a class are not ordered.
"""
LOWEST, HIGHEST = -5.0, 4.0
"""Decimal logarithms of the lowest and the highest class, in units of the heights."""
LOOKED_AT = 0.1
"""Share of the area that a person may inspect."""

Float64s = npt.NDArray[np.float64]
N_CLASSES = round((HIGHEST - LOWEST) * PER_DECADE) + 1


class SigmaTally:
    """Counter of errors and of the standard errors at the same pixels, in bounded memory."""

    def __init__(self) -> None:
        self._within = np.zeros(3, np.int64)
        self._by_slope = np.zeros((len(SLOPES_DEG) - 1, 3))
        self._by_sigma = np.zeros((N_CLASSES, 2))
        self._by_error = np.zeros((N_CLASSES, 2))

    def add(self, difference: Float64s, sigma: Float64s, slope: Float64s) -> None:
        """Count pixels by their errors, standard errors and slopes.

        Parameters
        ----------
        difference, sigma : float64, shape (n,)
            Errors and standard errors in units of the heights.
        slope : float64, shape (n,)
            Slopes in degrees.
        """
        squared, size = difference**2, np.abs(difference)
        for k in (1, 2, 3):
            self._within[k - 1] += np.count_nonzero(size <= k * sigma)
        classes = np.clip(
            np.searchsorted(SLOPES_DEG, slope, side="right") - 1, 0, len(SLOPES_DEG) - 2
        )
        for column, values in enumerate((np.ones_like(sigma), squared, sigma**2)):
            self._by_slope[:, column] += np.bincount(classes, values, len(SLOPES_DEG) - 1)
        for table, values in ((self._by_sigma, sigma), (self._by_error, size)):
            class_numbers = _classes(values)
            table[:, 0] += np.bincount(class_numbers, minlength=N_CLASSES)
            table[:, 1] += np.bincount(class_numbers, squared, N_CLASSES)

    def summary(self) -> SigmaReport:
        """Return the statistics of all counted pixels."""
        n, squared, predicted = self._by_slope.sum(axis=0)
        within_1, within_2, within_3 = (
            ratio(within, int(n)) for within in self._within.tolist()
        )
        by_slope: list[SlopeFigures] = [
            {"from_deg": low, "to_deg": high, **_figures(*row)}
            for low, high, row in zip(
                SLOPES_DEG, SLOPES_DEG[1:], self._by_slope.tolist(), strict=False
            )
        ]
        curve, best = _curve(self._by_sigma), _curve(self._by_error)
        return {
            **_figures(n, squared, predicted),
            "within_1": within_1,
            "within_2": within_2,
            "within_3": within_3,
            "by_slope": by_slope,
            "area": _area(curve),
            "area_at_best": _area(best),
            "in_first_tenth": None if curve is None else float(np.interp(LOOKED_AT, *curve)),
        }


def slopes_of(truth: Float64s, step: float) -> Float64s:
    """Return the slopes of a block of heights in degrees.

    ``step`` is the side of a pixel in units of the heights.
    """
    return slope_deg(*gradients(np.pad(truth, 1, constant_values=np.nan), step))


def _classes(values: Float64s) -> npt.NDArray[np.int64]:
    logarithm = np.log10(np.maximum(values, 10.0**LOWEST))
    class_numbers: npt.NDArray[np.int64] = np.rint(
        (np.minimum(logarithm, HIGHEST) - LOWEST) * PER_DECADE
    ).astype(np.int64)
    return class_numbers


def _figures(n: float, squared: float, predicted: float) -> SigmaFigures:
    if not n:
        return {"pixels": 0, "rmse": None, "predicted_rmse": None}
    return {"pixels": int(n), "rmse": sqrt(squared / n), "predicted_rmse": sqrt(predicted / n)}


def _curve(table: Float64s) -> tuple[Float64s, Float64s] | None:
    """Return shares of the pixels, largest value first, and their shares of the sum of squared errors.

    Return None if there are no errors.
    """
    if not table[:, 1].sum():
        return None
    shares = np.cumsum(table[::-1], axis=0) / table.sum(axis=0)
    return np.append(0.0, shares[:, 0]), np.append(0.0, shares[:, 1])


def _area(curve: tuple[Float64s, Float64s] | None) -> float | None:
    if curve is None:
        return None
    x, y = curve
    return float(np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2))
