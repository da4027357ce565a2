"""The shore keeps to the ground that was seen: ground above the water is land, and a quay ends where it ends."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
import shapely

from tests.tiler.grid.conftest import FINAL, Scene
from tiler.core.lattice import Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.coarse import padded
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_shore import (
    BANK_MARGIN,
    BANK_REACH_FINE_CELLS,
    FINER,
    HIGH_M,
    MAX_HEIGHT_M,
    Shore,
    dense_quays,
    finer_field,
    high_banks,
    quay_water,
    shore_details,
    shore_polygons,
)

ROWS, COLUMNS = np.mgrid[0:40, 0:40]
SHORE = 20
"""First column of land by the coarse cells."""
FIELD = np.where(COLUMNS < SHORE, -1.0, 1.0)
NOWHERE = np.zeros(FIELD.shape, np.bool_)


def test_a_plane_keeps_its_heights_between_the_middles_of_cells() -> None:
    rows, columns = np.mgrid[0:10, 0:12]
    fine_rows, fine_columns = (np.mgrid[0:20, 0:24] + 0.5) / FINER - 0.5
    inner = np.s_[1:-1, 1:-1]
    expected = 2.0 * fine_rows - 0.5 * fine_columns + 1.0
    np.testing.assert_allclose(
        finer_field(2.0 * rows - 0.5 * columns + 1.0)[inner], expected[inner]
    )


@pytest.mark.parametrize(("height", "is_land"), [(HIGH_M + 0.01, True), (HIGH_M - 0.01, False)])
def test_high_ground_connected_with_land_is_land(height: float, is_land: bool) -> None:
    seen = (COLUMNS >= SHORE - 3) & (ROWS > 10)
    banks = high_banks(FIELD, np.where(seen, height, np.nan))
    np.testing.assert_array_equal(banks, seen & (COLUMNS < SHORE) & is_land)


def test_high_ground_in_the_middle_of_the_water_stays_water() -> None:
    rock = (np.abs(ROWS - 20) < 3) & (np.abs(COLUMNS - 8) < 3)
    assert not high_banks(FIELD, np.where(rock, 2.0, np.nan)).any()


def test_a_pier_is_land_no_farther_than_the_reach() -> None:
    pier = (np.abs(ROWS - 20) < 3) & (COLUMNS > 2)
    banks = high_banks(FIELD, np.where(pier, 2.0, np.nan))
    np.testing.assert_array_equal(
        banks, pier & (COLUMNS >= SHORE - BANK_REACH_FINE_CELLS) & (COLUMNS < SHORE)
    )


@pytest.mark.parametrize(
    ("has_points", "above", "is_upright", "is_water"),
    [
        (False, np.nan, True, True),  # nothing returns
        (True, 0.05, True, True),  # returns of the water
        (True, 0.9, True, False),  # ground of the quay
        (True, np.nan, True, False),  # crowns
        (False, np.nan, False, False),  # a slope, or few points
    ],
)
def test_water_at_the_foot_of_a_quay(
    has_points: bool, above: float, is_upright: bool, is_water: bool
) -> None:
    foot = (COLUMNS >= SHORE) & (COLUMNS < SHORE + 2)
    heights = np.where(foot, above, 0.9)
    found = quay_water(FIELD, NOWHERE | is_upright, heights, np.where(foot, has_points, True))
    np.testing.assert_array_equal(found, foot & is_water)


METRE = 1000
SIDE_M, LEVEL_M, QUAY_M = 120, 10.0, 0.9
SLANT = 0.35


def quay_line(y: np.ndarray) -> np.ndarray:
    """Return x in metres of the edge of a quay that runs aslant to the cells. The land is east of it."""
    return 50.0 + SLANT * y


def test_a_quay_aslant_to_the_cells_has_no_seen_ground_in_the_water(
    make_scene: Callable[..., Scene],
) -> None:
    """With 8 points per m2 the ground ends 0.1 m before the edge of the quay, and one coarse cell has both."""
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, SIDE_M, (2, 8 * SIDE_M**2))
    land = x > quay_line(y)
    xyz = np.stack((x[land], y[land], np.full(land.sum(), LEVEL_M + QUAY_M)), axis=1)
    scene = make_scene(np.rint(xyz * METRE).astype(np.int64))
    coarse = RasterSpec(Lattice(Fraction(2 * METRE)), 0, SIDE_M // 2, SIDE_M // 2, SIDE_M // 2)
    block = Block(
        BANK_MARGIN,
        BANK_MARGIN,
        coarse.height - 2 * BANK_MARGIN,
        coarse.width - 2 * BANK_MARGIN,
    )
    window = padded(block, BANK_MARGIN)
    middle_x, middle_y = (values / METRE for values in coarse.centres(window))
    field = np.where(
        middle_x < quay_line(middle_y) + 0.8, -MAX_HEIGHT_M, QUAY_M
    )  # half a cell too far in the land
    shore = Shore(field, np.full(field.shape, LEVEL_M), np.ones(field.shape, np.bool_))
    near = padded(block, 1)
    inner = np.s_[BANK_MARGIN - 1 : 1 - BANK_MARGIN, BANK_MARGIN - 1 : 1 - BANK_MARGIN]
    before = shore_polygons(field[inner], coarse, near)
    seen = shore_details(scene.store, FINAL, coarse, window, shore)
    after = [shapely.difference(shapely.union_all([*before, seen.wet]), seen.dry)]

    def seen_inside(polygons: list[shapely.Geometry]) -> int:
        """Count the points of the quay in the water, away from the border of the window."""
        points = xyz[(np.abs(xyz[:, :2] - SIDE_M / 2) < SIDE_M / 2 - 12).all(axis=1)]
        whole = shapely.union_all(polygons)
        return int(shapely.contains_xy(whole, points[:, 0] * METRE, points[:, 1] * METRE).sum())

    assert seen_inside(before) > 100
    assert seen_inside(after) < 0.1 * seen_inside(before)
    truth = shapely.Polygon([(0, 0), (50, 0), (50 + SLANT * SIDE_M, SIDE_M), (0, SIDE_M)])
    part = shapely.box(20, 20, SIDE_M - 20, SIDE_M - 20)
    found = shapely.transform(shapely.union_all(after), lambda at: at / METRE)
    error = shapely.intersection(shapely.symmetric_difference(found, truth), part).area
    assert error / (SIDE_M - 40) / np.hypot(1, SLANT) < 0.5, (
        "metres from the edge of the quay, on average"
    )


@pytest.mark.parametrize(
    ("ground", "points", "is_quay"),
    [
        (np.full(FIELD.shape, 0.9), 20.0, True),
        (np.full(FIELD.shape, 0.9), 19.0, False),  # sparse
        (0.5 + 0.5 * (COLUMNS - SHORE), 20.0, False),  # a slope
        (np.full(FIELD.shape, 0.3), 20.0, False),  # low
    ],
)
def test_quays_are_high_level_banks_with_many_points(
    ground: np.ndarray, points: float, is_quay: bool
) -> None:
    wet = COLUMNS < SHORE
    returns = np.where(wet, 0.0, points).astype(np.float32)
    cells = WaterCells(returns, NOWHERE, np.where(wet, 0.0, ground), ~NOWHERE, 2.0)
    found = dense_quays(cells, wet, np.zeros(wet.shape))
    near = (np.abs(COLUMNS - SHORE) <= 1) & is_quay
    np.testing.assert_array_equal(
        found[:, 5:-5], near[:, 5:-5]
    )  # cells at the border lie in the margin of a block
