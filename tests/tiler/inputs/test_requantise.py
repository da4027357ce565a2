from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.inputs.requantise import BEYOND, bounds_in_counts, decimal_terms, to_counts

INT32 = st.integers(-(2**31), 2**31 - 1)
SCALES = st.sampled_from(
    [1.0, 0.5, 0.1, 0.01, 0.001, 0.0001, 1e-7, 0.00025, 0.0254, 1 / 3, 0.0013908205841446453]
)
OFFSETS = st.sampled_from(
    [0.0, -0.0, 500_000.0, 5_400_000.0, -98436.0, 0.5, 637301.2, 435049.99100000004, 1e9]
)


@given(st.lists(INT32, min_size=1, max_size=50), SCALES, OFFSETS)
def test_counts_are_the_nearest_to_the_coordinates(
    values: list[int], scale: float, offset: float
) -> None:
    found = to_counts(np.array(values, dtype=np.int32), scale, offset)
    assert found.usable.all()
    slack = Fraction(0) if decimal_terms(scale, offset) else Fraction(1, 100)
    for value, count in zip(values, found.counts.tolist(), strict=True):
        exact = (value * Fraction(repr(scale)) + Fraction(repr(offset))) * 1000
        assert abs(exact - count) <= Fraction(1, 2) + slack
        if not slack:
            assert float(abs(exact - count)) / 1000 <= found.largest_rounding + 1e-18


@given(st.lists(INT32, min_size=2, max_size=50, unique=True), SCALES, OFFSETS)
def test_the_order_of_coordinates_is_kept(
    values: list[int], scale: float, offset: float
) -> None:
    counts = to_counts(np.array(sorted(values), dtype=np.int32), scale, offset).counts
    assert (np.diff(counts) >= 0).all()


@given(st.lists(INT32, min_size=1, max_size=20), st.integers(-(10**9), 10**9))
def test_whole_counts_stay_exact(values: list[int], offset: int) -> None:
    found = to_counts(np.array(values, dtype=np.int32), 0.01, float(offset))
    assert found.largest_rounding == 0.0
    assert found.counts.tolist() == [v * 10 + offset * 1000 for v in values]


def test_largest_rounding_is_in_units() -> None:
    found = to_counts(np.array([10, 14, 15, 16], dtype=np.int32), 0.0001, 0.0)
    assert found.counts.tolist() == [1, 1, 2, 2]
    assert found.largest_rounding == pytest.approx(0.0005)


def test_the_same_place_by_other_scales_is_the_same_count() -> None:
    one = to_counts(np.array([12345], dtype=np.int32), 0.01, 600_000.0)
    other = to_counts(np.array([1123450], dtype=np.int32), 0.001, 599_000.0)
    assert one.counts[0] == other.counts[0] == 600_123_450


def test_numbers_that_are_no_coordinates_are_not_usable() -> None:
    found = to_counts(np.array([0, 1, 2], dtype=np.int32), 1e308, 0.0)
    assert found.usable.tolist() == [True, False, False]
    found = to_counts(np.array([0], dtype=np.int32), 0.01, 1e300)
    assert not found.usable.any()
    assert found.counts.tolist() == [0]
    assert BEYOND > 2**31 * 1000


@given(st.floats(-1e7, 1e7), INT32)
def test_bounds_in_counts_hold_the_counts_of_the_coordinates_inside(
    edge: float, count: int
) -> None:
    bounds = bounds_in_counts((edge, edge, edge + 1, edge + 1))
    assert (count >= bounds.x0) == (Fraction(count, 1000) >= Fraction(repr(edge)))
    assert bounds.x0 == math.ceil(Fraction(repr(edge)) * 1000)
