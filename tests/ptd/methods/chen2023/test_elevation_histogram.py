"""The histogram of a run and its tails."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import Scale, Window
from ptd.methods.chen2023.method import (
    ElevationsPass,
    Tails,
    find_tails,
    histogram,
    merged,
    outside,
)
from ptd.passes import Points

BODY = dict.fromkeys(range(100, 130), 300)
"""Terrain from 100 to 130 m: 9000 points; a share of 0.001 is 9."""


def test_bins_start_at_height_0() -> None:
    z = np.array([-1001, -1000, -1, 0, 999, 1000], np.int32)
    assert histogram(z, Scale()) == {-2: 1, -1: 2, 0: 2, 1: 1}


def test_bins_are_metres_whatever_the_counts_are() -> None:
    feet = Scale(metres_z=Fraction(3048, 10**7))
    assert histogram(np.array([3280, 3281], np.int32), feet) == {0: 1, 1: 1}


def test_an_empty_histogram() -> None:
    assert histogram(np.zeros(0, np.int32), Scale()) == {}
    assert find_tails({}, 20, 0.001) is None


def test_parts_add_up_in_any_order() -> None:
    parts = [{3: 1, -2: 4}, {}, {3: 5}, {7: 1}]
    assert merged(parts) == merged(parts[::-1]) == {-2: 4, 3: 6, 7: 1}


def test_both_tails_are_cut() -> None:
    counts = BODY | {40: 2, 70: 3, 500: 1, 1400: 4}
    assert find_tails(counts, 20, 0.001) == Tails(100, 129, below=5, above=5)


@pytest.mark.parametrize(("gap", "low"), [(20, 100), (21, 79)])
def test_a_tail_lies_beyond_enough_empty_bins(gap: int, low: int) -> None:
    found = find_tails(BODY | {79: 1}, gap, 0.001)
    assert found is not None
    assert found.low_bin == low


@pytest.mark.parametrize(("n", "high"), [(9, 129), (10, 200)])
def test_a_tail_holds_no_more_than_its_share(n: int, high: int) -> None:
    """There are 9010 points with the tail; nine are at most 0.1 percent of them."""
    found = find_tails(BODY | {200: n}, 20, 0.001)
    assert found is not None
    assert found.high_bin == high


def test_a_second_level_of_terrain_stays_and_points_beyond_it_go() -> None:
    found = find_tails(BODY | {900: 4000, 990: 2}, 20, 0.001)
    assert found == Tails(100, 900, below=0, above=2)


def test_a_peak_without_gaps_stays_however_few_its_points_are() -> None:
    found = find_tails(BODY | dict.fromkeys(range(130, 900, 20), 1), 20, 0.5)
    assert found is not None
    assert (found.low_bin, found.high_bin) == (100, 890)


def test_heights_outside_the_range() -> None:
    below, above = outside(np.array([-1, 0, 1999, 2000], np.int32), Scale(), [0, 1])
    assert below.tolist() == [True, False, False, False]
    assert above.tolist() == [False, False, False, True]
    assert not any(mask.any() for mask in outside(np.array([-5, 5], np.int32), Scale(), None))


def test_the_pass_counts_the_lowest_point_of_each_cell_of_the_core_once() -> None:
    """The core starts at x = 1000. The lower points of its two cells of 1 m count, at 5 and 7 m."""
    cloud = np.array(
        [[500, 1100, 1200, 2500], [0, 0, 0, 0], [3000, 5000, 6000, 7000]], np.int32
    )
    step = ElevationsPass(1.0, 20.0, 0.001)
    core = Window(1000, 0, 9000, 9000)
    model = step.fit(Points(cloud), Window.everything(), core, Scale(), {})
    assert model.partial() == {"elevations": [(5, 1), (7, 1)]}


def test_the_state_and_its_notes() -> None:
    parts = [{"elevations": [[k, 300]]} for k in range(100, 130)] + [
        {"elevations": [[40, 2], [900, 1]]}
    ]
    state = {"notes": ["before"], "run": {}}
    found = ElevationsPass(1.0, 20.0, 0.001).reduce(parts, state)
    assert found["tails"] == [100, 129]
    why = "are outliers: beyond a gap of 20 m in the run's elevations, and no more than 0.001 of all"
    told = [f"2 candidates below 100 m {why}", f"1 candidates above 130 m {why}"]
    assert found["notes"] == ["before", *told]
    assert ElevationsPass(1.0, 20.0, 0.001).reduce(parts[::-1], state) == found
    assert ElevationsPass(1.0, 0.0, 0.001).reduce(parts, state)["tails"] is None
    assert ElevationsPass(1.0, 20.0, 0.001).reduce([], {}) == {"tails": None}
