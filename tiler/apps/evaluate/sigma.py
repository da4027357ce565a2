"""How well a raster of standard errors tells the errors of a DTM."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.gridding.shape import gradients, slope_deg
from tiler.apps.evaluate.labels import ratio

SLOPES_DEG = (0, 5, 15, 30, 90)
"""Edges of the classes of slope."""
PER_DECADE = 100
"""Classes of sigma in a factor of ten: the order within a class is not told."""
LOWEST, HIGHEST = -5.0, 4.0
"""Logarithms of the units of the heights between which the classes lie."""
LOOKED_AT = 0.1
"""A person looks at this share of the area."""

Float64s = npt.NDArray[np.float64]
N_CLASSES = round((HIGHEST - LOWEST) * PER_DECADE) + 1


class SigmaTally:
    """Counts of errors and of the standard errors at the same pixels, in bounded memory."""

    def __init__(self) -> None:
        self._within = np.zeros(3, np.int64)
        self._by_slope = np.zeros((len(SLOPES_DEG) - 1, 3))
        self._by_sigma = np.zeros((N_CLASSES, 2))
        self._by_error = np.zeros((N_CLASSES, 2))

    def add(self, difference: Float64s, sigma: Float64s, slope: Float64s) -> None:
        """Count pixels: differences and standard errors in units of the heights, slopes in degrees; shape (n,)."""
        squared, size = difference**2, np.abs(difference)
        for k in (1, 2, 3):
            self._within[k - 1] += np.count_nonzero(size <= k * sigma)
        classes = np.clip(np.searchsorted(SLOPES_DEG, slope, side="right") - 1, 0, len(SLOPES_DEG) - 2)
        for column, values in enumerate((np.ones_like(sigma), squared, sigma**2)):
            self._by_slope[:, column] += np.bincount(classes, values, len(SLOPES_DEG) - 1)
        for table, values in ((self._by_sigma, sigma), (self._by_error, size)):
            place = _classes(values)
            table[:, 0] += np.bincount(place, minlength=N_CLASSES)
            table[:, 1] += np.bincount(place, squared, N_CLASSES)

    def summary(self) -> dict[str, Any]:
        """What the counts say.

        Returns
        -------
        dict
            ``pixels``; ``within_1``, ``within_2``, ``within_3`` (share of errors within so many standard errors; of
            normally distributed ones 0.683, 0.954, 0.997); ``rmse`` and ``predicted_rmse`` (root mean square of errors
            and of standard errors); ``by_slope``: the same of each class ``from_deg`` to ``to_deg``; ``area``: the mean
            share of all squared errors that the largest standard errors hold, over all shares of the pixels (0.5: no
            better than chance), ``area_at_best`` if the pixels were in the order of their errors; ``in_first_tenth``:
            that share in a tenth of the pixels.
        """
        n, squared, predicted = self._by_slope.sum(axis=0)
        shares = {f"within_{k}": ratio(int(self._within[k - 1]), int(n)) for k in (1, 2, 3)}
        by_slope = [
            {"from_deg": low, "to_deg": high, **_figures(*row)}
            for low, high, row in zip(SLOPES_DEG, SLOPES_DEG[1:], self._by_slope.tolist(), strict=False)
        ]
        curve, best = _curve(self._by_sigma), _curve(self._by_error)
        return {
            **_figures(n, squared, predicted),
            **shares,
            "by_slope": by_slope,
            "area": _area(curve),
            "area_at_best": _area(best),
            "in_first_tenth": None if curve is None else float(np.interp(LOOKED_AT, *curve)),
        }


def slopes_of(truth: Float64s, step: float) -> Float64s:
    """Slopes of a block of heights, degrees; ``step``: side of a pixel in units of the heights."""
    return slope_deg(*gradients(np.pad(truth, 1, constant_values=np.nan), step))


def _classes(values: Float64s) -> npt.NDArray[np.int64]:
    logarithm = np.log10(np.maximum(values, 10.0**LOWEST))
    found: npt.NDArray[np.int64] = np.rint((np.minimum(logarithm, HIGHEST) - LOWEST) * PER_DECADE).astype(
        np.int64
    )
    return found


def _figures(n: float, squared: float, predicted: float) -> dict[str, Any]:
    if not n:
        return {"pixels": 0, "rmse": None, "predicted_rmse": None}
    return {"pixels": int(n), "rmse": sqrt(squared / n), "predicted_rmse": sqrt(predicted / n)}


def _curve(table: Float64s) -> tuple[Float64s, Float64s] | None:
    """Share of the pixels, largest first, and the share of the squared errors that they hold; None without errors."""
    if not table[:, 1].sum():
        return None
    found = np.cumsum(table[::-1], axis=0) / table.sum(axis=0)
    return np.append(0.0, found[:, 0]), np.append(0.0, found[:, 1])


def _area(curve: tuple[Float64s, Float64s] | None) -> float | None:
    if curve is None:
        return None
    x, y = curve
    return float(np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2))
