"""The insertion order is a permutation along a Hilbert curve, coarse to fine."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.tin.bulk import curve_order, round_order


def test_neighbours_on_the_curve_are_neighbours_on_the_grid() -> None:
    x, y = (a.ravel().astype(np.int32) for a in np.meshgrid(np.arange(64), np.arange(64)))
    order = curve_order(x << 10, y << 10)
    assert sorted(order.tolist()) == list(range(64 * 64))
    steps = np.abs(np.diff(x[order])) + np.abs(np.diff(y[order]))
    assert (steps == 1).all()


@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 5, 15, 16, 17, 1000])
def test_rounds_are_a_permutation_that_starts_evenly_spread(n: int) -> None:
    order = round_order(np.arange(n, dtype=np.int32))
    assert sorted(order.tolist()) == list(range(n))
    if n >= 100:
        first = np.sort(order[: n // 16])
        assert np.diff(first).min() >= 4


@pytest.mark.parametrize("low", [-(2**31), 0, 2**31 - 2**26])
def test_extremes_of_int32(low: int) -> None:
    x = (low + np.array([0, 2**26 - 1, 5])).astype(np.int32)
    assert sorted(curve_order(x, x[::-1].copy()).tolist()) == [0, 1, 2]
