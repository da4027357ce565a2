"""Features of cells for the last look: a plane with a hedge and a wall, and their reach."""

from __future__ import annotations

import numpy as np

from ptd.matched import last_look


def test_cells_around_a_plane_with_a_hedge_and_a_wall() -> None:
    side = 40
    east = np.arange(side, dtype=np.float64)
    ground = np.tile(0.1 * east, (side, 1))
    heights, there = ground.copy(), np.ones((side, side), bool)
    heights[:, 20] += 0.6
    heights[:, 26] += 1.5
    sigma, band = np.full((side, side), 0.05), np.full((side, side), 0.25)
    found = last_look.around_cells(heights, there, ground, sigma, band, 1.0)
    at = found.features[20 * side + 22]
    line_5, line_10 = 1000 * 11 // 121, 1000 * 21 // 441
    assert at.tolist() == [
        250,
        50,
        100,
        0,
        0,
        0,
        line_5,
        line_10,
        line_5,
        line_10,
        1000 * 99 // 121,
    ]


def test_what_lies_around_a_cell_ends_at_its_reach() -> None:
    rng = np.random.default_rng(8)
    ground = rng.normal(0, 1, (60, 60))
    heights, there = ground + rng.normal(0, 0.3, ground.shape), rng.random(ground.shape) < 0.8
    sigma, band = np.full(ground.shape, 0.05), np.full(ground.shape, 0.25)
    whole = last_look.around_cells(heights, there, ground, sigma, band, 1.0).features.reshape(
        60, 60, -1
    )
    r = last_look.reach_cells(1.0)
    cut = slice(30 - r, 31 + r)
    part = [values[cut, cut] for values in (heights, there, ground, sigma, band)]
    found = last_look.around_cells(*part, 1.0).features.reshape(2 * r + 1, 2 * r + 1, -1)
    assert np.array_equal(found[r, r], whole[30, 30])
