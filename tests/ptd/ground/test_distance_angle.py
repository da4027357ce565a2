"""Points against one TIN: numbers by hand, and certainty."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.distance_angle import Bins, Threshold, Trial
from ptd.tin.mesh import Tin

CM = 100
SCALE = Scale(Fraction(1, CM), Fraction(1, CM))
SURE = UncertifiedRegion(Window.everything(), Window.everything(), (0, 0, 1000, 1000), SCALE)


def right_triangle() -> Tin:
    """Corners (0, 0), (6 m, 0), (0, 8 m), flat: circumradius 5 m."""
    return Tin.build(np.array([0, 600, 0]), np.array([0, 0, 800]), np.array([100, 100, 100]))


def columns(*points: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, y, z = np.array(points, np.int32).T
    return np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(z)


def test_distance_and_smallest_angle_by_hand() -> None:
    """Above (3, 0) by 0.3 m: corners 3, 3 and sqrt(73) m away in plan; the farthest gives the smallest angle."""
    point = columns((300, 0, 130))
    bins = Bins(0.1, 10, 0.005, 100)
    counts = Trial(right_triangle(), SCALE, 10.0).count(*point, np.ones(1, bool), bins)
    angle = math.atan2(0.3, math.sqrt(73))
    assert np.argwhere(counts).tolist() == [[3, int(angle / 0.005)]]


@pytest.mark.parametrize(
    ("threshold", "passes"),
    [((0.31, 0.036), True), ((0.29, 0.036), False), ((0.31, 0.034), False)],
)
def test_both_thresholds_hold(threshold: tuple[float, float], passes: bool) -> None:
    """0.3 m and atan(0.3 / sqrt(73)) = 0.0351."""
    point = columns((300, 10, 130), (300, 10, 70))
    trial = Trial(right_triangle(), SCALE, 10.0)
    found, is_uncertified = trial.test(*point, np.ones(2, bool), Threshold(*threshold), SURE)
    assert found.tolist() == [passes, passes]
    assert not is_uncertified.any()


def test_largest_angle_by_hand() -> None:
    """Above (2, 0) by 0.3 m the nearest corner is 2 m away in plan: atan(0.15)."""
    point, bins = columns((200, 0, 130)), Bins(0.1, 10, 0.005, 100)
    trial = Trial(right_triangle(), SCALE, 10.0, largest=True)
    counts = trial.count(*point, np.ones(1, bool), bins)
    assert np.argwhere(counts).tolist() == [[3, int(math.atan(0.15) / 0.005)]]
    for angle, passes in ((0.150, True), (0.148, False)):
        assert trial.test(*point, np.ones(1, bool), Threshold(0.31, angle), SURE)[
            0
        ].tolist() == [passes]


def test_on_a_vertex_the_height_counts_alone() -> None:
    point = columns((600, 0, 120), (600, 0, 140))
    found, _ = Trial(right_triangle(), SCALE, 10.0).test(
        *point, np.ones(2, bool), Threshold(0.3, 1e-6), SURE
    )
    assert found.tolist() == [True, False]


def test_wide_facets_and_the_outside_test_nothing() -> None:
    points = columns((200, 200, 100), (900, 900, 100))
    which, threshold = np.ones(2, bool), Threshold(0.3, 0.1)
    wide, narrow = (Trial(right_triangle(), SCALE, widest) for widest in (5.1, 4.9))
    assert wide.test(*points, which, threshold, SURE)[0].tolist() == [True, False]
    assert not narrow.test(*points, which, threshold, SURE)[0].any()
    assert not narrow.count(*points, which, Bins(0.1, 9, 0.1, 9)).any()


def test_only_chosen_points_are_tested() -> None:
    points = columns((200, 200, 100), (201, 200, 100))
    which = np.array([False, True])
    trial = Trial(right_triangle(), SCALE, 9.0)
    assert trial.test(*points, which, Threshold(0.3, 0.1), SURE)[0].tolist() == [False, True]
    assert trial.count(*points, which, Bins(0.1, 9, 0.1, 9)).sum() == 1


def test_no_triangle_no_ground() -> None:
    line = Tin.build(np.array([0, 100]), np.array([0, 0]), np.array([0, 0]))
    points = columns((50, 0, 0))
    trial = Trial(line, SCALE, 9.0)
    assert not trial.test(*points, np.ones(1, bool), Threshold(1.0, 1.0), SURE)[0].any()
    assert not trial.count(*points, np.ones(1, bool), Bins(0.1, 9, 0.1, 9)).any()


def test_heights_may_have_another_unit() -> None:
    fine = replace(SCALE, metres_z=Fraction(1, 1000))
    tin = Tin.build(np.array([0, 600, 0]), np.array([0, 0, 800]), np.array([1000] * 3))
    point = columns((300, 10, 1290))
    found, _ = Trial(tin, fine, 10.0).test(
        *point, np.ones(1, bool), Threshold(0.3, 0.036), SURE
    )
    assert found.all()


def test_certified_points_that_pass_do_so_whatever_lies_beyond_the_window() -> None:
    """Cut random TINs by windows: where the result is certified, the answer is that of the whole."""
    rng = np.random.default_rng(6)
    threshold, certain = Threshold(0.5, 0.3), 0
    for _ in range(40):
        side, n = 4000, int(rng.integers(20, 400))
        vertices = rng.integers(0, side, (3, n)).astype(np.int32) // np.array(
            [[1], [1], [30]], np.int32
        )
        tests = rng.integers(0, side, (3, 300)).astype(np.int32) // np.array(
            [[1], [1], [30]], np.int32
        )
        x0, y0 = (int(v) for v in rng.integers(-500, side, 2))
        window = Window(
            x0, y0, x0 + int(rng.integers(500, side)), y0 + int(rng.integers(500, side))
        )
        widest = float(rng.uniform(0.5, 8.0))
        trial = Trial(Tin.build(*vertices), SCALE, widest)
        truth, _ = trial.test(*tests, np.ones(300, bool), threshold, SURE)
        inside = [window.contains(c[0], c[1]) for c in (vertices, tests)]
        region = UncertifiedRegion(window, window, (0, 0, side, side), SCALE)
        trial = Trial(Tin.build(*vertices[:, inside[0]]), SCALE, widest, region)
        own = tests[:, inside[1]]
        found, is_uncertified = trial.test(*own, np.ones(own.shape[1], bool), threshold, region)
        assert (is_uncertified | (found == truth[inside[1]])).all()
        certain += int((~is_uncertified).sum())
    assert certain > 500
