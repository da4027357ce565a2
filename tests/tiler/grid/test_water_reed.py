"""Reed in the water is water up to the position at which the slope of the bank behind it reaches the level."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from tiler.core.area import Area
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_level import heights_of_cells
from tiler.grid.water_plants import (
    CROWN_WITH_GROUND,
    HIDDEN,
    REED,
    among_reed,
    has_no_bank,
    plant_kinds,
)
from tiler.store import TileStore

ROWS, COLUMNS = np.mgrid[0:60, 0:60]
SHORE, WIDE = 30, 3
"""First column of land, and width of the reed before it in cells."""
CELL_M = 2.0
LEVEL = np.zeros(ROWS.shape)
WET = COLUMNS < SHORE - WIDE
IN_WATER = ~WET & (COLUMNS < SHORE)


def added(slope: float, reed: np.ndarray, rise: float = 0.0) -> np.ndarray:
    """Return the mask of the water in reed; the bank has this slope and stands 0.5 m above its line in reed."""
    bank = rise + slope * CELL_M * (COLUMNS - SHORE + 0.5)
    ground = np.where(WET, 0.0, np.where(reed, 0.5, bank))
    every = np.ones(ground.shape, np.bool_)
    cells = WaterCells(np.full(ground.shape, 8.0, np.float32), ~every, ground, every, CELL_M)
    return among_reed(cells, np.where(reed, REED, 0), WET, LEVEL)


@pytest.mark.parametrize("slope", [0.1, 0.25, 0.5])
def test_reed_is_water_up_to_the_shore(slope: float) -> None:
    np.testing.assert_array_equal(added(slope, IN_WATER), IN_WATER)


def test_reed_on_the_bank_is_land() -> None:
    """The bank rises by 0.5 m per cell, so only cells before the shore are up to 0.15 m above the level."""
    reed = IN_WATER | ((COLUMNS >= SHORE) & (COLUMNS < SHORE + 3))
    np.testing.assert_array_equal(added(0.25, reed), IN_WATER)


@pytest.mark.parametrize(
    ("slope", "rise", "reed"),
    [
        (0.0, 0.9, IN_WATER),  # plants on a level bank
        (0.25, 0.0, (COLUMNS >= SHORE + 2) & (COLUMNS < SHORE + 5)),  # crops behind the bank
    ],
)
def test_other_plants_stay_land(slope: float, rise: float, reed: np.ndarray) -> None:
    assert not added(slope, reed, rise).any()


def test_plants_far_from_a_bank_that_is_seen_are_land() -> None:
    """The bank is 15 cells from the water: what stands between them may be crops or reed."""
    reed = ~WET & (COLUMNS < SHORE + 12)
    assert not added(0.02, reed).any()


def test_the_ground_in_reed_is_no_bank_unless_it_is_as_low_as_the_water() -> None:
    crowns = np.array([REED, REED, CROWN_WITH_GROUND, HIDDEN, HIDDEN + REED])
    above = np.array([0.5, 0.1, 0.5, 0.5, 0.1])
    np.testing.assert_array_equal(has_no_bank(crowns, above), [True, False, False, True, True])


@pytest.mark.parametrize(
    ("low", "high", "is_reed"),
    [(300, 2000, True), (900, 950, False), (300, 9000, False)],
    ids=["reed", "a pontoon", "trees"],
)
def test_reed_is_low_and_rough_and_its_lowest_points_may_be_ground(
    low: int, high: int, is_reed: bool
) -> None:
    """Eight points per cell of 2 m, of which the lowest fifth counts as ground."""
    x, y, z = (
        np.random.default_rng(3).integers((0, 0, low), (40_000, 40_000, high), (3200, 3)).T
    )
    xyz = np.stack((x, y, z)).astype(np.int32)
    objects = z > low + (high - low) // 5
    kinds = plant_kinds(
        xyz, y // 2000 * 20 + x // 2000, objects, np.full((20, 20), 0.4), Fraction(1, 1000)
    )
    assert ((kinds >= REED).mean() > 0.9) == is_reed
    assert ((kinds >= REED).mean() < 0.1) != is_reed


def test_returns_of_reed_give_no_level(small_store: TileStore) -> None:
    """Reed stands 0.5 m above the water over half of a lake of 40 by 40 cells."""
    cell = 2000
    spec = RasterSpec(Lattice(Fraction(cell)), 0, BLOCK_PIXELS, BLOCK_PIXELS, BLOCK_PIXELS)
    block = spec.block_at(0, 0, BLOCK_PIXELS)
    reed = np.tile(np.arange(BLOCK_PIXELS) < 120, (BLOCK_PIXELS, 1))
    rasters = {
        "dtm": np.full(reed.shape, 12.0),
        "occupancy": np.full(reed.shape, 8.0),
        "ground": np.where(reed, 10.5, 10.0),
        "crowns": np.where(reed, REED, 0),
    }
    for name, values in rasters.items():
        small_store.create_raster(name, spec, 0.0)
        small_store.write_block(name, block, values.astype(np.float32))
    top = (BLOCK_PIXELS - 100) * cell
    area = Area.rectangle(Bounds(100 * cell, top - 40 * cell, 140 * cell, top))
    within = heights_of_cells(small_store, area, spec, "occupancy", "ground", "crowns")
    assert within.shape[1] > 500
    assert set(within[2].tolist()) == {10_000}
