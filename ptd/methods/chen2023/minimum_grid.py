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
def _neighbours_of(
    heights: Int32, row: int, column: int, layers: Int32, k: int
) -> tuple[Any, Any, Any]:
    """Sum, number and minimum of the 8-neighbours in layers before k."""
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
    """Put empty 8-neighbours that are not queued yet into layer k, and return the new length of the queue."""
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
            heights[row, column] = lowest
            if k <= mean_layers:
                heights[row, column] = total // n
            if k < last:
                end = _queue_around(layers, row, column, k + 1, queue, end)
        start = stop


def fill_empty(heights: Int32, mean_layers: int, last: int) -> tuple[Int32, Int32]:
    """Fill empty cells layer by layer around the filled ones.

    In the first layers a cell takes the mean of its filled 8-neighbours, rounded down to a
    count. In later layers it takes the height of the nearest filled cell. Distance is the
    larger of the differences in row and column; among equally near cells the lowest counts. The
    paper gives cells beyond its interpolation the height 0, a pit that no opening closes.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Counts; `ptd.ground.morphology.EMPTY` where there is none.
    mean_layers : int
        Number of layers that are interpolated.
    last : int
        Number of layers that are filled. Cells farther from filled ones stay empty.

    Returns
    -------
    filled : int32 [rows, columns]
    layers : int32 [rows, columns]
        Distance of a cell from the cells that had heights, -1 where it is still empty. The height of a cell depends on
        no cell farther away than this.
    """
    filled = np.array(heights, np.int32, order="C")
    layers = np.where(filled == EMPTY, -1, 0).astype(np.int32)
    _grow(filled, layers, np.empty(int((layers < 0).sum()), np.int64), mean_layers, last)
    layers[filled == EMPTY] = -1
    return filled, layers
