"""Votes of neighbours: a slow search gives the same, in any order."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import CellGrid, Scale
from ptd.matched.ground_model import (
    ALIKE_M,
    ALIKE_SIGMAS,
    PARTS,
    RADIUS_M,
    REACH_M,
    ROUNDS,
    radius_m,
    votes,
)
from ptd.places import Field, values_at


def cloud(seed: int, n: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-3000, 4000, (2, n)).astype(np.int32)
    residual = rng.integers(-600, 600, n) * PARTS // 2
    return x, y, residual, rng.random(n) < 0.8


Figure = float | np.ndarray
"""One for all points, or a column of them."""


def slow_votes(
    x: np.ndarray,
    y: np.ndarray,
    residual: np.ndarray,
    asked: np.ndarray,
    square: Figure,
    alike: Figure,
) -> np.ndarray:
    near = (x[:, None].astype(np.int64) - x) ** 2 + (
        y[:, None].astype(np.int64) - y
    ) ** 2 < square
    for _ in range(ROUNDS):
        voters = near & asked & (abs(residual[:, None] - residual) < alike)
        means = (voters * residual).sum(axis=1) // np.maximum(voters.sum(axis=1), 1)
        residual = np.where(asked, means, residual)
    return residual


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    "scale",
    [
        Scale(),
        Scale(Fraction(1, 1000), Fraction(1, 1000), (-12_345, 678)),
        Scale(Fraction(3048, 10**7)),
    ],
)
@pytest.mark.parametrize("density", [0.5, 12.0])
def test_a_slow_search_finds_the_same(seed: int, scale: Scale, density: float) -> None:
    x, y, residual, asked = cloud(seed)
    sigma = 0.04
    alike = round(PARTS * scale.counts_z(ALIKE_M + ALIKE_SIGMAS * sigma))
    expected = slow_votes(x, y, residual, asked, scale.counts(radius_m(density)) ** 2, alike)
    found = votes(x, y, residual, asked, radius_m(density), sigma, scale)
    assert np.array_equal(found, expected)
    assert np.array_equal(found[~asked], residual[~asked])
    assert (found != residual)[asked].any()
    order = np.random.default_rng(0).permutation(x.size)
    again = votes(
        x[order], y[order], residual[order], asked[order], radius_m(density), sigma, scale
    )
    assert np.array_equal(again, found[order])


def test_the_vote_of_known_neighbours() -> None:
    """Of five points within 0.25 m one is not asked and one is not alike; the mean is of three, rounded down."""
    x, y = np.array([0, 100, 0, 100, 50], np.int32), np.array([0, 0, 100, 100, 50], np.int32)
    residual, asked = (
        np.array([0, 160, 321, 5, 90_000]),
        np.array([True, True, True, False, True]),
    )
    found = votes(x, y, residual, asked, radius_m(1000.0), 0.05, Scale())
    assert found.tolist() == [160, 160, 160, 5, 90_000]


def test_votes_see_no_farther_than_their_reach() -> None:
    x, y, residual, asked = cloud(3, 4000)
    whole = votes(x, y, residual, asked, radius_m(0.1), 0.05, Scale())
    seen, inner = (x < 1000 + 1000 * REACH_M), x < 1000
    part = votes(x[seen], y[seen], residual[seen], asked[seen], radius_m(0.1), 0.05, Scale())
    assert np.array_equal(part[inner[seen]], whole[inner])


def test_radius_holds_ten_points_within_its_limits() -> None:
    assert radius_m(10.0) == pytest.approx(np.sqrt(1 / np.pi), abs=0.005)
    assert (radius_m(0.0), radius_m(1e6)) == (RADIUS_M[1], RADIUS_M[0])
    in_cm = np.array([100 * radius_m(density) for density in np.arange(1.0, 60.0, 0.7)])
    assert in_cm == pytest.approx(np.round(in_cm))


def test_noise_is_averaged_and_steps_are_kept() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.integers(0, 20_000, (2, 8000)).astype(np.int32)
    sigma, step = 0.05, 0.6
    truth = np.where(x < 10_000, 0.0, step)
    residual = np.rint(1000 * PARTS * (truth + sigma * rng.standard_normal(x.size))).astype(
        np.int64
    )
    found = votes(x, y, residual, np.ones(x.size, bool), radius_m(20.0), sigma, Scale()) / (
        1000 * PARTS
    )
    assert (found - truth).std() < 0.5 * sigma
    assert abs((found - truth).mean()) < 0.005


def test_no_points() -> None:
    nothing = np.zeros(0, np.int32)
    found = votes(
        nothing,
        nothing,
        np.zeros(0, np.int64),
        np.zeros(0, bool),
        radius_m(12.0),
        0.05,
        Scale(),
    )
    assert found.size == 0


@pytest.mark.parametrize("narrowest", [0.25, 0.55])
def test_each_point_asks_neighbours_by_the_radius_and_noise_of_its_place(
    narrowest: float,
) -> None:
    """Places of 1 m, where both change from point to point."""
    rng = np.random.default_rng(8)
    x, y, residual, asked = cloud(9)
    places = rng.uniform(narrowest, 1.0, (12, 12))
    grid = CellGrid(1000, 1, 0, 0, -5, -5)
    radii = Field(places, grid, False, places.min(), places.max())
    noise = Field(0.1 * places.T, grid, False, 0.1 * places.min(), 0.1 * places.max())
    radius, sigma = values_at(radii, x, y), values_at(noise, x, y)
    square = np.rint((1000 * radius) ** 2)
    alike = np.rint(PARTS * 1000 * (ALIKE_M + ALIKE_SIGMAS * sigma))
    expected = slow_votes(x, y, residual, asked, square[:, None], alike[:, None])
    found = votes(x, y, residual, asked, radii, noise, Scale())
    assert np.array_equal(found, expected)
    order = rng.permutation(x.size)
    again = votes(x[order], y[order], residual[order], asked[order], radii, noise, Scale())
    assert np.array_equal(again, found[order])
