"""Water beneath crowns reaches the ground of the bank, or the position at which the bank falls to the level."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.grid.water_cells import WaterCells
from tiler.grid.water_extent import remove_narrow_parts, without_border_islands
from tiler.grid.water_plants import CROWN_WITH_GROUND, HIDDEN, beneath_crowns, roughness
from tiler.grid.water_shore import MAX_HEIGHT_M, heights_above_water

ROWS, COLUMNS = np.mgrid[0:60, 0:60]
SHORE = 30
"""First column of land."""
CELL_M = 2.0


def cells(ground: np.ndarray, returns: np.ndarray | None = None) -> WaterCells:
    there = np.full(ground.shape, 20.0) if returns is None else returns
    no = np.zeros(ground.shape, np.bool_)
    return WaterCells(there.astype(np.float32), no, ground, ~no, CELL_M)


def scattered(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return counts x, y of 4,000 points and their cells: 20 by 20 cells of 2,000 counts."""
    x, y = np.random.default_rng(seed).integers(0, 40_000, (2, 4000))
    return np.stack((x, y)), y // 2000 * 20 + x // 2000


def test_a_plane_is_smooth_whatever_its_slope_and_a_crown_is_rough() -> None:
    (x, y), numbers = scattered()
    roof = np.stack((x, y, 5000 + x // 2 - y)).astype(np.int32)
    assert np.nanmax(roughness(roof, numbers, 400)) < 1
    crown = roof.copy()
    crown[2] += np.random.default_rng(2).integers(0, 6000, 4000).astype(np.int32)
    assert np.nanmedian(roughness(crown, numbers, 400)) == pytest.approx(
        6000 / 12**0.5, rel=0.2
    )


def test_roughness_does_not_depend_on_the_order_of_points_and_needs_four() -> None:
    (x, y), numbers = scattered()
    points = np.stack((x, y, np.random.default_rng(3).integers(-9000, 9000, 4000))).astype(
        np.int32
    )
    order = np.random.default_rng(4).permutation(4000)
    np.testing.assert_array_equal(
        roughness(points, numbers, 400), roughness(points[:, order], numbers[order], 400)
    )
    assert np.isnan(roughness(points[:, :3], np.zeros(3, np.int64), 2)).all()


def crowns_over(reach: int) -> np.ndarray:
    """Return plants from ``reach`` cells before the shore to 4 cells behind it, with ground on land alone."""
    plants = (SHORE - reach <= COLUMNS) & (COLUMNS < SHORE + 4)
    return np.where(plants, np.where(COLUMNS < SHORE, HIDDEN, CROWN_WITH_GROUND), 0)


LEVEL = np.zeros(ROWS.shape)


def test_water_beneath_crowns_reaches_a_quay() -> None:
    crowns = crowns_over(4)
    wet = COLUMNS < SHORE - 4
    added = beneath_crowns(cells(np.where(COLUMNS < SHORE, 0.4, 1.0)), crowns, wet, LEVEL)
    np.testing.assert_array_equal(added, crowns == HIDDEN)


def test_water_beneath_crowns_ends_where_a_slope_reaches_the_level() -> None:
    """The last ground is seen 1 m above the water, and falls by 0.5 m a cell: the shore is 2 cells on."""
    crowns = crowns_over(6)
    wet = COLUMNS < SHORE - 6
    ground = 1.0 + 0.5 * (COLUMNS - SHORE)
    added = beneath_crowns(cells(ground), crowns, wet, LEVEL)
    np.testing.assert_array_equal(added, (crowns == HIDDEN) & (COLUMNS <= SHORE - 2))


@pytest.mark.parametrize("hidden_land", [1, 2])
def test_land_without_ground_among_land_with_ground_stays(hidden_land: int) -> None:
    crowns = crowns_over(4)
    hole = (np.abs(ROWS - 30) <= hidden_land) & (COLUMNS >= SHORE) & (COLUMNS < SHORE + 4)
    crowns[hole] = HIDDEN
    wet = COLUMNS < SHORE - 4
    added = beneath_crowns(cells(np.where(COLUMNS < SHORE, 0.4, 1.0)), crowns, wet, LEVEL)
    assert not added[hole & (COLUMNS > SHORE + 1)].any()


def test_crowns_that_hide_the_ground_on_land_too_show_nothing() -> None:
    crowns = np.where(crowns_over(4) > 0, HIDDEN, 0)
    wet = COLUMNS < SHORE - 4
    assert not beneath_crowns(cells(np.full(ROWS.shape, 1.0)), crowns, wet, LEVEL).any()


def test_an_arm_that_the_border_of_the_survey_cuts_is_not_narrow() -> None:
    beyond = ROWS < 10
    corner = ~beyond & (ROWS + COLUMNS < 24)
    assert (remove_narrow_parts(corner, 12.0, beyond) & corner).sum() > 0.7 * corner.sum()
    assert remove_narrow_parts(corner, 12.0, np.zeros_like(beyond)).sum() < 0.3 * corner.sum()


@pytest.mark.parametrize(
    ("rise", "wide", "is_water"),
    # a higher tide, a bank, more than a small island
    [(0.5, 2, True), (1.2, 2, False), (0.5, 15, False)],
)
def test_low_flat_land_at_the_border_is_water(rise: float, wide: int, is_water: bool) -> None:
    notch = (ROWS >= 20) & (ROWS < 24) & (np.abs(COLUMNS - 30) <= wide)
    given = cells(np.where(notch, rise, 0.0))
    given.domain[ROWS < 20] = False
    filled = without_border_islands(given, given.domain & ~notch, LEVEL, 60)
    assert filled[notch].all() == is_water
    assert not filled[~given.domain].any()


def test_sloping_land_at_the_border_is_a_bank() -> None:
    notch = (ROWS >= 20) & (ROWS < 24) & (np.abs(COLUMNS - 30) <= 2)
    given = cells(np.where(notch, 0.2 * (24 - ROWS) - 0.1, 0.0))
    given.domain[ROWS < 20] = False
    assert not without_border_islands(given, given.domain & ~notch, LEVEL, 60)[notch].any()


def shore_of(ground: np.ndarray, in_first_cell: float = 20.0) -> float:
    """Return the column at which `heights_above_water` has the shore, for water up to `SHORE` at the level 0.

    The cells of land have 20 returns, but the first ones ``in_first_cell``.
    """
    wet = COLUMNS < SHORE
    returns = np.where(wet, 0.0, np.where(COLUMNS == SHORE, in_first_cell, 20.0))
    field = heights_above_water(cells(ground, returns), wet, LEVEL)[30]
    assert field.min() == -MAX_HEIGHT_M
    return float(np.interp(0.0, field[SHORE - 2 : SHORE + 3], np.arange(SHORE - 2, SHORE + 3)))


def test_the_shore_of_a_quay_is_between_cells_and_that_of_a_slope_where_it_reaches_the_level() -> (
    None
):
    assert shore_of(np.full(ROWS.shape, 0.9)) == pytest.approx(SHORE - 0.5)
    assert shore_of(0.6 * (COLUMNS - SHORE + 0.8)) == pytest.approx(SHORE - 0.8, abs=0.02)


@pytest.mark.parametrize(("returns", "shore"), [(4, SHORE + 0.5), (15, SHORE - 0.5)])
def test_a_cell_of_a_quay_with_few_returns_is_mostly_water(
    returns: float, shore: float
) -> None:
    assert shore_of(np.full(ROWS.shape, 0.9), returns) == pytest.approx(shore)


@pytest.mark.parametrize(
    "ground", [np.full(ROWS.shape, 0.2), 0.6 * (COLUMNS - SHORE + 0.8)], ids=["low", "slope"]
)
def test_a_cell_of_a_low_or_sloping_bank_with_few_returns_is_land(ground: np.ndarray) -> None:
    assert shore_of(ground, 4.0) == shore_of(ground, 20.0)
