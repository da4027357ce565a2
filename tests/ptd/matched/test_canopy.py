"""Closed canopy: what is covered, what is no ground, and that nothing beyond the reach has a part in it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ptd.matched.canopy import Canopy, canopy, may_be, pit_reach_cells, pits, reach_cells
from ptd.matched.passes import PIT_ROUNDS
from ptd.matched.surface import Surface

SIDE = 160
ROWS, COLUMNS = np.indices((SIDE, SIDE), np.float64)


def crowns(seed: int = 3) -> np.ndarray:
    """Crowns of 3 to 5 m radius and up to 3 m height, one beside the other."""
    random = np.random.default_rng(seed)
    heights = np.zeros((SIDE, SIDE))
    for _ in range(1500):
        row, column = random.uniform(0, SIDE, 2)
        radius, top = random.uniform(3, 5), random.uniform(1.5, 3)
        away = np.hypot(ROWS - row, COLUMNS - column) / radius
        heights = np.maximum(heights, top * (1 - away**2))
    return heights


def seen(heights: np.ndarray, surface: np.ndarray) -> Canopy:
    """The canopy of cells of 1 m with a margin of empty ones, of which those near a surface are ground."""
    padded = np.pad(heights, 4, constant_values=np.nan)
    below = np.pad(surface, 4, mode="edge")
    even = Surface(below, np.full(below.shape, 0.05), np.where(np.isnan(padded), np.nan, 1.0))
    found = canopy(padded, even, np.abs(padded - below) < 0.25, 1.0)
    return Canopy(*(values[4:-4, 4:-4] for values in found))


def smooth(sigma: float, height: float) -> np.ndarray:
    noise = gaussian_filter(np.random.default_rng(5).normal(0, 1, (SIDE, SIDE)), sigma)
    return height * noise / noise.std()


def test_a_surface_that_climbed_onto_crowns_is_no_ground() -> None:
    heights = crowns() + 0.1 * COLUMNS
    found = seen(heights, heights)
    assert found.covered.mean() > 0.9
    assert found.crowns.mean() > 0.9


def test_a_clearing_stays_ground() -> None:
    lawn = (abs(ROWS - 80) < 25) & (abs(COLUMNS - 80) < 25)
    heights = np.where(lawn, 0.0, 12.0 + crowns())
    found = seen(heights, heights)
    assert found.crowns[lawn].mean() < 0.05
    assert found.covered[~lawn].mean() > 0.8


@pytest.mark.parametrize(
    "heights",
    [
        0.6 * COLUMNS,
        smooth(25, 15.0),  # hills
        smooth(2, 0.15),  # lava, rough pasture
        smooth(0.7, 0.25),  # rocks and rough grass
        np.where((ROWS // 4) % 2 == 0, 0.0, 0.4),  # furrows and hedges
        20 / (1 + np.exp((COLUMNS - 80 - 8 * np.sin(ROWS / 20)) / 3)),  # a rounded cliff
        np.floor(COLUMNS / 30) * 1.5,  # terraces
        30 - 0.8 * abs(COLUMNS - 80),  # a ridge
        1.2 * ((ROWS % 50 < 30) & (COLUMNS % 40 < 25)),  # fields of crops
    ],
)
def test_other_terrain_is_no_canopy(heights: np.ndarray) -> None:
    assert not seen(heights, heights).crowns.any()


def test_roofs_and_lone_trees_are_no_canopy() -> None:
    gables = np.where((ROWS % 40 < 12) & (COLUMNS % 30 < 16), 9 - 0.7 * abs(ROWS % 40 - 6), 0.0)
    hall = np.where((ROWS < 60) & (COLUMNS < 90), 8.0, gables)
    assert not seen(hall, np.zeros_like(hall)).covered.any()
    trees = np.where(np.hypot(ROWS % 40 - 20, COLUMNS % 40 - 20) < 7, 8.0 + crowns(), 0.0)
    assert not seen(trees, np.zeros_like(trees)).covered.any()


def test_rows_of_roofs_side_by_side_are_no_canopy() -> None:
    heights = 8.0 + 0.9 * abs(ROWS % 16 - 8)
    assert not seen(heights, np.zeros_like(heights)).covered.any()


def test_a_steep_slope_that_bends_beside_plants_is_no_canopy() -> None:
    bent = 0.6 * COLUMNS + 0.5 * crowns()
    plants = (ROWS % 12 < 3) & (COLUMNS % 12 < 3)
    assert not seen(np.where(plants, bent + 6.0, bent), bent).crowns.any()


def test_smooth_cells_need_no_surface() -> None:
    rough = crowns() + 0.1 * COLUMNS
    assert may_be(rough, 1.0).mean() > 0.9
    assert not may_be(smooth(25, 15.0), 1.0).any()
    assert not may_be(np.where((ROWS < 12) & (COLUMNS < 12), rough, 0.0), 1.0).any()


@pytest.mark.parametrize("tall", [0.0, 9.0])
def test_only_cells_that_may_be_covered_are(tall: float) -> None:
    heights = np.where((COLUMNS > 50) & (ROWS % 60 > 15), tall + 2 * crowns(), 0.0)
    found = seen(heights, np.zeros_like(heights) if tall else heights)
    assert found.covered.any()
    may = may_be(np.pad(heights, 4, constant_values=np.nan), 1.0)[4:-4, 4:-4]
    assert not (found.covered & ~may).any()


def test_ground_in_openings_of_tall_crowns_stays_and_is_covered() -> None:
    tall = 9.0 + 2 * crowns()
    glimpse = (ROWS % 20 < 3) & (COLUMNS % 20 < 3)
    found = seen(np.where(glimpse, 0.0, tall), np.zeros_like(tall))
    assert found.covered.mean() > 0.95
    assert not found.crowns.any()


def pits_in_a_wood(rounds: int, beyond: int = SIDE) -> np.ndarray:
    """Pits found in a wood of 12 m with a lawn, and with crowns that are ground with 0.1 m, 28 cells wide."""
    lawn = (abs(ROWS - 80) < 20) & (abs(COLUMNS - 80) < 20)
    climbed = (abs(ROWS - 80) < 14) & (abs(COLUMNS - 130) < 14)
    heights = np.where(lawn, 0.0, 12.0 + crowns())
    surface = np.where(climbed, heights - 0.1, 0.0)
    ground = lawn | climbed
    far = np.hypot(ROWS - 80, COLUMNS - 130) > beyond
    heights[far], ground[far], surface[far] = 50.0, True, 50.0
    return pits(heights, surface, ground, ~ground, 1.0, rounds)


def test_crowns_that_are_ground_are_pits_from_their_edge_inwards() -> None:
    climbed = (abs(ROWS - 80) < 14) & (abs(COLUMNS - 130) < 14)
    once, often = pits_in_a_wood(1), pits_in_a_wood(PIT_ROUNDS)
    assert 0 < once[climbed].mean() < 1
    assert often[climbed].all()
    assert not often[~climbed].any()


def middle_of_a_wood(far_trees: float, lawn: bool = False) -> np.ndarray:
    """Pits found where the surface is 4 m below crowns, and a lawn in the north, if wanted, 20 m below them."""
    climbed = (abs(ROWS - 80) < 9) & (abs(COLUMNS - 80) < 9)
    land = (ROWS > 115) & lawn
    heights = np.where(land, -20.0, np.where(climbed, -4.0, crowns()))
    ground = climbed | land
    return pits(heights, np.where(ground, heights, -20.0), ground, ~ground, 1.0, 1, far_trees)[
        climbed
    ]


@pytest.mark.parametrize(("far_trees", "lawn"), [(20.0, False), (0.0, True)])
def test_in_the_middle_of_a_wood_the_height_of_trees_comes_from_land_farther_away(
    far_trees: float, lawn: bool
) -> None:
    assert not middle_of_a_wood(0.0).any()
    assert middle_of_a_wood(far_trees, lawn).mean() > 0.4


def test_low_trees_far_away_do_not_make_crowns_ground() -> None:
    near = middle_of_a_wood(0.0, lawn=True)
    assert np.array_equal(middle_of_a_wood(5.0, lawn=True), near)


def test_cells_beyond_the_reach_of_pits_have_no_part() -> None:
    found = pits_in_a_wood(PIT_ROUNDS)
    changed = pits_in_a_wood(PIT_ROUNDS, pit_reach_cells(1.0, PIT_ROUNDS))
    assert found[80, 130]
    assert changed[80, 130]


def test_nothing_beyond_the_reach_has_a_part() -> None:
    heights = crowns()
    heights[50:82, 60:100] = 0.0
    reach = reach_cells(1.0)
    wide = np.tile(heights, (3, 3))
    other = wide.copy()
    middle = wide.shape[0] // 2
    beyond = np.ones(wide.shape, np.bool_)
    beyond[middle - reach : middle + reach + 1, middle - reach : middle + reach + 1] = False
    other[beyond] = 0.0
    first, second = (seen(z, z) for z in (wide, other))
    assert np.isfinite(first.land_depths[middle, middle])
    for before, after in zip(first, second, strict=True):
        assert before[middle, middle] == after[middle, middle]


def test_the_place_of_a_raster_changes_no_bit() -> None:
    heights = crowns() + 300.0 + 0.3 * ROWS
    whole, part = seen(heights, heights), seen(heights[8:], heights[8:])
    reach = reach_cells(1.0)
    for before, after in zip(whole, part, strict=True):
        assert np.array_equal(before[8 + reach :], after[reach:], equal_nan=True)
