"""Slopes of a raster that may have empty cells: means of boxes at selected cells, and planes through cells.

Planes are fitted by least squares from sums of whole numbers, which do not depend on the order of the points.
"""

from __future__ import annotations

import math

import numpy as np

from ptd.arrays import Float64, Int32, Int64
from ptd.ground.morphology import EMPTY
from ptd.kernel import kernel


@kernel
def _sums(values: Int32) -> Int64:
    """Return sum and number of the filled cells before each row and column: int64 [rows + 1, columns + 1, 2]."""
    height, width = values.shape
    sums = np.zeros((height + 1, width + 1, 2), np.int64)
    for row in range(height):
        total, n = np.int64(0), np.int64(0)
        for column in range(width):
            if values[row, column] != EMPTY:
                total += values[row, column]
                n += 1
            sums[row + 1, column + 1, 0] = sums[row, column + 1, 0] + total
            sums[row + 1, column + 1, 1] = sums[row, column + 1, 1] + n
    return sums


@kernel
def _box(sums: Int64, row: int, column: int, reach: int) -> tuple[int, int]:
    """Return sum and number of the filled cells up to `reach` from a cell, which may lie beyond the raster."""
    height, width = sums.shape[0] - 1, sums.shape[1] - 1
    south, north = min(max(row - reach, 0), height), max(min(row + reach + 1, height), 0)
    west, east = min(max(column - reach, 0), width), max(min(column + reach + 1, width), 0)
    a, b, c, d = sums[north, east], sums[north, west], sums[south, east], sums[south, west]
    return a[0] - b[0] - c[0] + d[0], a[1] - b[1] - c[1] + d[1]


@kernel
def _mean(sums: Int64, row: int, column: int, reach: int) -> float:
    """Return the mean of the filled cells up to `reach` from a cell, or NaN if there are none."""
    total, n = _box(sums, row, column, reach)
    return total / n if n > 0 else math.nan


@kernel
def _totals(sums: Int64, reach: int, cells: Int64, out: Int64) -> None:
    for i in range(cells.size):
        row, column = divmod(cells[i], sums.shape[1] - 1)
        out[i] = _box(sums, row, column, reach)


@kernel
def _means(sums: Int64, reach: int, cells: Int64, out: Float64) -> None:
    for i in range(cells.size):
        row, column = divmod(cells[i], sums.shape[1] - 1)
        out[i] = _mean(sums, row, column, reach)


@kernel
def _rise(before: float, own: float, after: float) -> float:
    """Return the larger of the rises from one neighbour and to the other. A missing neighbour (NaN) has no rise."""
    first = 0.0 if math.isnan(before) else abs(own - before)
    last = 0.0 if math.isnan(after) else abs(after - own)
    return max(first, last)


@kernel
def _slopes(sums: Int64, reach: int, cells: Int64, out: Float64) -> None:
    for i in range(cells.size):
        row, column = divmod(cells[i], sums.shape[1] - 1)
        centre = _mean(sums, row, column, reach)
        if math.isnan(centre):
            out[i] = 0.0
            continue
        west, east = (
            _mean(sums, row, column - reach, reach),
            _mean(sums, row, column + reach, reach),
        )
        south, north = (
            _mean(sums, row - reach, column, reach),
            _mean(sums, row + reach, column, reach),
        )
        right, up = _rise(west, centre, east), _rise(south, centre, north)
        out[i] = math.sqrt(right * right + up * up) / reach


class Boxes:
    """Sums over square boxes of a raster. They are whole numbers, so they are exact.

    Parameters
    ----------
    values : int32 [rows, columns]
        Values of cells; `EMPTY` where there is none.
    """

    def __init__(self, values: Int32) -> None:
        self._sums = _sums(np.ascontiguousarray(values))

    def totals(self, reach: int, cells: Int64) -> Int64:
        """Return sum and number of the filled cells up to `reach` from some cells: int64 [n, 2].

        `means` describes the parameters.
        """
        out = np.empty((cells.size, 2), np.int64)
        _totals(self._sums, reach, cells, out)
        return out

    def means(self, reach: int, cells: Int64) -> Float64:
        """Return the means of the filled cells up to `reach` from some cells, in both directions.

        Parameters
        ----------
        reach : int
            Distance in cells, at least 1.
        cells : int64 [n]
            Indices of the cells: row times columns plus column.

        Returns
        -------
        float64 [n]
            Means; NaN where no cell of the box is filled.
        """
        out = np.empty(cells.size, np.float64)
        _means(self._sums, reach, cells, out)
        return out

    def slopes(self, reach: int, cells: Int64) -> Float64:
        """Return the slope at some cells of a surface that may have empty cells, from the means of boxes.

        There are five boxes of half width `reach`: around the cell, and around the cells that
        lie `reach` cells to the east, west, north and south of it. Along each axis the steeper
        of the two sides counts. At the edge of a terrace or the foot of a slope, a mean of both
        would hide the slope.

        Parameters
        ----------
        reach, cells
            Parameters of `means`.

        Returns
        -------
        float64 [n]
            Rise in counts per cell; 0 where the cell's own box is empty.
        """
        out = np.empty(cells.size, np.float64)
        _slopes(self._sums, reach, cells, out)
        return out


MOMENTS = 10
"""Number of moments: n, x, y, z, xx, xy, yy, xz, yz, zz."""


@kernel
def add_point(sums: Int64, x: int, y: int, z: int) -> None:
    """Add a point, in counts from some origin, to moments."""
    moments = (1, x, y, z, x * x, x * y, y * y, x * z, y * z, z * z)
    for m in range(MOMENTS):
        sums[m] += moments[m]


@kernel
def fit_plane(s: Int64, z_ratio: float) -> tuple[float, float, float, float]:
    """Fit the plane ``z = c + a x + b y`` in horizontal counts to moments by least squares.

    Returns a, b, c and the sum of squared residuals, which is -1 if the points lie on a line.
    """
    n = float(s[0])
    mx, my, mz = s[1] / n, s[2] / n, s[3] / n
    xx, xy, yy = s[4] - n * mx * mx, s[5] - n * mx * my, s[6] - n * my * my
    xz, yz, zz = (
        (s[7] - n * mx * mz) * z_ratio,
        (s[8] - n * my * mz) * z_ratio,
        s[9] - n * mz * mz,
    )
    det = xx * yy - xy * xy
    if det <= 1e-6 * xx * yy:
        return 0.0, 0.0, 0.0, -1.0
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    return (
        a,
        b,
        mz * z_ratio - a * mx - b * my,
        max(zz * z_ratio * z_ratio - a * xz - b * yz, 0.0),
    )
