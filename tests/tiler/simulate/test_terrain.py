"""Terrain by formula, compared with heights worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.simulate.terrain import (
    Bank,
    Basin,
    Cliff,
    Embankment,
    Hill,
    Line,
    Ridge,
    River,
    Terraces,
    Terrain,
    Waves,
)


def heights(feature, x, y=0.0):
    return feature.height_at(*np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float)))


def test_terrain_is_the_sum_of_its_features():
    hill = Hill(0, 0, 8, 20)
    assert Terrain(10, (0.1, 0.2)).height_at(10.0, 5.0) == pytest.approx(12)
    assert Terrain(10, (0.1, 0.2), (hill, hill)).height_at(20.0, 0.0) == pytest.approx(
        12 + 16 * np.exp(-0.5)
    )


def test_hill_dam_and_bank():
    assert heights(Hill(0, 0, 8, 20), [20.0]) == pytest.approx([8 * np.exp(-0.5)])
    dam = Embankment(0, 50, 0.0, height=4, crest_width=6, slope_width=8)
    assert heights(dam, 3.0, [52.9, 57.0, 61.1]) == pytest.approx([4, 2, 0])
    assert heights(
        Bank(30, drop=6, width=2, swing=0, period=100), [0, 30, 60]
    ) == pytest.approx([0, -3, -6], abs=1e-6)


def test_a_ridge_is_roof_shaped_with_hipped_ends():
    ridge = Ridge(Line(0, 0, 0.0), height=20, half_width=10, length=40)
    assert heights(ridge, 0.0, [0, 5, -5, 10, 12]) == pytest.approx([20, 10, 10, 0, 0])
    assert heights(ridge, [20, 25, 30, 35]) == pytest.approx([20, 10, 0, 0])


def test_terraces_are_flat_but_for_their_faces():
    stairs = Terraces(Line(0, 0, 0.0), steps=3, tread=10, rise=2, face=1)
    assert heights(stairs, 0.0, [-5, 0, 8.9, 9.5, 10, 18, 20, 29.5, 30, 99]) == pytest.approx(
        [0, 0, 0, 1, 2, 2, 4, 5, 6, 6]
    )


def test_a_cliff_rises_to_the_left_of_its_line():
    assert heights(
        Cliff(Line(0, 0, 90.0), height=12, width=3), [1, 0, -1.5, -3, -9]
    ) == pytest.approx([0, 0, 6, 12, 12])
    swinging = Cliff(Line(0, 0, 0.0), 12, 3, swing=5, period=40)
    assert heights(swinging, [10.0, 30.0], 0.0) == pytest.approx([12, 0])


def test_a_quarry_has_benches_and_a_pond_water():
    quarry = Basin(0, 0, radius=50, depth=12, wall_width=20, benches=2)
    # Benches and faces are 5 m wide: rim at 50, bench 45-50, face 40-45, bench 35-40, face
    # 30-35, then the floor.
    assert heights(quarry, [55, 46, 42.5, 38, 32.5, 20, 0]) == pytest.approx(
        [0, 0, -3, -6, -9, -12, -12]
    )
    assert not Terrain(0.0, (0.0, 0.0), (quarry,)).wet_at(0.0, 0.0)
    pond = Terrain(0.0, (0.0, 0.0), (Basin(0, 0, 50, 2, 10, water=True),))
    assert pond.wet_at([0.0, 39.0, 41.0], 0.0).tolist() == [True, True, False]


def test_a_river_has_two_banks_and_a_level_floor():
    river = River(Line(0, 0, 0.0), width=10, depth=4, bank_width=8)
    assert heights(river, 0.0, [0, 4.9, -4.9, 9, -9, 13, -20]) == pytest.approx(
        [-4, -4, -4, -2, -2, 0, 0]
    )
    assert river.wet_at(np.zeros(3), np.array([4.9, -4.9, 5.1])).tolist() == [True, True, False]


def test_waves_stay_within_their_height_and_have_no_end():
    waves = Waves.random(np.random.Generator(np.random.PCG64(1)), 10.0, 200.0)
    x = np.linspace(-1e5, 1e5, 20_001)
    z = heights(waves, x, 0.3 * x)
    assert 1.0 < np.abs(z).max() <= 10.0
    assert z[:1000].std() == pytest.approx(z[-1000:].std(), rel=0.2)
