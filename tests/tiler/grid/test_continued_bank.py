"""Planes through the nearest cells of the bank: exact on planes, undefined on rows, the same in any window."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.grid.water_plants import continued_bank

FAR = 100.0


def test_a_plane_is_continued_exactly() -> None:
    bank = np.argwhere(np.indices((8, 8))[1] > 3)
    above = 0.5 + 0.3 * bank[:, 0] + 0.4 * bank[:, 1]
    height, slope = continued_bank(np.array([[4, 0], [0, 2]]), bank, above, FAR)
    np.testing.assert_allclose(height, [1.7, 1.3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(slope, 0.5, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "bank",
    [[], [[0, 5]], [[0, 5], [1, 5]], [[r, 4] for r in range(20)], [[r, r] for r in range(20)]],
)
def test_a_row_of_cells_defines_no_plane(bank: list[list[int]]) -> None:
    cells = np.array(bank, np.int64).reshape(-1, 2)
    height, slope = continued_bank(np.array([[0, 0], [3, 9]]), cells, np.ones(len(cells)), FAR)
    assert np.isinf(height).all()
    assert np.isinf(slope).all()


def test_cells_beyond_the_reach_are_not_used() -> None:
    bank = np.argwhere(np.ones((4, 4), np.bool_))
    height, _ = continued_bank(np.array([[0, 9], [0, 30]]), bank, np.ones(len(bank)), 10.0)
    assert height.tolist() == [1.0, np.inf]


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.02, 1.0), more=st.integers(0, 40))
def test_the_result_is_the_same_to_the_bit_in_a_larger_window(
    seed: int, share: float, more: int
) -> None:
    rng, reach = np.random.default_rng(seed), 12.0
    whole = rng.random((60 + more, 60)) < share
    above = rng.normal(size=whole.shape)
    cells = rng.integers(12, 28, (30, 2))
    part = whole[:41, :41]
    small = continued_bank(cells, np.argwhere(part), above[:41, :41][part], reach)
    large = continued_bank(cells, np.argwhere(whole), above[whole], reach)
    assert np.array_equal(small, large)
