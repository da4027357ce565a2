"""Islands of ground on roofs go; terraces, walls, rocks, courtyards and glimpses below crowns stay."""

from __future__ import annotations

import numpy as np
import pytest

import ptd
from ptd.frame import Scale
from ptd.matched import objects as module
from ptd.matched.cells import EMPTY
from ptd.matched.objects import _surroundings, island_reach_cells, islands, without_islands
from ptd.matched.surface import Surface

MM = Scale()
SIDE = 150
ROW, COLUMN = np.mgrid[:SIDE, :SIDE]
HALL = (abs(ROW - 75) < 27) & (abs(COLUMN - 75) < 38)
PITS = ((50, 45, 3, 3), (74, 73, 4, 5), (97, 110, 1, 1), (60, 85, 2, 4))
"""South-west corner, rows and columns."""


def pits() -> np.ndarray:
    found = np.zeros((SIDE, SIDE), bool)
    for row, column, rows, columns in PITS:
        found[row : row + rows, column : column + columns] = True
    return found


def of(z: np.ndarray, ground: np.ndarray, cell_m: float = 1.0) -> np.ndarray:
    heights = np.where(np.isnan(z), EMPTY, np.rint(1000 * np.nan_to_num(z))).astype(np.int32)
    return islands(heights, ground, MM, cell_m)


@pytest.mark.parametrize("depth", [0.0, 1.5, 2.5])
@pytest.mark.parametrize("slope", [0.0, 0.04])
def test_pits_in_a_hall_are_islands(depth: float, slope: float) -> None:
    z = slope * ROW + np.where(HALL, 9.0, 0.0) - np.where(pits(), depth, 0.0)
    assert np.array_equal(of(z, ~HALL | pits()), pits())


def test_islands_of_one_roof_are_not_ground_for_each_other() -> None:
    grid = HALL & (ROW % 13 == 0) & (COLUMN % 13 == 0)
    assert grid.sum() == 24
    assert np.array_equal(of(np.where(HALL, 9.0, 0.0), ~HALL | grid), grid)


def test_a_courtyard_is_no_island() -> None:
    z = np.where(HALL & ~pits(), 9.0, 0.0)
    assert not of(z, ~HALL | pits()).any()


def test_a_terrace_whose_wall_and_surroundings_are_lost_is_no_island() -> None:
    terrace = (abs(ROW - 75) < 12) & (abs(COLUMN - 75) < 12)
    lost = (abs(ROW - 75) < 16) & (abs(COLUMN - 75) < 16) & ~terrace
    assert not of(np.where(terrace | lost, 4.0, 0.0), ~lost).any()


def test_rocks_and_tops_of_walls_are_no_islands() -> None:
    rock, wall = (
        np.hypot(ROW - 40, COLUMN - 40) < 4,
        (abs(ROW - 100) < 2) & (abs(COLUMN - 75) < 40),
    )
    z = np.where(rock, 5.0, np.where(wall, 3.0, 0.0))
    faces = (ROW == 102) & wall | rock & (COLUMN == 40)
    assert not of(z, ~faces).any()


def test_a_glimpse_of_a_hill_below_crowns_is_no_island() -> None:
    hill = 12.0 * np.exp(-((ROW - 75.0) ** 2 + (COLUMN - 75.0) ** 2) / 700.0)
    wood = np.hypot(ROW - 75, COLUMN - 75) < 30
    glimpse = np.hypot(ROW - 75, COLUMN - 75) < 2
    assert not of(hill + np.where(wood & ~glimpse, 9.0, 0.0), ~wood | glimpse).any()
    assert np.array_equal(
        of(hill + np.where(wood & ~glimpse, 1.0, 0.0), ~wood | glimpse), glimpse
    )


def test_a_wide_part_of_a_roof_is_no_island() -> None:
    """Whether a wide roof is an object is decided by its rim, not by its cells."""
    part = HALL & (ROW > 80)
    assert not of(np.where(HALL, 9.0, 0.0), ~HALL | part).any()


def test_cells_of_2_m_find_the_same_roof() -> None:
    hall = (abs(ROW - 75) < 14) & (abs(COLUMN - 75) < 19)
    pit = (abs(ROW - 70) < 2) & (abs(COLUMN - 80) < 2)
    z = np.where(hall, 9.0, 0.0) - np.where(pit, 2.0, 0.0)
    assert np.array_equal(of(z, ~hall | pit, cell_m=2.0), pit)


def test_around_an_island_only_ground_stays_ground() -> None:
    """The surface was continued from the pit over the roof, 3 m far; no other cell changes."""
    heights = np.rint(1000 * np.where(HALL, 9.0, 0.0)).astype(np.int32)
    left = np.where(HALL & ~pits(), EMPTY, heights).astype(np.int32)
    surface = Surface(heights / 1000, np.full(HALL.shape, 0.05), np.ones(HALL.shape))
    found = without_islands(surface, left, heights, MM, 1.0)
    gone = np.isnan(found.narrowing)
    assert gone[pits()].all()
    assert gone[49:56, 42:51].all()
    assert not gone[~HALL].any()
    assert not gone[54:94, 95:105].any()
    assert found.height is surface.height
    assert without_islands(surface, np.where(HALL, EMPTY, heights), heights, MM, 1.0) is surface


def test_surroundings_are_those_of_a_slow_count() -> None:
    rng = np.random.default_rng(5)
    heights = np.where(
        rng.random((30, 40)) < 0.2, EMPTY, rng.integers(0, 6000, (30, 40))
    ).astype(np.int32)
    ground = (heights != EMPTY) & (rng.random((30, 40)) < 0.4)
    surface = np.where(
        ground & (rng.random((30, 40)) < 0.2), rng.integers(0, 3, (30, 40)), -1
    ).astype(np.int32)
    expected = np.zeros((3, 3), np.int64)
    for row, column in np.argwhere(surface >= 0):
        box = np.s_[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        there, rise = heights[box] != EMPTY, heights[box].astype(int) - heights[row, column]
        level = there & ~ground[box] & (rise >= -1500) & (rise <= 3000)
        expected[surface[row, column]] += [there.sum(), ground[box].sum(), level.sum()]
    counts, box = _surroundings(heights, ground, surface, 3, 2, 3000, 1500)
    assert np.array_equal(counts, expected)
    for number in range(3):
        rows, columns = np.nonzero(surface == number)
        assert box[number].tolist() == [rows.min(), rows.max(), columns.min(), columns.max()]


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_nothing_beyond_the_reach_has_a_part(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Nor has a surface that continues beyond it: it is too wide for an island, and for one that rays pass."""
    monkeypatch.setattr(module, "MAX_ISLAND_WIDTH_M", 16.0)
    monkeypatch.setattr(module, "VIEW_M", 12.0)
    rng, reach = np.random.default_rng(seed), island_reach_cells(1.0)
    side = 2 * reach + 70
    row, column = np.mgrid[:side, :side]
    roofs = (row % 40 < 24) & (column % 37 < 20)
    few = roofs & (rng.random(row.shape) < 0.02)
    z = np.where(roofs, 6.0, 0.0) + rng.uniform(0.0, 1.0, row.shape)
    heights = np.where(rng.random(row.shape) < 0.05, EMPTY, np.rint(1000 * z)).astype(np.int32)
    ground = (heights != EMPTY) & (~roofs | few)
    whole = islands(heights, ground, MM, 1.0)
    south, west = rng.integers(1, 40, 2)
    part = np.s_[south:-9, west:-17]
    cut = islands(heights[part], ground[part], MM, 1.0)
    rows, columns = cut.shape
    inner = np.s_[reach : rows - reach, reach : columns - reach]
    assert whole[part][inner].any()
    assert np.array_equal(cut[inner], whole[part][inner])


def test_no_point_of_a_hall_with_pits_is_ground() -> None:
    """A photogrammetric cloud of a hall of 76 m x 54 m on a gentle slope, with lower parts of 4 m in its roof.

    A terrace of 4 m with a wall stands next to it, and a rock of 3 m. Without `without_islands`
    these parts are ground.
    """
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0.0, (170.0, 130.0), (220_000, 2)).T
    hall = (abs(x - 65) < 38) & (abs(y - 65) < 27)
    terrace, rock = x > 135, np.hypot(x - 118, y - 20)
    corners = [(45, 52), (65, 65), (84, 78), (57, 79), (75, 47)]
    lower = np.any([(abs(x - a) < 2) & (abs(y - b) < 2.2) for a, b in corners], axis=0)
    z = (
        0.02 * x
        + np.where(hall, 9.0 - 2.4 * lower, 0.0)
        + 4.0 * terrace
        + 3.0 * np.maximum(1.0 - rock / 5.0, 0.0)
    )
    z += rng.normal(0.0, 0.05, x.size)
    labels = ptd.classify(np.stack([x, y, z], axis=1), kind="dim").classification
    inside = (abs(x - 65) < 36) & (abs(y - 65) < 25)
    assert not (labels[inside] == 2).any()
    assert (labels[terrace & (x > 137)] == 2).mean() > 0.99
    assert (labels[(rock < 5) & (rock > 1.5)] == 2).mean() > 0.9
    assert (labels[~hall & ~terrace & (rock > 6)] == 2).mean() > 0.98
