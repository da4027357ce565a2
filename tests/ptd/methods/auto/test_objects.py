"""Rules on hand-made rasters: what rises like an object, and that nothing beyond the reach has a part in it."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.frame import CellLattice, Scale
from ptd.methods.auto.cells import Drop, Lowest, Residuals, Shape

SCALE, CELLS = Scale(), CellLattice.of(1.0, Scale())
SEEDS = Drop(0.1, 0.06, 0.2)
SHAPE = Shape(radius=9, slope=3)
RESIDUALS = Residuals(
    Drop(0.3, 0.1, 0.2), trend=8, radius=4, slope=3, around=5, lack=2.0, enough=0.2
)
ROWS, COLUMNS = np.mgrid[0:60, 0:70]


def lowest(heights: np.ndarray) -> Lowest:
    """A point in the middle of each cell, metres."""
    rows, columns = np.indices(heights.shape).reshape(2, -1)
    x, y = (1000 * columns + 500).astype(np.int32), (1000 * rows + 500).astype(np.int32)
    return Lowest(x, y, np.rint(1000 * heights).astype(np.int32).ravel(), CELLS, 1.0, SCALE)


def steep(heights: np.ndarray, drop: Drop = SEEDS) -> np.ndarray:
    every = np.ones(heights.size, bool)
    return lowest(heights).steep_objects(every, drop, SHAPE).reshape(heights.shape)


def residual(
    heights: np.ndarray, ground: np.ndarray, rule: Residuals = RESIDUALS
) -> np.ndarray:
    every = np.ones(heights.size, bool)
    return lowest(heights).residual_objects(ground.ravel(), every, rule).reshape(heights.shape)


def box(rows: slice, columns: slice, height: float) -> np.ndarray:
    heights = np.zeros(ROWS.shape)
    heights[rows, columns] = height
    return heights


@pytest.mark.parametrize(("height", "found"), [(0.27, False), (0.29, True), (9.0, True)])
def test_a_box_of_five_cells_goes_with_the_disk_of_three(height: float, found: bool) -> None:
    """The disk of radius 2 fits but for its corners; (0.28 - 0.1) / 3 is the threshold of flat ground."""
    heights = box(slice(20, 25), slice(30, 35), height)
    assert steep(heights)[22, 32] == found
    assert not steep(heights)[heights == 0].any()


def test_what_is_wider_than_the_largest_disk_stays() -> None:
    wide = box(slice(10, 50), slice(10, 50), 5.0)
    assert not steep(wide)[25:35, 25:35].any()
    narrow = box(slice(10, 50), slice(10, 26), 5.0)
    assert steep(narrow)[narrow > 0].all()


@pytest.mark.parametrize("slope", [0.2, 1.0, 3.0])
def test_a_plane_holds_no_object(slope: float) -> None:
    assert not steep(slope * ROWS)[10:-10, 10:-10].any()


def test_the_threshold_grows_with_the_slope() -> None:
    """A box of 0.6 m: 0.5 / 3 is above 0.06 and below 0.06 + 0.2 * 0.8."""
    low = box(slice(20, 25), slice(30, 35), 0.6)
    assert steep(low)[22, 32]
    assert not steep(low + 0.8 * ROWS)[22, 32]


def test_only_chosen_points_are_the_surface() -> None:
    heights = box(slice(20, 25), slice(30, 35), 3.0)
    heights[20:25, 20:25] = -8.0  # low noise would make its surroundings rise
    low = lowest(heights)
    found = low.steep_objects(heights.ravel() > -1, SEEDS, SHAPE).reshape(heights.shape)
    assert found[22, 32]
    assert not found[heights == 0].any()


def test_a_low_wall_on_a_slope_is_seen_without_the_trend() -> None:
    """0.9 m on a slope of 0.8: (0.9 - 0.3) / 1 is above 0.1 + 0.2 * 0.8, if there are objects around."""
    wall = box(slice(28, 30), slice(25, 45), 0.9) + 0.8 * ROWS
    ground = np.ones(wall.shape, bool)
    ground[::2, ::2] = False  # a quarter of the cells
    assert not steep(wall)[28:30, 30:40].any()
    assert residual(wall, ground)[28:30, 30:40].all()
    assert not residual(wall, ground)[:20].any()


def test_without_objects_around_a_bump_is_terrain() -> None:
    bump = box(slice(28, 30), slice(25, 45), 0.9) + 0.8 * ROWS
    assert not residual(bump, np.ones(bump.shape, bool)).any()
    assert residual(box(slice(28, 30), slice(25, 45), 5.0), np.ones(bump.shape, bool))[
        28:30, 27:43
    ].all()


def test_the_lack_of_objects_by_hand() -> None:
    ground = np.ones(ROWS.shape, bool)
    ground[30, 30:40] = False
    low = lowest(np.zeros(ROWS.shape))
    lack = low.lack_of_objects(ground.ravel(), RESIDUALS).reshape(ROWS.shape)
    assert lack[30, 35] == pytest.approx(1 - 10 / 121 / 0.2)  # all ten are among 11 x 11
    assert lack[30, 26] == pytest.approx(1 - 2 / 121 / 0.2)
    assert lack[0, 0] == 1.0
    ground[25:40] = False
    assert low.lack_of_objects(ground.ravel(), RESIDUALS).reshape(ROWS.shape)[30, 35] == 0.0


def test_where_no_ground_is_near_nothing_is_residual() -> None:
    heights = box(slice(20, 50), slice(20, 50), 4.0)
    ground = np.zeros(heights.shape, bool)
    assert not residual(heights, ground).any()


def rough(seed: int, side: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    heights = rng.normal(0, 1.0, (side, side)) + 6 * (rng.random((side, side)) < 0.1)
    return heights, rng.random((side, side)) < 0.7


@pytest.mark.parametrize("seed", range(3))
def test_nothing_beyond_the_reach_has_a_part(seed: int) -> None:
    """The reach is that of slopes of openings; and that of residuals' openings, whose cells have their trend."""
    shape = Shape(radius=4, slope=2)
    rule = Residuals(
        Drop(0.3, 0.1, 0.2), trend=5, radius=3, slope=2, around=4, lack=0.3, enough=0.5
    )
    assert (shape.reach, rule.reach) == (12, 11)
    heights, ground = rough(seed, 60)
    low = lowest(heights)
    whole = low.steep_objects(ground.ravel(), SEEDS, shape).reshape(60, 60)
    left = low.residual_objects(ground.ravel(), np.ones(3600, bool), rule).reshape(60, 60)
    assert 0.05 < whole.mean() < 0.95
    assert 0.05 < left.mean() < 0.95
    for reach, expected in ((shape.reach, whole), (rule.reach, left)):
        part = np.s_[25 - reach : 36 + reach, 20 - reach : 31 + reach]
        inner = np.s_[reach:-reach, reach:-reach]
        cut, chosen = lowest(heights[part]), ground[part].ravel()
        by_slope = cut.steep_objects(chosen, SEEDS, shape)
        by_trend = cut.residual_objects(chosen, np.ones(chosen.size, bool), rule)
        found = (by_slope if reach == shape.reach else by_trend).reshape(heights[part].shape)
        assert np.array_equal(found[inner], expected[25:36, 20:31])


def test_a_cell_is_outvoted_by_the_cells_at_its_height() -> None:
    """Against the definition, cell by cell, on ground with steps and gaps."""
    rng = np.random.default_rng(6)
    heights = np.where(COLUMNS[:40, :50] > 24, 1.3, 0.0) + rng.normal(0, 0.2, (40, 50))
    before, stays = rng.random((2, *heights.shape)) < [[[0.8]], [[0.5]]]
    stays &= before
    found = lowest(heights).outvoted(before.ravel(), stays.ravel(), 2).reshape(heights.shape)
    millimetres = np.rint(1000 * heights)
    for row, column in np.ndindex(heights.shape):
        square = np.s_[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        level = abs(millimetres[square] - millimetres[row, column]) <= 300
        votes = int((level & before[square]).sum()) - 1
        against = int((level & before[square] & ~stays[square]).sum())
        outvoted = stays[row, column] and votes >= 3 and against >= 0.75 * votes
        assert found[row, column] == outvoted
    assert 0 < found.sum() < stays.sum() / 2


@pytest.mark.parametrize("height", [1.2, 2.6])
def test_annexes_are_found_beside_roofs_only(height: float) -> None:
    """A part of 7 cells beside a hall without ground; a bank as high, and wider than an object, at its other side."""
    heights = box(slice(10, 35), slice(20, 50), 8.0)
    annex, bank = np.s_[35:42, 25:45], np.s_[:10, :]
    heights[annex] = heights[bank] = height
    roofs = (heights == 8.0).ravel()
    rule = Residuals(Drop(0.2, 0.1, 0.2), 20, 6, 3, 15, 2.0, 0.3)
    found = lowest(heights).annexes(~roofs, roofs, rule, 8).reshape(heights.shape)
    assert found[annex].all()
    found[annex] = False
    assert not found.any()


def test_without_roofs_there_are_no_annexes() -> None:
    heights = box(slice(20, 25), slice(30, 35), 2.0)
    ground = np.ones(heights.size, bool)
    rule = Residuals(Drop(0.2, 0.1, 0.2), 20, 6, 3, 15, 2.0, 0.3)
    assert not lowest(heights).annexes(ground, ~ground, rule, 8).any()
