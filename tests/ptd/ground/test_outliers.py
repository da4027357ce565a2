"""Low points and groups, against the definition counted point by point."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.frame import Scale
from ptd.ground.outliers import isolated_in_height, low_outliers, search_margin

FEET = Fraction(3048, 10**7)
near = st.integers(-9000, 9000)


def by_counting(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, radius: float, depth: float, group: int
) -> np.ndarray:
    """The definition, all pairs, in counts."""
    dx, dy, dz = (v[None, :].astype(float) - v[:, None] for v in (x, y, z))
    near = dx * dx + dy * dy <= radius * radius
    level, above = (near & (dz <= depth)).sum(axis=1), (near & (dz > depth)).sum(axis=1)
    return (level <= group) & (above >= 3)


def find(points: np.ndarray, group: int = 5, scale: Scale | None = None) -> np.ndarray:
    x, y, z = np.ascontiguousarray(np.asarray(points, np.int32).T)
    return low_outliers(x, y, z, scale or Scale(), 5.0, 4.0, group)


def field(height: object = 0.0) -> np.ndarray:
    """A point a metre, 31 x 31, heights in metres; the middle one is number 480."""
    xy = np.stack(np.meshgrid(np.arange(31), np.arange(31))).reshape(2, -1) * 1000
    return np.column_stack(
        [*xy, np.broadcast_to(np.multiply(height, 1000), xy.shape[1])]
    ).astype(np.int32)


@settings(max_examples=80, deadline=None)
@given(
    points=st.lists(
        st.tuples(near, near, st.sampled_from([0, 3000, 4000, 4001, 9000])),
        min_size=1,
        max_size=50,
    ),
    radius=st.sampled_from([1.0, 2.5, 5.0]),
    group=st.integers(0, 4),
    unit=st.sampled_from([Fraction(1, 1000), FEET]),
    spread=st.sampled_from([1, 1, 30]),
)
def test_the_definition(
    points: list[tuple[int, int, int]], radius: float, group: int, unit: Fraction, spread: int
) -> None:
    x, y, z = np.ascontiguousarray(np.array(points, np.int32).T)
    x = (x * np.where(np.arange(x.size) % 3, 1, spread)).astype(np.int32)
    scale = Scale(unit, Fraction(1, 1000), (12, -999_999))
    got = low_outliers(x, y, z, scale, radius, 4.0, group)
    want = by_counting(x, y, z, scale.counts(radius), 4000.0, group)
    assert np.array_equal(got, want & (group > 0))


def test_a_single_low_point_is_found() -> None:
    points = field()
    points[480, 2] = -6000
    assert np.flatnonzero(find(points)).tolist() == [480]


def test_a_group_of_three_is_found_whole() -> None:
    points = field()
    group = [480, 481, 511]
    points[group, 2] = [-6000, -6500, -9000]
    assert np.flatnonzero(find(points)).tolist() == group
    assert not find(points, group=1).any()


def test_a_courtyard_of_many_points_is_kept() -> None:
    points = field(12.0).reshape(31, 31, 3)
    points[12:19, 12:19, 2] = 0
    assert not find(points.reshape(-1, 3)).any()


@pytest.mark.parametrize("slope", [0.2, 1.0])
def test_a_slope_is_kept(slope: float) -> None:
    assert not find(field(slope * np.tile(np.arange(31), 31))).any()


def test_the_depth_itself_is_not_deep_enough() -> None:
    points = field()
    points[480, 2] = -4000
    assert not find(points).any()
    points[480, 2] = -4001
    assert find(points)[480]


@pytest.mark.parametrize(("above", "found"), [(2, False), (3, True)])
def test_two_points_above_prove_nothing(above: int, found: bool) -> None:
    points = [[0, 0, 0]] + [[k * 100, 0, 9000] for k in range(above)]
    assert find(points).tolist() == [found] + [False] * above


def test_a_group_of_zero_finds_nothing() -> None:
    points = field()
    points[480, 2] = -6000
    assert not find(points, group=0).any()
    assert find(np.zeros((0, 3))).size == 0


@pytest.mark.parametrize(
    ("radius_m", "group", "cell_m", "cells"),
    [(5.0, 5, 1.0, 5), (5.0, 0, 1.0, 0), (3.3, 1, 1.0, 4), (3.5, 5, 0.7, 5), (3.6, 5, 0.7, 6)],
)
def test_the_margin_holds_the_radius(
    radius_m: float, group: int, cell_m: float, cells: int
) -> None:
    assert search_margin(radius_m, group, cell_m) == cells


def isolated(points: np.ndarray, radius: float = 5.0, depth: float = 4.0) -> list[int]:
    x, y, z = np.ascontiguousarray(np.asarray(points, np.int32).T)
    return np.flatnonzero(isolated_in_height(x, y, z, Scale(), radius, depth)).tolist()


def test_a_point_far_from_all_neighbours_in_height_is_isolated_above_and_below() -> None:
    points = field()
    points[480, 2], points[100, 2] = 4001, -4001
    assert isolated(points) == [100, 480]
    points[480, 2], points[100, 2] = 4000, -4000
    assert isolated(points) == []


def test_the_smallest_difference_counts_so_that_two_are_not_isolated() -> None:
    points = field()
    points[[480, 481], 2] = -9000
    assert isolated(points) == []


def test_a_wall_of_other_heights_within_the_radius_does_not_isolate() -> None:
    # Neighbours in a row are level, in a column 5 m apart.
    assert isolated(field(np.arange(961) % 31 * 5.0)) == []


def test_points_with_fewer_than_three_neighbours_are_not_isolated() -> None:
    points = np.array([[0, 0, 0], [1000, 0, 9000], [0, 1000, 18000]])
    assert isolated(points) == []
    assert isolated(np.vstack([points, [[1000, 1000, 27000]]])) == [0, 1, 2, 3]
    assert isolated(np.zeros((0, 3))) == []
