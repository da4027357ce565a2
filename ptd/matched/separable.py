"""Hull of paraboloids around every cell, computed by rows of blocks.

The fall of a paraboloid is the sum of a fall along the row and one along the column. So the
cells that limit paraboloids are found along rows first and then across them, and the hull is
raised across rows first and then along them. For ``w`` cells across this takes about ``2 * w``
steps instead of ``w * w``, each for a whole row of centres. It is faster if every cell is a
centre. With few centres far apart `ptd.matched.hull` computes each separately.
"""

from __future__ import annotations

import numpy as np

from ptd.cells import Int32, Int64
from ptd.kernel import kernel

HIGH, LOW = 2**30 + 2**29, -(2**30) - 2**29
"""Height of a missing cell, and of a missing paraboloid. They stay beyond real heights (less
than 1,000 km) after any fall or tilt is added."""
LIMIT = 2**30
"""Limit of real heights: values from `LIMIT` on, or down from `-LIMIT`, stand for none."""


@kernel
def _keep_lowest(lowest: Int32, values: Int32, first: int) -> None:
    """Insert one value per column into its sorted list of lowest values. Row 0 has the lowest.

    The rows before ``first`` must not be higher than the values. ``values`` is changed.
    """
    for k in range(first, lowest.shape[0]):
        row = lowest[k]
        for c in range(values.size):
            low = min(row[c], values[c])
            values[c] = max(row[c], values[c])
            row[c] = low


@kernel
def _tilted(out: Int32, values: Int32, fall: int, tilt: Int32, step: int) -> None:
    """Write to ``out`` values plus the fall of a paraboloid ``step`` cells from its centre, minus its block's tilt."""
    more, steps = np.int32(fall), np.int32(step)
    for c in range(out.size):
        out[c] = np.int32(values[c] + more) - np.int32(tilt[c] * steps)


@kernel
def _raise(highest: Int32, values: Int32) -> None:
    for c in range(values.size):
        highest[c] = max(highest[c], values[c])


@kernel
def _tops(
    padded: Int32, falls: Int64, cut: int, n_rows: int, north: Int32, east: Int32
) -> Int32:
    """Return the top of the paraboloid around each cell of some rows that cuts through ``cut`` cells.

    Tops from LIMIT on stand for no paraboloid.
    """
    radius, columns = falls.size - 1, north.size
    along = np.full((n_rows + 2 * radius, cut + 1, columns), HIGH, np.int32)
    values = np.empty(columns, np.int32)
    for row in range(along.shape[0]):
        for step in range(-radius, radius + 1):
            _tilted(
                values,
                padded[row, radius + step : radius + step + columns],
                falls[abs(step)],
                east,
                step,
            )
            _keep_lowest(along[row], values, 0)
    tops = np.empty((n_rows, columns), np.int32)
    for row in range(n_rows):
        lowest = np.full((cut + 1, columns), HIGH, np.int32)
        for step in range(-radius, radius + 1):
            for k in range(cut + 1):
                _tilted(values, along[row + radius + step, k], falls[abs(step)], north, step)
                _keep_lowest(lowest, values, k)
        tops[row] = lowest[cut]
    return tops


@kernel
def _spread(hull: Int32, tops: Int32, falls: Int64, north: Int32, east: Int32) -> None:
    """Raise a hull (with a margin of the radius all around) to the paraboloids around the cells of some rows."""
    radius, (n_rows, columns) = falls.size - 1, tops.shape
    values, across = np.empty(columns, np.int32), np.empty(columns, np.int32)
    for row in range(n_rows + 2 * radius):
        across[:] = LOW
        for centre in range(max(row - 2 * radius, 0), min(row + 1, n_rows)):
            step = centre + radius - row
            _tilted(values, tops[centre], -falls[abs(step)], north, step)
            _raise(across, values)
        for step in range(-radius, radius + 1):
            _tilted(values, across, -falls[abs(step)], east, -step)
            _raise(hull[row, radius + step : radius + step + columns], values)


@kernel
def hull_around_every_cell(
    heights: Int32,
    empty: int,
    none: int,
    falls: Int64,
    cut: int,
    block: int,
    north: Int64,
    east: Int64,
) -> Int32:
    """Return the height of the highest paraboloid over each cell.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights in vertical counts; ``empty`` where there is no cell.
    empty, none : int
        Height of an empty cell, and height of the hull where there is no paraboloid.
    falls : int64 [radius + 1]
        Fall of a paraboloid in vertical counts, by cells from its centre along a row.
    cut : int
        Number of cells that a paraboloid may cut through.
    block : int
        Side in cells of the blocks, each of which has one tilt.
    north, east : int64 [blocks of rows, blocks of columns]
        Tilts of the blocks in vertical counts per cell.

    Returns
    -------
    int32 [rows, columns]
        Heights of the hull in vertical counts.
    """
    (rows, columns), radius = heights.shape, falls.size - 1
    padded = np.full((rows + 2 * radius, columns + 2 * radius), HIGH, np.int32)
    hull = np.full(padded.shape, LOW, np.int32)
    for r in range(rows):
        for c in range(columns):
            if heights[r, c] != empty:
                padded[r + radius, c + radius] = heights[r, c]
    for first in range(0, rows, block):
        block_heights = heights[first : first + block]
        west, end = columns, 0
        for r in range(block_heights.shape[0]):
            for c in range(columns):
                if block_heights[r, c] != empty:
                    west, end = min(west, c), max(end, c + 1)
        if west >= end:
            continue
        block_heights = block_heights[:, west:end]
        n, e = np.empty(end - west, np.int32), np.empty(end - west, np.int32)
        for c in range(west, end):
            n[c - west], e[c - west] = (
                north[first // block, c // block],
                east[first // block, c // block],
            )
        south, north_end, east_end = (
            first,
            first + block_heights.shape[0] + 2 * radius,
            end + 2 * radius,
        )
        tops = _tops(
            padded[south:north_end, west:east_end], falls, cut, block_heights.shape[0], n, e
        )
        for r in range(block_heights.shape[0]):
            for c in range(end - west):
                if block_heights[r, c] == empty or tops[r, c] >= LIMIT:
                    tops[r, c] = LOW
        _spread(hull[south:north_end, west:east_end], tops, falls, n, e)
    hull_heights = np.empty((rows, columns), np.int32)
    for r in range(rows):
        for c in range(columns):
            height = hull[r + radius, c + radius]
            hull_heights[r, c] = height if height > -LIMIT else none
    return hull_heights
