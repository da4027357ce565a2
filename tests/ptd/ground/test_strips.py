"""Strips of land at the border and buildings that the border cuts, on surfaces drawn by formula."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale
from ptd.ground.cut_off_land import STRIP_REACH_M, on_strips
from ptd.ground.plateaus import Plateaus

SCALE = Scale(origin=(123_457, -98_765))
CELLS = CellLattice.of(1.0, SCALE)
SIDE = 120
Part = Callable[[np.ndarray, np.ndarray], np.ndarray]


def found(part: Part, side: int = SIDE, turns: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The part of a gentle slope that lies 4 m higher, and the cells of it that are found on strips."""
    x, y = (c.ravel() + 0.5 for c in np.meshgrid(*2 * [np.arange(side)]))
    high = part(x, y)
    z = 4.0 * high + 0.01 * x + np.random.default_rng(1).normal(0, 0.02, x.size)
    for _ in range(turns):
        x, y = y, side - x
    points = Xyz(*(np.round(1000 * c).astype(np.int32) for c in (x, y, z)))
    points = Xyz(points.x - 457, points.y + 765, points.z)
    rule = Plateaus.of(SCALE, 200.0)
    return high, on_strips(points, high, ~high, CELLS, 1.0, rule, SCALE)


@pytest.mark.parametrize(
    "part",
    [
        lambda x, y: y > SIDE - 12,
        lambda x, y: y > SIDE - 6,
        lambda x, y: y > SIDE - 16 + 0.15 * x,
        lambda x, y: y > SIDE - 10 + 3 * np.sin(x / 15),
    ],
    ids=["12 m", "6 m", "wedge", "curved"],
)
@pytest.mark.parametrize("turns", range(4))
def test_a_strip_of_land_is_found(part: Part, turns: int) -> None:
    high, on_strip = found(part, turns=turns)
    assert on_strip[high].mean() > 0.5
    assert not on_strip[~high].any()


@pytest.mark.parametrize(
    "part",
    [
        lambda x, y: (y > SIDE - 6) & (abs(x - 60) < 20),
        lambda x, y: (y > SIDE - 12) & (abs(x - 60) < 50),
        lambda x, y: (y > SIDE - 12) & (x < 60),
        lambda x, y: y > SIDE - 2,
        lambda x, y: (y > SIDE - 20) & (y < SIDE - 6),
        lambda x, y: np.hypot(x - 60, y - SIDE) < 17,
    ],
    ids=["house", "long house", "house in a corner", "too narrow", "inside", "round"],
)
@pytest.mark.parametrize("turns", [0, 1])
def test_other_parts_are_no_strips(part: Part, turns: int) -> None:
    assert not found(part, turns=turns)[1].any()


def test_rough_cells_are_no_land() -> None:
    """The lowest returns of a hedge scatter."""
    x, y = (c.ravel() + 0.5 for c in np.meshgrid(*2 * [np.arange(SIDE)]))
    high = y > SIDE - 12
    z = high * np.random.default_rng(2).uniform(2, 6, x.size)
    points = Xyz(*(np.round(1000 * c).astype(np.int32) for c in (x, y, z)))
    rule = Plateaus.of(SCALE, 200.0)
    assert not on_strips(points, high, ~high, CELLS, 1.0, rule, SCALE).any()


def test_points_beyond_the_reach_do_not_matter() -> None:
    """A strip of 400 m that ends as a house does, and windows of it."""
    side, reach = 400, int(STRIP_REACH_M) + 2
    x, y = (c.ravel() + 0.5 for c in np.meshgrid(np.arange(side), np.arange(60)))
    high = (y > 48) & (x < 350)
    z = 4.0 * high + np.random.default_rng(3).normal(0, 0.02, x.size)
    points = Xyz(*(np.round(1000 * c).astype(np.int32) for c in (x, y, z)))
    scale = Scale(origin=(0, 0))
    cells, rule = CellLattice.of(1.0, scale), Plateaus.of(scale, 200.0)
    whole = on_strips(points, high, ~high, cells, 1.0, rule, scale)
    assert 0.4 < whole[high].mean() < 0.9
    for east in (150, 260, 330, 400):
        seen = x < east
        part = on_strips(
            Xyz(*(c[seen] for c in points)), high[seen], ~high[seen], cells, 1.0, rule, scale
        )
        sure = (x < east - reach) | (east == side)
        assert np.array_equal(part[sure[seen]], whole[seen & sure])
