"""Noise from planar patches: the formula, what is refused as a patch, and independence of tiles and order."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import Scale, Window
from ptd.ground.noise_sums import BIN_M, PATCH_M, merge
from ptd.ground.roughness import REACH_M, measure

MM = Scale()
EVERYTHING = Window.everything()


def counts(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.rint(np.stack([x, y, z]) * 1000).astype(np.int32)


def field(
    seed: int, side: float = 60.0, density: float = 10.0
) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    x, y = rng.random((2, round(side * side * density))) * side
    return x, y, rng


def of(xyz: np.ndarray, scale: Scale = MM):
    return merge([measure(xyz, EVERYTHING, EVERYTHING, scale)])


def test_residuals_of_one_patch_by_hand() -> None:
    """A lattice of 8 x 8 points, heights +-h like a chessboard: the best plane is flat, sum of squares 64 h^2."""
    steps = np.arange(8) * 0.5 + 0.25
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    h = 0.05
    z = 12.0 + h * np.where((np.floor(x * 2) + np.floor(y * 2)) % 2, 1, -1)
    found = of(counts(x, y, z))
    assert found.patches == 1
    assert found.density_m2 == 64 / PATCH_M**2
    assert found.sigma_m == pytest.approx(h * math.sqrt(64 / 61), abs=BIN_M)


def test_distance_is_perpendicular_to_a_slope() -> None:
    x, y, rng = field(1)
    sigma = 0.04
    flat = of(counts(x, y, sigma * rng.standard_normal(x.size)))
    vertical = sigma * math.sqrt(1 + 0.8**2) * rng.standard_normal(x.size)
    slope = of(counts(x, y, 0.8 * x + vertical))
    assert flat.patches > 150
    assert slope.patches > 100
    # The lower quartile of 16 * 10 points a patch: 0.674 / sqrt(2 * 160) = 4 % below the
    # middle.
    assert flat.sigma_m == pytest.approx(sigma * 0.96, abs=0.0015)
    assert slope.sigma_m == pytest.approx(sigma * 0.96, abs=0.0015)


@pytest.mark.parametrize(
    "shape",
    [
        lambda x, y: 0.5 * (np.floor(x / 2) % 2),  # steps
        lambda x, y: 0.1 * ((x % 4) - 2) ** 2 + 0.1 * ((y % 4) - 2) ** 2,  # bowls
        lambda x, y: 1.3 * x,  # steeper than 45 degrees
        # a canopy
        lambda x, y: 3.0 * np.modf(np.sin(12.9898 * x + 78.233 * y) * 43758.5453)[0],
    ],
)
def test_no_plane(shape) -> None:
    x, y, rng = field(2)
    assert of(counts(x, y, shape(x, y) + 0.03 * rng.standard_normal(x.size))).sigma_m is None


def test_roofs_are_no_ground() -> None:
    """Rough ground around a smooth roof: the roof's patches do not count."""
    x, y, rng = field(3)
    roof = (abs(x - 30) < 10) & (abs(y - 30) < 10)
    z = np.where(
        roof, 6 + 0.01 * rng.standard_normal(x.size), 0.08 * rng.standard_normal(x.size)
    )
    found = of(counts(x, y, z))
    assert found.sigma_m == pytest.approx(0.08 * 0.96, abs=0.004)
    assert found.patches < (60 * 60 - 20 * 20) / 16 + 1


def test_lawns_do_not_raise_it() -> None:
    x, y, rng = field(4)
    sigma = np.where(x < 20, 0.03, 0.09)
    assert of(counts(x, y, sigma * rng.standard_normal(x.size))).sigma_m == pytest.approx(
        0.03, abs=0.004
    )


@pytest.mark.parametrize("sigma", [0.03, 0.06, 0.12])
@pytest.mark.parametrize("density", [10.0, 40.0])
def test_smoothest_places_tell_the_noise_whatever_stands_on_the_ground(
    sigma: float, density: float
) -> None:
    """Plants, slopes and steps everywhere but in a corner, which is no larger than 30 m x 30 m of 60 m x 60 m."""
    x, y, rng = field(7, density=density)
    z = 0.3 * x + sigma * rng.standard_normal(x.size)
    bare = of(counts(x, y, z)).smoothest_m
    z += np.where((x < 30) & (y < 30), 0.0, rng.uniform(0.0, 0.9, x.size))
    among_plants = of(counts(x, y, z)).smoothest_m
    # With 40 points a quarter the lowest twentieth of all is 0.8 of the noise, of a quarter of
    # them 0.85.
    assert bare == pytest.approx(sigma, rel=0.15)
    assert among_plants == pytest.approx(sigma, rel=0.2)


def test_quarters_by_hand() -> None:
    """Four quarters of 16 points, heights +-h like a chessboard: sum of squares 16 h^2 each, 13 degrees of freedom."""
    steps = np.arange(8) * 0.5 + 0.25
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    z = 12.0 + 0.05 * np.where((np.floor(x * 2) + np.floor(y * 2)) % 2, 1, -1)
    part = measure(counts(x, y, z), EVERYTHING, EVERYTHING, MM)
    assert sum(part["quarters"][1:]) == 4
    assert merge([part]).smoothest_m == pytest.approx(
        1.25 * 0.05 * math.sqrt(16 / 13), abs=2 * BIN_M
    )
    few = measure(counts(x[::2], y[::2], z[::2]), EVERYTHING, EVERYTHING, MM)
    assert few["quarters"] == []
    assert merge([few]).smoothest_m is None


def test_a_few_patches_among_many_cells_tell_nothing() -> None:
    part = {"points": 1000, "cells": 60, "full": 50, "patches": [30, 1], "quarters": []}
    assert merge([part]).sigma_m == pytest.approx(0.0305)
    found = merge([part, {**part, "full": 151, "patches": []}])
    assert (found.sigma_m, found.patches) == (None, 1)


def test_few_points_give_the_density_alone() -> None:
    x, y, _ = field(5, density=0.5)
    found = of(counts(x, y, 0 * x))
    assert found.sigma_m is None
    assert found.density_m2 == pytest.approx(0.5, rel=0.05)
    nothing = merge([measure(np.zeros((3, 0), np.int32), EVERYTHING, EVERYTHING, MM)])
    assert (nothing.density_m2, nothing.sigma_m, nothing.patches) == (0.0, None, 0)


@pytest.mark.parametrize("origin", [(0, 0), (-12_345, 678)])
def test_tiles_and_order_change_nothing(origin) -> None:
    x, y, rng = field(6, side=90.0, density=6.0)
    roof = (x % 31 < 9) & (y % 27 < 12)
    z = 0.1 * x + np.where(roof, 5.0, 0.0) + 0.05 * rng.standard_normal(x.size)
    keep = (x < 60) | (y < 30)
    xyz = counts(x[keep], y[keep], z[keep])
    scale = Scale(Fraction(1, 1000), Fraction(1, 1000), origin)
    whole = merge([measure(xyz, EVERYTHING, EVERYTHING, scale)])
    assert whole.patches > 20
    partials = []
    step, reach = 13_700, round(1000 * REACH_M)
    for west in range(0, 90_001, step):
        for south in range(0, 90_001, step):
            core = Window(west, south, west + step, south + step)
            window = Window(
                core.west - reach, core.south - reach, core.east + reach, core.north + reach
            )
            part = xyz[:, window.contains(xyz[0], xyz[1])]
            partials.append(
                measure(part[:, rng.permutation(part.shape[1])], window, core, scale)
            )
    assert merge(partials) == whole
    assert merge(reversed(partials)) == whole
    assert sum(p["points"] for p in partials) == xyz.shape[1]
