"""Fill the empty cells of a raster of lowest heights from their neighbours (Chen 2023, 2.2 A)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32
from ptd.ground.morphology import EMPTY
from ptd.kernel import kernel

Int64 = npt.NDArray[np.int64]


@kernel
def _neighbours_of(heights: Int32, row: int, column: int, layers: Int32, k: int) -> tuple[Any, Any, Any]:
    """Sum, number and minimum of the 8-neighbours of layers before k."""
    total, n, lowest = np.int64(0), np.int64(0), np.int64(EMPTY)
    for r in range(max(row - 1, 0), min(row + 2, heights.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, heights.shape[1])):
            if 0 <= layers[r, c] < k:
                total += heights[r, c]
                n += 1
                lowest = min(lowest, np.int64(heights[r, c]))
    return total, n, lowest


@kernel
def _queue_around(layers: Int32, row: int, column: int, k: int, queue: Int64, n: int) -> int:
    """Put the empty 8-neighbours that wait in no queue yet into layer k; the new length of the queue."""
    for r in range(max(row - 1, 0), min(row + 2, layers.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, layers.shape[1])):
            if layers[r, c] < 0:
                layers[r, c] = k
                queue[n] = r * layers.shape[1] + c
                n += 1
    return n


@kernel
def _grow(heights: Int32, layers: Int32, queue: Int64, mean_layers: int, last: int) -> None:
    width = heights.shape[1]
    end = 0
    for row in range(heights.shape[0]):
        for column in range(width):
            if layers[row, column] == 0:
                end = _queue_around(layers, row, column, 1, queue, end)
    start = 0
    for k in range(1, last + 1):
        stop = end
        for i in range(start, stop):
            row, column = queue[i] // width, queue[i] % width
            total, n, lowest = _neighbours_of(heights, row, column, layers, k)
            heights[row, column] = total // n if k <= mean_layers else lowest
            if k < last:
                end = _queue_around(layers, row, column, k + 1, queue, end)
        start = stop


def fill_empty(heights: Int32, mean_layers: int, last: int) -> tuple[Int32, Int32]:
    """Fill empty cells layer by layer around the filled ones.

    In the first layers a cell takes the mean of its filled 8-neighbours (rounded down to a count), then the height of
    the nearest filled cell: nearest by the larger of the differences in row and column, of equally near ones
    the lowest. The paper gives what its interpolation does not reach the height 0, a pit that no opening closes.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Counts; `ptd.ground.morphology.EMPTY` where there is none.
    mean_layers : int
        So many layers are interpolated.
    last : int
        Farther from filled cells than this, cells stay empty.

    Returns
    -------
    filled : int32 [rows, columns]
    layers : int32 [rows, columns]
        How far a cell is from those that were filled, -1 where it is still empty. A cell's height depends on no cell
        farther from it than that.
    """
    filled = np.array(heights, np.int32, order="C")
    layers = np.where(filled == EMPTY, -1, 0).astype(np.int32)
    _grow(filled, layers, np.empty(int((layers < 0).sum()), np.int64), mean_layers, last)
    layers[filled == EMPTY] = -1
    return filled, layers
