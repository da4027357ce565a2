"""Cells that openings cut off ridges and summits, on surfaces drawn by formula."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale
from ptd.ground.cut_off_land import PIT_REACH_CELLS, on_summits, without_thin
from ptd.ground.morphology import CellRaster

SCALE = Scale(origin=(123_500, -98_500))
AROUND = 18

Height = Callable[[np.ndarray, np.ndarray], np.ndarray]


def cloud(height: Height, side: int = 60, seed: int = 1) -> Xyz:
    """One point somewhere in each cell of 1 m, with the height of a function of x and y, and noise of 2 cm."""
    random = np.random.default_rng(seed)
    x, y = (
        c.ravel() + random.uniform(0, 1, side**2) for c in np.meshgrid(*2 * [np.arange(side)])
    )
    z = height(x, y) + random.normal(0, 0.02, x.size)
    order = np.lexsort((np.floor(x), np.floor(y)))
    return Xyz(*(np.round(1000 * c[order]).astype(np.int32) for c in (x, y, z)))


def put_back(points: Xyz, lost: np.ndarray, ground: np.ndarray | None = None) -> np.ndarray:
    raster = CellRaster(points.x, points.y, CellLattice(1000, 1, 0, 0))
    ground = ~lost if ground is None else ground
    return on_summits(points, lost, ground, raster, SCALE, 1.0, AROUND, between_pits=True)


def metres(points: Xyz) -> tuple[np.ndarray, np.ndarray]:
    return points.x / 1000, points.y / 1000


def test_the_slopes_of_a_ridge_come_back() -> None:
    points = cloud(lambda x, y: 20 - 0.9 * abs(x - 30))
    x, _ = metres(points)
    lost = abs(x - 30) < 12
    found = put_back(points, lost)
    assert found[lost & (abs(x - 30) > 2)].mean() > 0.99
    assert not found[~lost].any()


@pytest.mark.parametrize("roof", [0.0, 0.6])
def test_a_house_does_not_come_back(roof: float) -> None:
    """A flat and a gabled roof, walls of 4 m, on a slope."""

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        house = (abs(x - 30) < 7) & (abs(y - 30) < 10)
        return np.where(house, 4 + 0.2 * 30 + roof * (7 - abs(x - 30)), 0) + np.where(
            house, 0, 0.2 * x
        )

    points = cloud(height)
    x, y = metres(points)
    assert not put_back(points, (abs(x - 30) < 7) & (abs(y - 30) < 10)).any()


def test_a_steep_deck_does_not_come_back() -> None:
    """A ramp of 0.4 and 10 m width that continues the ground at its foot. Its sides are walls."""

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        on_deck = (abs(y - 30) < 5) & (x > 15)
        return np.where(on_deck, 0.4 * (x - 15), 0.0)

    points = cloud(height)
    x, y = metres(points)
    found = put_back(points, (abs(y - 30) < 5) & (x > 15))
    assert found[x > 20].mean() < 0.01


def test_level_crops_and_single_cells_do_not_come_back() -> None:
    points = cloud(lambda x, y: 0.3 * np.exp(-(((x - 30) / 8) ** 2)))
    x, y = metres(points)
    assert not put_back(points, abs(x - 30) < 12).any()
    slope = cloud(lambda x, y: 0.9 * x)
    assert not put_back(slope, (abs(x - 30) < 1) & (abs(y - 30) < 1)).any()


def test_rough_surfaces_do_not_come_back() -> None:
    """Crowns that scatter by half a metre on a ridge."""
    points = cloud(lambda x, y: 20 - 0.9 * abs(x - 30))
    x, _ = metres(points)
    lost = abs(x - 30) < 12
    scatter = np.random.default_rng(2).normal(0, 500, x.size) * lost
    crowns = Xyz(points.x, points.y, (points.z + scatter).astype(np.int32))
    assert put_back(crowns, lost).mean() < 0.02


def in_pits(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Four pits of 6 m around the middle."""
    return np.hypot(abs(x - 30) - 8, abs(y - 30) - 8) < 3


def test_level_land_between_pits_comes_back() -> None:
    points = cloud(lambda x, y: np.where(in_pits(x, y), -6.0, 0.0))
    x, y = metres(points)
    lost = (np.maximum(abs(x - 30), abs(y - 30)) < 11) & (points.z > -1000)
    assert put_back(points, lost)[lost].mean() > 0.95
    filled = cloud(lambda x, y: 0.0 * x)
    assert not put_back(filled, lost).any()


def test_a_deck_above_a_stream_and_a_house_around_a_courtyard_do_not_come_back() -> None:
    def bridge(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where((abs(x - 30) < 4) & (abs(y - 30) > 5), -5.0, 0.0)

    points = cloud(bridge)
    x, y = metres(points)
    assert not put_back(points, (abs(x - 30) < 9) & (abs(y - 30) < 5)).any()

    def house(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        outer = np.maximum(abs(x - 30), abs(y - 30))
        return np.where((outer < 12) & (outer > 3), 6.0, 0.0)

    points = cloud(house)
    assert not put_back(points, points.z > 3000).any()


def test_thin_strips_are_left_out() -> None:
    """Strips of 2 and 6 cells, and a few cells that touch the wide one."""
    points = cloud(lambda x, y: 0.0 * x)
    x, y = (np.floor(c) for c in metres(points))
    thin, wide = (x >= 10) & (x < 12), (x >= 30) & (x < 36)
    beside = (x == 36) & (y > 20) & (y < 25)
    raster = CellRaster(points.x, points.y, CellLattice(1000, 1, 0, 0))
    assert np.array_equal(without_thin(thin | wide | beside, raster, 2), wide | beside)
    assert not without_thin(thin, raster, 2).any()


def test_nothing_beyond_the_reach_has_a_part() -> None:
    random = np.random.default_rng(5)
    points = cloud(lambda x, y: 8 * np.sin(x / 7) + 8 * np.sin(y / 9), side=80)
    x, y = metres(points)
    lost = (points.z > 3000) ^ (random.random(x.size) < 0.02)
    inside = (abs(x - 40) < 10) & (abs(y - 40) < 10)
    reach = 10 + AROUND + PIT_REACH_CELLS
    beyond = (abs(x - 40) > reach + 1) | (abs(y - 40) > reach + 1)
    truth = put_back(points, lost)
    assert truth[inside].any()
    z = np.where(beyond, random.integers(-9000, 9000, x.size), points.z).astype(np.int32)
    changed = put_back(Xyz(points.x, points.y, z), np.where(beyond, ~lost, lost))
    assert np.array_equal(changed[inside], truth[inside])
    part = ~beyond
    alone = put_back(Xyz(*(c[part] for c in points)), lost[part])
    assert np.array_equal(alone[inside[part]], truth[inside])
