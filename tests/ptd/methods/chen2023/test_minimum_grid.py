"""Empty cells of a minimum raster get means of their neighbours, then the nearest height, never 0."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.ground.morphology import EMPTY
from ptd.methods.chen2023.progressive_opening import fill_empty

E = EMPTY


def grid(*rows: list[int]) -> np.ndarray:
    return np.array(rows, np.int32)


def test_a_hole_takes_the_mean_of_its_eight_neighbours() -> None:
    """10 + 20 + 30 + 40 + 60 + 70 + 80 + 90 = 400."""
    filled, layers = fill_empty(grid([10, 20, 30], [40, E, 60], [70, 80, 90]), 1, 2)
    assert filled[1, 1] == 50
    assert layers.tolist() == [[0, 0, 0], [0, 1, 0], [0, 0, 0]]


def test_only_filled_neighbours_count() -> None:
    filled, _ = fill_empty(grid([10, E, E], [E, E, E], [E, E, 21]), 1, 1)
    assert filled[1, 1] == 15  # 15.5 rounded down to a count
    assert filled[0, 1] == 10
    assert filled[1, 2] == 21


def test_growing_outward_a_layer_uses_what_the_layers_before_filled() -> None:
    filled, layers = fill_empty(grid([0, 90, E, E, E]), 3, 3)
    assert filled.tolist() == [[0, 90, 90, 90, 90]]
    assert layers.tolist() == [[0, 0, 1, 2, 3]]
    # The cell of layer two touches two cells of layer one, 10 and (10 + 40) / 2 = 25; that of
    # layer three only the second.
    filled, _ = fill_empty(grid([10, E, E, E], [40, E, E, E]), 3, 3)
    assert filled[:, 1].tolist() == [25, 25]
    filled, _ = fill_empty(grid([10, E, E], [E, E, E], [E, E, E], [70, E, E]), 3, 3)
    assert filled[:, 1].tolist() == [10, 10, 70, 70]
    assert filled[:, 2].tolist() == [10, 30, 50, 70]


def test_cells_of_one_layer_do_not_see_each_other() -> None:
    """Both middle cells see only the end beside them."""
    filled, _ = fill_empty(grid([0, E, E, 90]), 1, 1)
    assert filled.tolist() == [[0, 0, 90, 90]]


def test_remaining_cells_take_the_nearest_height_not_0() -> None:
    row = [500, E, E, E, E, E, E, 800]
    filled, _ = fill_empty(grid(row), 0, 9)
    assert filled.tolist() == [[500, 500, 500, 500, 800, 800, 800, 800]]
    filled, layers = fill_empty(grid([*row, E]), 1, 2)
    assert filled.tolist() == [[500, 500, 500, E, E, 800, 800, 800, 800]]
    assert layers.tolist() == [[0, 1, 2, -1, -1, 2, 1, 0, 1]]


def test_the_lowest_of_equally_near_cells_counts() -> None:
    filled, _ = fill_empty(grid([7, E, 3]), 0, 4)
    assert filled.tolist() == [[7, 3, 3]]


def test_nothing_to_fill_and_nothing_to_fill_from() -> None:
    full = grid([1, 2], [3, 4])
    assert np.array_equal(fill_empty(full, 3, 3)[0], full)
    filled, layers = fill_empty(grid([E, E]), 3, 3)
    assert filled.tolist() == [[E, E]]
    assert layers.tolist() == [[-1, -1]]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), last=st.integers(1, 6))
def test_nearest_by_the_larger_difference_of_row_and_column(seed: int, last: int) -> None:
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((9, 11)) < 0.06, rng.integers(-5, 5, (9, 11)), E).astype(
        np.int32
    )
    rows, columns = np.nonzero(heights != E)
    want, layers = np.full(heights.shape, E), np.full(heights.shape, -1)
    for r, c in np.ndindex(heights.shape):
        far = np.maximum(abs(rows - r), abs(columns - c))
        if far.size and far.min() <= last:
            layers[r, c] = far.min()
            want[r, c] = heights[rows, columns][far == far.min()].min()
    got = fill_empty(heights, 0, last)
    assert np.array_equal(got[0], want)
    assert np.array_equal(got[1], layers)
