"""Reach of contours by hand."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.ground.distance_angle import contour_reach


def test_one_bin_is_a_pyramid() -> None:
    """10 in one bin, 0 around it: the level of 4 is crossed six tenths of the way to the next middle."""
    counts = np.zeros((5, 6), np.int64)
    counts[2, 3] = 10
    assert contour_reach(counts, 4.0) == pytest.approx((2.5 + 0.6, 3.5 + 0.6))


def test_interpolation_between_middles() -> None:
    counts = np.array([[100, 60, 20, 0], [50, 30, 0, 0], [10, 0, 0, 0]], np.int64)
    # First: 50 -> 10 in the first column (0.75 of the way), 30 -> 0 in the second and along the
    # diagonal (1/3). Second: 60 -> 20 in the first row, exactly at the bin of 20.
    assert contour_reach(counts, 20.0) == pytest.approx((1.5 + 0.75, 2.5))


def test_the_border_of_the_histogram_closes_the_contour() -> None:
    assert contour_reach(np.full((3, 2), 8, np.int64), 2.0) == pytest.approx(
        (2.5 + 0.75, 1.5 + 0.75)
    )


def test_islands_are_left_out() -> None:
    counts = np.zeros((9, 9), np.int64)
    counts[0, 0], counts[6, 7] = 100, 50
    counts[2, 0] = 50  # across an empty bin, another contour as well
    assert contour_reach(counts, 1.0) == pytest.approx((0.5 + 0.99, 0.5 + 0.99))
    counts[1, 0] = 5
    assert contour_reach(counts, 1.0) == pytest.approx((2.5 + 49 / 50, 0.5 + 0.99))


def test_squares_are_split_along_one_diagonal() -> None:
    counts = np.zeros((4, 4), np.int64)
    counts[0, 1], counts[1, 2] = 10, 8  # along the diagonal: one contour
    assert contour_reach(counts, 1.0) == pytest.approx((1.5 + 7 / 8, 2.5 + 7 / 8))
    counts[:] = 0
    counts[0, 1], counts[1, 0] = 10, 8  # across it: two
    assert contour_reach(counts, 1.0) == pytest.approx((0.5 + 0.9, 1.5 + 0.9))


def test_nothing() -> None:
    assert contour_reach(np.zeros((3, 3), np.int64), 1e-9) is None
