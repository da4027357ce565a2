"""Pits are narrow and deep, for any slope, order or tile."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import Scale
from ptd.methods.dong2018.surfaces import PIT_REACH_CELLS, pits

CM = 100
SCALE = Scale(Fraction(1, CM), Fraction(1, CM), (-7_150, 12_330))


def slope(rise: float) -> np.ndarray:
    """A slope of 30 x 30 m with a point every half metre: int32 [3, n]."""
    steps = np.arange(25, 3000, 50, dtype=np.int32)
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    return np.stack([x, y, (rise * x).astype(np.int32)])


def found(cloud: np.ndarray, depth_m: float = 0.4) -> np.ndarray:
    return pits(*cloud, depth_m, SCALE).holds(*cloud)


@pytest.mark.parametrize("rise", [0.0, 0.5, -2.0])
def test_a_slope_has_no_pits(rise: float) -> None:
    assert not found(slope(rise)).any()


@pytest.mark.parametrize("rise", [0.0, 0.5])
def test_single_points_and_clumps(rise: float) -> None:
    cloud = slope(rise)
    low = (np.hypot(cloud[0] - 1000, cloud[1] - 1500) < 75) | (
        (cloud[0] == 2125) & (cloud[1] == 525)
    )
    cloud[2, low] -= 150  # points a cell or two downhill still lie 50 above it
    shallow = (cloud[0] == 725) & (cloud[1] == 725)
    cloud[2, shallow] -= 30
    assert np.array_equal(found(cloud), low)


def test_a_wide_pit_is_ground() -> None:
    cloud = slope(0.0)
    cloud[2, (abs(cloud[0] - 1500) < 200) & (abs(cloud[1] - 1500) < 200)] -= 300
    assert not found(cloud).any()


def test_an_alley_is_a_pit_but_a_street_is_not() -> None:
    cloud = slope(0.0)
    cloud[2] += 600
    alley, street = abs(cloud[0] - 700) < 60, abs(cloud[0] - 2000) < 200
    cloud[2, alley | street] -= 600
    marked = found(cloud)
    assert marked[alley].mean() > 0.9
    assert not marked[street].any()


def test_order_and_window_change_nothing() -> None:
    rng = np.random.default_rng(7)
    xy = rng.integers(-2000, 4000, (2, 9000))
    cloud = np.stack([*xy, rng.integers(0, 150, 9000)]).astype(np.int32)
    truth = found(cloud)
    assert 0.05 < truth.mean() < 0.5
    order = rng.permutation(9000)
    assert np.array_equal(found(cloud[:, order]), truth[order])
    away = np.maximum(abs(cloud[0] - 1000), abs(cloud[1] - 700))
    near, own = away < 900 + 100 * (PIT_REACH_CELLS + 1), away < 900
    part = np.ascontiguousarray(cloud[:, near])
    assert np.array_equal(found(part)[own[near]], truth[own])
