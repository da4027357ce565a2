"""Means over boxes and slopes of rasters in which any cell may be empty."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64
from ptd.ground.morphology import EMPTY
from ptd.kernel import kernel

Float64 = npt.NDArray[np.float64]


@kernel
def _sums(values: Int32) -> tuple[Int64, Int64]:
    """Sums and numbers of all filled cells before row and column: int64 [rows + 1, columns + 1]."""
    height, width = values.shape
    sums = np.zeros((height + 1, width + 1), np.int64)
    counts = np.zeros((height + 1, width + 1), np.int64)
    for row in range(height):
        total, n = np.int64(0), np.int64(0)
        for column in range(width):
            if values[row, column] != EMPTY:
                total += values[row, column]
                n += 1
            sums[row + 1, column + 1] = sums[row, column + 1] + total
            counts[row + 1, column + 1] = counts[row, column + 1] + n
    return sums, counts


@kernel
def _box_means(values: Int32, reach: int) -> Float64:
    """Means of the cells up to `reach` from each cell, NaN where none is filled; `reach` cells wider on all sides."""
    height, width = values.shape
    sums, counts = _sums(values)
    means = np.empty((height + 2 * reach, width + 2 * reach), np.float64)
    for row in range(means.shape[0]):
        south, north = max(row - 2 * reach, 0), min(row + 1, height)
        if counts[north, width] == counts[south, width]:  # most rows, where points are sparse
            means[row] = np.nan
            continue
        for column in range(means.shape[1]):
            west, east = max(column - 2 * reach, 0), min(column + 1, width)
            n = counts[north, east] - counts[north, west] - counts[south, east] + counts[south, west]
            total = sums[north, east] - sums[north, west] - sums[south, east] + sums[south, west]
            means[row, column] = total / n if n > 0 else np.nan
    return means


@kernel
def _rise(before: float, own: float, after: float) -> float:
    """The steeper of the rises from one neighbour and to the other; one that is missing (NaN) has none."""
    first = 0.0 if math.isnan(before) else abs(own - before)
    last = 0.0 if math.isnan(after) else abs(after - own)
    return max(first, last)


@kernel
def _slopes(means: Float64, reach: int, out: Float64) -> None:
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            r, c = row + reach, column + reach
            own = means[r, c]
            if math.isnan(own):
                out[row, column] = 0.0
                continue
            right = _rise(means[r, c - reach], own, means[r, c + reach])
            up = _rise(means[r - reach, c], own, means[r + reach, c])
            out[row, column] = math.sqrt(right * right + up * up) / reach


def box_means(values: Int32, reach: int) -> Float64:
    """Means of the filled cells up to `reach` from each cell, in both directions.

    Parameters
    ----------
    values : int32 [rows, columns]
        `EMPTY` where there is none.
    reach : int
        Cells, at least 1.

    Returns
    -------
    float64 [rows, columns]
        NaN where no cell of the box is filled; the sums are whole numbers, so they are exact.
    """
    return _box_means(np.ascontiguousarray(values), reach)[reach:-reach, reach:-reach]


def slopes(heights: Int32, reach: int) -> Float64:
    """Slope of a surface with empty cells, from the means of square boxes.

    The means are of the filled cells up to `reach` cells (in both directions) from the cell and from those `reach` to
    the east, west, north and south; the sums are whole numbers, so they are exact. Along each axis the steeper of the
    two sides counts: at the edge of a terrace or the foot of a slope a mean of both would hide it.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Counts; `EMPTY` where there is none.
    reach : int
        Cells, at least 1.

    Returns
    -------
    float64 [rows, columns]
        Rise in counts per cell; 0 where the cell's own box is empty.
    """
    out = np.empty(heights.shape, np.float64)
    _slopes(_box_means(np.ascontiguousarray(heights), reach), reach, out)
    return out
