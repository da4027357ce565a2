"""Means of boxes and slopes: against their definition, on a plane, and what lies beyond reach."""

from __future__ import annotations

import numpy as np

from ptd.ground.morphology import EMPTY
from ptd.ground.slopes import Boxes


def rough(rows: int, columns: int, empty: float) -> np.ndarray:
    rng = np.random.default_rng(5)
    heights = rng.integers(-3000, 3000, (rows, columns)).astype(np.int32)
    heights[rng.random(heights.shape) < empty] = EMPTY
    return heights


def means(values: np.ndarray, reach: int) -> np.ndarray:
    return Boxes(values).means(reach, np.arange(values.size)).reshape(values.shape)


def slopes(values: np.ndarray, reach: int) -> np.ndarray:
    return Boxes(values).slopes(reach, np.arange(values.size)).reshape(values.shape)


def test_means_are_those_of_the_filled_cells_of_the_box() -> None:
    heights = rough(12, 15, 0.8)
    found = means(heights, 2)
    for row, column in np.ndindex(*heights.shape):
        box = heights[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        filled = box[box != EMPTY]
        np.testing.assert_equal(found[row, column], filled.mean() if filled.size else np.nan)


def test_slope_of_a_plane() -> None:
    row, column = np.mgrid[:60, :70]
    heights = (300 * row - 400 * column).astype(np.int32)
    heights[:, 30:32] = EMPTY
    found = slopes(heights, 3)
    np.testing.assert_allclose(found[6:-6, 6:20], 500.0)
    assert abs(found[heights != EMPTY] - 500.0).max() < 300.0
    assert (slopes(np.full((4, 5), EMPTY, np.int32), 3) == 0.0).all()


def test_neither_empty_rows_nor_data_beyond_reach_change_a_slope() -> None:
    whole, part, inner = rough(90, 100, 0.3), np.s_[20:76, 24:60], np.s_[12:-12, 12:-12]
    far, near = slopes(whole, 6), slopes(whole[part], 6)
    np.testing.assert_array_equal(near[inner], far[part][inner])
    np.testing.assert_array_equal(
        slopes(np.pad(whole, 7, constant_values=EMPTY), 6)[7:-7, 7:-7], far
    )
