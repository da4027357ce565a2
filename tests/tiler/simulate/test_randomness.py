"""Random numbers of a place."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.simulate.randomness import BIAS, RELIEF, generator, node_normals, smooth_noise


def test_generators_differ_by_seed_purpose_and_place_alone():
    keys = [(1, 0, 2, 3), (2, 0, 2, 3), (1, 1, 2, 3), (1, 0, 3, 2), (1, 0, -2, 3)]
    first = [generator(*key).random(4).tolist() for key in keys]
    assert len({tuple(numbers) for numbers in first}) == len(keys)
    assert generator(*keys[0]).random(4).tolist() == first[0]


def test_node_normals_are_standard_and_independent():
    column, row = (
        grid.ravel() for grid in np.meshgrid(np.arange(-200, 200), np.arange(-100, 100))
    )
    numbers = node_normals(5, RELIEF, column, row)
    assert numbers.mean() == pytest.approx(0, abs=0.02)
    assert numbers.std() == pytest.approx(1, abs=0.01)
    raster = numbers.reshape(200, 400)
    for shifted in (raster[:, 1:] * raster[:, :-1], raster[1:] * raster[:-1]):
        assert shifted.mean() == pytest.approx(0, abs=0.02)
    assert np.abs(numbers - node_normals(6, RELIEF, column, row)).max() > 1


def test_smooth_noise_has_variance_one_everywhere_and_is_the_same_for_every_caller():
    x, y = np.random.Generator(np.random.PCG64(1)).uniform(-300, 300, (2, 40_000))
    noise = smooth_noise(5, BIAS, x, y, 2.0)
    assert noise.std() == pytest.approx(1, abs=0.03)
    for offset in (0.0, 0.5):
        near = np.abs(np.mod(x / 2, 1) - offset) < 0.1
        assert noise[near].std() == pytest.approx(1, abs=0.05)
    assert np.array_equal(noise[100:200], smooth_noise(5, BIAS, x[100:200], y[100:200], 2.0))
    step = smooth_noise(5, BIAS, x + 0.01, y, 2.0) - noise
    assert np.abs(step).max() < 0.06
