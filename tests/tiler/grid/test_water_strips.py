"""The shore of a lake that two strips show at two levels lies where the bank reaches the lower level."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.grid.water_cells import WaterCells
from tiler.grid.water_shore import bank_rises, heights_above_water, lower_level

ROWS, COLUMNS = np.mgrid[0:60, 0:60]
SHORE = 30
"""First column of land."""
CELL_M = 2.0


def two_levels(apart: float) -> np.ndarray:
    return np.repeat([94.0, 94.0 + apart], 50)


@pytest.mark.parametrize(
    ("apart", "rise", "level"),
    [
        (0.4, 0.5, 94.0),
        (0.2, 0.5, None),  # waves
        (0.6, 0.1, None),  # a beach, of which the lower part was not seen
    ],
)
def test_the_lower_level_counts_if_the_bank_is_steep_enough(
    apart: float, rise: float, level: float | None
) -> None:
    wet = (np.abs(ROWS - 30) < 20) & (np.abs(COLUMNS - 30) < 20)
    distance = np.maximum(np.abs(ROWS - 30), np.abs(COLUMNS - 30)) - 20.0
    rises = bank_rises(94.0 + rise * distance, wet, wet)
    np.testing.assert_allclose(rises, rise)
    assert lower_level(two_levels(apart), rises) == level


def test_the_border_of_a_block_is_no_bank() -> None:
    """Rises next to the water of both halves are those of the whole."""
    wet = (np.abs(ROWS - 30) < 20) & (np.abs(COLUMNS - 30) < 20)
    ground = np.where(wet, 94.0, 94.0 + 0.01 * ROWS + 0.03 * COLUMNS)
    parts = [bank_rises(ground, wet, wet & half) for half in (COLUMNS < 30, COLUMNS >= 30)]
    np.testing.assert_array_equal(
        np.sort(np.concatenate(parts)), np.sort(bank_rises(ground, wet, wet))
    )


def test_too_few_heights_show_no_lower_level() -> None:
    assert lower_level(np.array([94.0, 94.5]), np.full(9, 0.5)) is None
    assert lower_level(two_levels(0.4), np.empty(0)) is None


@pytest.mark.parametrize("lower", [0.4, 0.6])
def test_the_shore_lies_where_the_bank_reaches_the_lower_level(lower: float) -> None:
    """The bank rises by 0.5 m per cell from the seen water, which has a margin of half a cell on land."""
    wet = COLUMNS < SHORE
    every = np.ones(wet.shape, np.bool_)
    ground = np.where(wet, 0.0, 0.5 * (COLUMNS - SHORE + 0.5))
    cells = WaterCells(np.full(wet.shape, 8.0, np.float32), ~every, ground, every, CELL_M)
    field = heights_above_water(cells, wet, np.full(wet.shape, -lower), is_lowered=True)[30]
    last = int(np.flatnonzero(field < 0)[-1])
    found = last + field[last] / (field[last] - field[last + 1])
    assert found == pytest.approx(SHORE - 0.5 - lower / 0.5, abs=0.1)
