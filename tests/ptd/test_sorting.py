"""Sorting inside kernels gives the order of numpy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ptd.sorting import sort, sort_by

NUMBERS = st.lists(st.integers(-(2**31), 2**31 - 1) | st.integers(-3, 3), max_size=60)


@given(NUMBERS)
def test_sort_is_that_of_numpy(numbers: list[int]) -> None:
    values = np.array(numbers, np.float64)
    expected = np.sort(values)
    sort(values)
    assert values.tolist() == expected.tolist()


@given(NUMBERS)
def test_sort_by_puts_indices_in_the_order_of_their_values(numbers: list[int]) -> None:
    values, index = np.array(numbers, np.int32), np.arange(len(numbers))[::-1].copy()
    sort_by(index, values)
    assert sorted(index.tolist()) == list(range(len(numbers)))
    assert values[index].tolist() == sorted(numbers)


def test_many_values() -> None:
    values = np.random.default_rng(2).normal(size=20_000)
    expected = np.sort(values)
    sort(values)
    assert np.array_equal(values, expected)
