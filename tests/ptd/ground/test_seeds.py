"""Seeds: lowest points of cells, virtual points around them, and uncertified cells."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.frame import OPEN, CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.ground.densify import RING, Seeds, box_with_ring, choose_seeds

SIDE = 20_000
Point = tuple[int, int, int]


def choose(
    points: list[Point],
    known: Window | None = None,
    eligible: list[bool] | None = None,
    scale: Scale | None = None,
    uncertified: list[bool] | None = None,
) -> tuple[Seeds, UncertifiedRegion]:
    scale = scale or Scale()
    x, y, z = np.ascontiguousarray(np.array(points, np.int32).T)
    cells = CellLattice.of(SIDE / 1000, scale)
    known = known or Window.everything()
    region = UncertifiedRegion(
        known, known.inside(cells, RING), box_with_ring(x, y, cells), scale
    )
    mask = np.ones(x.size, np.bool_) if eligible is None else np.array(eligible)
    which = None if uncertified is None else np.array(uncertified)
    return choose_seeds(x, y, z, mask, cells, region, which), region


def cells_of(seeds: Seeds) -> dict[tuple[int, int], int]:
    """Heights of the virtual seeds by column and row; they lie in the middle."""
    assert ((seeds.virtual[:, :2] - SIDE // 2) % SIDE == 0).all()
    return {(int(x) // SIDE, int(y) // SIDE): int(z) for x, y, z in seeds.virtual}


def middle(column: int, row: int, z: int = 0) -> Point:
    return column * SIDE + SIDE // 2 + 11, row * SIDE + SIDE // 2 - 7, z


def test_the_lowest_eligible_point_of_each_cell() -> None:
    points = [(100, 100, 5), (200, 100, 3), (300, 100, 1), (SIDE, 0, 9), (SIDE - 1, 0, 4)]
    seeds, _ = choose(points, eligible=[True, True, False, True, True])
    assert seeds.chosen.tolist() == [1, 3]


def test_cells_are_anchored_at_coordinate_0() -> None:
    points = [(0, 0, 5), (999, 0, 3), (1000, 0, 4)]
    seeds, _ = choose(points, scale=Scale(origin=(SIDE - 1000, 0)))
    assert seeds.chosen.tolist() == [1, 2]


def test_one_cell_has_two_rings_of_its_height() -> None:
    seeds, _ = choose([middle(0, 0, 70)])
    ring = cells_of(seeds)
    assert set(ring) == {(c, r) for c in range(-2, 3) for r in range(-2, 3)} - {(0, 0)}
    assert set(ring.values()) == {70}


def test_heights_of_the_ring_by_hand() -> None:
    """Two cells side by side: what touches both takes the mean, then the next layer the mean of the first."""
    ring = cells_of(choose([middle(0, 0, 100), middle(1, 0, 201)])[0])
    assert len(ring) == 5 * 6 - 2
    assert ring[-1, 0] == 100
    assert ring[2, 1] == 201
    assert ring[0, 1] == ring[1, -1] == 301 // 2
    # Second layer, above the left cell: its neighbours in the first are (-1, 1): 100, (0, 1)
    # and (1, 1): 150.
    assert ring[0, 2] == (100 + 150 + 150) // 3
    assert ring[-2, 2] == 100
    assert ring[3, 0] == 201


def test_a_hole_is_filled_from_all_sides() -> None:
    around = [(c, r) for c in range(3) for r in range(3) if (c, r) != (1, 1)]
    ring = cells_of(choose([middle(c, r, 10 * k) for k, (c, r) in enumerate(around)])[0])
    assert ring[1, 1] == sum(10 * k for k in range(8)) // 8


def test_nothing_is_uncertified_where_everything_is_known() -> None:
    _, region = choose([middle(0, 0), middle(5, 3)])
    assert not region.active
    assert not region.mask.any()


def is_uncertified(region: UncertifiedRegion, column: int, row: int) -> bool:
    """Whether the middle of a cell is uncertified; no cell is so by half."""
    x, y = column * SIDE - region.west, row * SIDE - region.south
    step = SIDE // region.cell
    block = region.mask[y // region.cell :, x // region.cell :][:step, :step]
    assert block.all() or not block.any()
    return bool(block.all())


@pytest.mark.parametrize("cut", [0, 1, SIDE - 1])
def test_uncertified_cells_at_a_closed_side(cut: int) -> None:
    """The west side cuts column 0 (or lies on its edge): filled cells are certain where all of them is known."""
    row = [middle(c, 0, 10) for c in range(10) if c not in (2, 7)]
    _, region = choose(row, Window(cut, -OPEN, OPEN, OPEN))
    first = 0 if cut == 0 else 1
    assert is_uncertified(region, first - 1, 0)
    for column in range(first, first + 8):
        empty = column in (2, 7)
        assert is_uncertified(region, column, 0) == (empty and column < first + RING)
        # Above the row all cells are empty: those near the side could get another height from a
        # point beyond it.
        assert is_uncertified(region, column, 1) == (column < first + RING)
        assert is_uncertified(region, column, -2) == (column < first + RING)


def test_uncertified_cells_at_the_other_sides() -> None:
    points = [middle(c, r, 10) for c in range(8) for r in range(8) if (c, r) != (6, 5)]
    _, region = choose(points, Window(-OPEN, -OPEN, 8 * SIDE, 8 * SIDE - 1))
    assert is_uncertified(region, 6, 5)
    assert is_uncertified(region, 4, 7)
    assert not is_uncertified(region, 7, 6)
    assert is_uncertified(region, 8, 3)
    assert not is_uncertified(region, -1, 3)


def test_cells_that_may_lose_their_seed_are_uncertified_and_so_are_empty_ones_around_them() -> (
    None
):
    """A row of cells: in column 4 it is not certain what is eligible; in column 5 neither, but another seed is sure."""
    row = [middle(c, 0, 10) for c in range(12) if c != 7]
    points = [*row, (5 * SIDE + 100, 100, 50)]
    uncertified = [x // SIDE == 4 or (x // SIDE == 5 and z == 10) for x, _, z in points]
    far = Window(-900 * SIDE, -OPEN, OPEN, OPEN)
    _, region = choose(points, far, uncertified=uncertified)
    assert [column for column in range(12) if is_uncertified(region, column, 0)] == [4, 7]
    assert [column for column in range(12) if is_uncertified(region, column, 1)] == [
        2,
        3,
        4,
        5,
        6,
        7,
    ]


def test_the_box_holds_three_cells_around_the_data() -> None:
    x, y = np.array([0, 1], np.int32), np.array([SIDE, SIDE], np.int32)
    assert box_with_ring(x, y, CellLattice.of(20.0, Scale())) == (
        -3 * SIDE,
        -2 * SIDE,
        4 * SIDE,
        5 * SIDE,
    )
