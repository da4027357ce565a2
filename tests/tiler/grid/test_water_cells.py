"""Water is found where land rises all around what returns little; nothing else that returns little is water."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tiler.grid import reach, water_cells
from tiler.grid.water_cells import Cells, dense_enough, find_water, under_bridges, without_narrows

SIDE = 120  # cells of 2 m
ROW, COL = np.mgrid[0:SIDE, 0:SIDE].astype(np.float64)
LAKE = np.hypot(ROW - 50, COL - 60) < 22
RIVER = np.abs(ROW - 60 - 6 * np.sin(COL / 20)) < 8
STRIP = np.abs(COL - 60) < 6
BASIN = 10 + 0.15 * np.clip(np.hypot(ROW - 50, COL - 60) - 21, 0, 10)
VALLEY = 10 + 0.01 * COL + 0.2 * np.clip(np.abs(ROW - 60 - 6 * np.sin(COL / 20)) - 7.5, 0, 12)
FLAT = np.full((SIDE, SIDE), 10.0)
HILLS = 10 + 4 * np.sin(ROW / 15) + 3 * np.cos(COL / 11)
SLOPE = 10 + 0.2 * ROW


def cells(ground: np.ndarray, few: np.ndarray, left: float = 0.0, seed: int = 1) -> Cells:
    """Some 20 returns a cell, of which ``few`` cells keep a share; ground where there are returns, else as around."""
    rng = np.random.default_rng(seed)
    returns = rng.poisson(20 * np.where(few, left, 1.0)).astype(np.float64)
    uneven = ground + rng.normal(0, 0.04, ground.shape)
    every = np.ones(ground.shape, np.bool_)
    return Cells(returns, ~every, uneven, every, 2.0)


def found(given: Cells, trusted: bool = True) -> np.ndarray:
    water = np.zeros(given.returns.shape, np.bool_)
    for body in find_water(given, trusted):
        water[body.window] |= body.cells
    return water


@pytest.mark.parametrize(("ground", "wet"), [(BASIN, LAKE), (VALLEY, RIVER)])
@pytest.mark.parametrize("left", [0.0, 0.3])
def test_water_between_rising_banks_is_found(ground: np.ndarray, wet: np.ndarray, left: float) -> None:
    water = found(cells(ground, wet, left))
    assert (water & wet).sum() > 0.85 * wet.sum()
    assert (water & ~wet).sum() <= 0.01 * wet.sum()


@pytest.mark.parametrize("left", [0.0, 0.3])
def test_the_land_around_may_be_compared_in_pieces(left: float, monkeypatch: pytest.MonkeyPatch) -> None:
    given = cells(VALLEY, RIVER, left)
    whole = [(body.window, body.cells.tolist(), body.sure) for body in find_water(given, True)]
    monkeypatch.setattr(water_cells, "PLACES_AT_ONCE", 7)
    monkeypatch.setattr(reach, "STRIP_ROWS", 9)
    assert whole
    assert [(body.window, body.cells.tolist(), body.sure) for body in find_water(given, True)] == whole


@pytest.mark.parametrize(
    ("ground", "few", "left"),
    [
        (FLAT, LAKE, 0.0),  # a hole in level land
        (FLAT, LAKE, 0.3),  # wet asphalt, a dark lawn
        (FLAT, STRIP, 0.0),  # between two strips
        (HILLS, STRIP, 0.0),
        (SLOPE, LAKE, 0.0),
        (20 - BASIN, LAKE, 0.0),  # on a hill
        (BASIN, LAKE, 1.0),  # a sunken pitch: as many returns as anywhere
        (FLAT + 6 * (np.abs(COL - 80) < 6), np.abs(COL - 69) < 5, 0.0),  # the shadow of a wall
    ],
)
def test_what_returns_little_elsewhere_is_no_water(ground: np.ndarray, few: np.ndarray, left: float) -> None:
    assert not found(cells(ground, few, left)).any()


def test_returns_as_many_as_on_land_are_water_where_it_goes_on() -> None:
    given = cells(VALLEY, RIVER & ~STRIP, 0.3)
    water = found(given)
    assert (water & RIVER & STRIP).sum() > 0.7 * (RIVER & STRIP).sum()
    assert (water & ~RIVER).sum() < 0.02 * RIVER.sum()


def test_of_matched_clouds_only_the_class_tells() -> None:
    given = cells(BASIN, LAKE)
    assert not found(given, trusted=False).any()
    water = found(replace(given, given=LAKE), trusted=False)
    assert (water == LAKE).mean() > 0.99


def test_cells_are_larger_where_points_are_sparse() -> None:
    sparse = replace(cells(FLAT, LAKE), returns=np.random.default_rng(2).poisson(2.0, FLAT.shape) * 1.0)
    assert dense_enough(sparse).size == 4
    assert not found(dense_enough(sparse)).any()


def test_water_goes_on_under_a_bridge_and_not_through_a_dam() -> None:
    broken = RIVER & ~(np.abs(COL - 60) < 2)
    dam = np.where(np.abs(COL - 60) < 2, 13.0, VALLEY)
    closed = [under_bridges(cells(ground, ~broken), broken) for ground in (VALLEY, dam)]
    assert (closed[0] & RIVER).sum() > 0.99 * RIVER.sum()
    assert (closed[1] == broken).all()


def test_narrow_arms_are_left_out() -> None:
    arm = (np.abs(ROW - 50) < 2) & (COL > 60)
    kept = without_narrows(LAKE | arm, 8.0)
    assert (kept & LAKE).sum() > 0.97 * LAKE.sum()
    assert (kept & arm & ~LAKE).sum() < 0.25 * (arm & ~LAKE).sum()
