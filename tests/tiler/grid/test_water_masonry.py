"""Masonry that was classified as objects is land, but crowns, boats and decks are not."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.grid.water_masonry import MASONRY_MARGIN, MASONRY_REACH, ObjectCells, masonry, smooth_tops

LEVEL_M, TOP_M, SIDE = 10.0, 11.2, 70
ROWS, COLUMNS = np.mgrid[0:SIDE, 0:SIDE]
LAND = COLUMNS >= 30
WALL = np.abs(ROWS - 20) <= 1
"""Rows of a wall of three cells that continues from the land over the water."""


def found(top: np.ndarray, water: np.ndarray, heights: np.ndarray, spread_m: float = 0.1) -> np.ndarray:
    """Return the masonry in ``water`` where objects at ``heights`` cover the cells of ``top``, 4 points each."""
    number = np.where(top, 4.0, 0.0)
    objects = ObjectCells(
        number, *(np.where(top, heights + d, np.nan) for d in (-spread_m / 2, 0, spread_m / 2))
    )
    tops = smooth_tops(objects, np.zeros(top.shape), np.full(top.shape, LEVEL_M), 0.3)
    return masonry(~water, tops, np.where(tops, heights, np.nan), number)


def test_a_wall_that_continues_from_the_land_and_ends_is_land() -> None:
    end = 30 - MASONRY_REACH
    wall = WALL & (end <= COLUMNS)
    np.testing.assert_array_equal(found(wall, ~LAND, np.full(LAND.shape, TOP_M)), wall & ~LAND)


def test_a_gap_in_a_wall_between_two_pieces_of_land_is_land() -> None:
    gap = (COLUMNS >= 30 - 2 * MASONRY_REACH) & ~LAND
    np.testing.assert_array_equal(found(WALL, gap, np.full(LAND.shape, TOP_M)), gap & WALL)


@pytest.mark.parametrize(("width", "slant"), [(15, 0.0), (20, 0.0), (18, 0.7), (24, -1.0), (24, 1.0)])
def test_a_deck_over_a_river_is_not_masonry(width: int, slant: float) -> None:
    across = COLUMNS - slant * (ROWS - 20)
    river = (across >= 40 - width) & (across < 40)
    deck = np.abs(ROWS - 20) <= 4
    assert not found(deck, river, np.full(LAND.shape, TOP_M)).any()


def test_a_boat_beside_a_quay_of_another_height_is_not_masonry() -> None:
    boat = (COLUMNS >= 27) & ~LAND & (np.abs(ROWS - 20) < 6)
    assert found(boat | LAND, ~LAND, np.full(LAND.shape, TOP_M)).any()
    assert not found(boat | LAND, ~LAND, np.where(boat, TOP_M + 0.5, TOP_M)).any()


def test_crowns_and_reed_are_not_masonry() -> None:
    wall = WALL & (COLUMNS >= 27)
    heights = np.full(LAND.shape, TOP_M)
    assert not found(wall, ~LAND, heights, spread_m=0.6).any()
    rough = heights + np.random.default_rng(4).normal(0.0, 0.8, LAND.shape)
    assert found(wall, ~LAND, rough).sum() <= 1
    assert not found(wall, ~LAND, np.full(LAND.shape, LEVEL_M + 0.2)).any()


def test_a_single_point_is_no_top() -> None:
    wall = WALL & (COLUMNS >= 27)
    objects = ObjectCells(np.where(wall, 1.0, 0.0), *[np.where(wall, TOP_M, np.nan)] * 3)
    assert not smooth_tops(objects, np.zeros(wall.shape), np.full(wall.shape, LEVEL_M), 0.3).any()


def test_a_cell_at_the_edge_with_few_points_is_water_and_one_inside_is_land() -> None:
    wall = WALL & (COLUMNS >= 27)
    number = np.where(wall, 4.0, 0.0)
    number[21, 28] = number[20, 29] = 2.0
    is_masonry = masonry(LAND, wall, np.where(wall, TOP_M, np.nan), number)
    assert not is_masonry[21, 28]
    assert is_masonry[20, 29]


def test_masonry_depends_on_no_cell_beyond_the_margin() -> None:
    rng = np.random.default_rng(5)
    top = rng.random(LAND.shape) < 0.9
    heights = np.where(top, TOP_M + rng.normal(0.0, 0.05, LAND.shape), np.nan)
    water = (COLUMNS > 8) & (COLUMNS < 62) & (rng.random(LAND.shape) < 0.97)
    number = rng.integers(1, 6, LAND.shape).astype(np.float64)
    whole = masonry(~water, top, heights, number)
    part = np.s_[5:65, 5:65]
    inner = np.s_[MASONRY_MARGIN + 1 : -MASONRY_MARGIN - 1, MASONRY_MARGIN + 1 : -MASONRY_MARGIN - 1]
    cut = masonry(~water[part], top[part], heights[part], number[part])
    np.testing.assert_array_equal(cut[inner], whole[part][inner])
    assert whole.any()
