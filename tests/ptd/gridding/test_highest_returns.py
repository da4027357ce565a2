"""The highest returns, with and without support from their neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.gridding.above_ground import NOTHING, HighestReturns
from ptd.gridding.ground_cells import CellWindow

ROWS, COLUMNS = 6, 7


def highest_of(rows: int, columns: int) -> HighestReturns:
    """Pixels of 100 counts, with the corner in the north-west at (0, 0)."""
    return HighestReturns(
        CellWindow(100, 1, 0, -1, rows, columns), np.full(rows * columns, np.inf)
    )


def enter(highest: HighestReturns, cells: np.ndarray, places: np.ndarray) -> None:
    """Enter returns at places x, y (0 to 99) in their cells, with heights: int (3, n)."""
    rows, columns = np.divmod(cells, highest.columns)
    x, y, z = places
    xyz = np.array([100 * columns + x, -100 * (rows + 1) + y, z], np.int32)
    highest.add(xyz, np.ones(cells.size, np.bool_))


def surface(
    returns: list[tuple[int, int, int]], reach: int = 1, spike: float = 50.0
) -> np.ndarray:
    """Heights from (row, column, z), each return at a place of its own."""
    highest = highest_of(ROWS, COLUMNS)
    cells = np.array([r * COLUMNS + c for r, c, _ in returns], np.int64)
    xyz = (
        np.array([(i, 99 - i, z) for i, (_, _, z) in enumerate(returns)], np.int32)
        .reshape(-1, 3)
        .T
    )
    for part in (slice(0, None, 2), slice(1, None, 2)):
        enter(highest, cells[part], xyz[:, part])
    return highest.supported(reach, spike)[..., 2]


def flat(height: int = 0) -> list[tuple[int, int, int]]:
    return [(r, c, height) for r in range(ROWS) for c in range(COLUMNS)]


def test_the_highest_counts() -> None:
    heights = surface(flat() + [(2, 3, 40), (2, 3, 50), (2, 3, -9)])
    assert heights[2, 3] == 50
    heights[2, 3] = 0
    assert not heights.any()


def test_a_spike_gives_way_to_the_second() -> None:
    assert surface(flat() + [(2, 3, 900)])[2, 3] == 0
    assert surface(flat() + [(0, 0, 900), (0, 0, 30)])[0, 0] == 30


def test_two_in_one_pixel_or_side_by_side_support_each_other() -> None:
    assert surface(flat() + [(2, 3, 900), (2, 3, 860)])[2, 3] == 900
    beside = surface(flat() + [(2, 3, 900), (3, 4, 870)])
    assert (beside[2, 3], beside[3, 4]) == (900, 870)
    apart = flat() + [(2, 3, 900), (2, 5, 870)]
    assert surface(apart)[2, 3] == 0
    assert surface(apart, reach=2)[2, 3] == 900


def test_a_pixel_of_a_spike_alone_is_empty() -> None:
    returns = [r for r in flat() if r[:2] != (2, 3)] + [(2, 3, 900)]
    assert surface(returns)[2, 3] == NOTHING


def test_the_same_return_twice_supports_nothing() -> None:
    highest = highest_of(1, 2)
    xyz = np.array([[5, 5, 60], [5, 5, 60], [900, 900, 0]], np.int32)
    enter(highest, np.array([0, 0, 1]), xyz)
    assert highest.supported(1, 50.0)[0, :, 2].tolist() == [NOTHING, 0]


def test_a_return_without_neighbours_stays() -> None:
    assert surface([(2, 3, 900)])[2, 3] == 900
    assert surface([(2, 3, 900), (2, 3, 1)])[2, 3] == 1
    assert (surface([]) == NOTHING).all()


@pytest.mark.parametrize("seed", range(3))
def test_order_has_no_effect(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells, xyz = rng.integers(0, 12, 300), rng.integers(0, 6, (3, 300)).astype(np.int32)
    found = []
    for order in (np.arange(300), rng.permutation(300)):
        highest = highest_of(3, 4)
        enter(highest, cells[order], xyz[:, order])
        found.append(highest.supported(1, 3.0))
    assert np.array_equal(*found)


def test_only_wanted_returns_in_the_block_and_below_the_limit_count() -> None:
    limits = np.array([np.inf, 10.0])
    highest = HighestReturns(CellWindow(100, 3, 0, 0, 1, 2, 200, 400), limits)
    # Pixels of 100 / 3 counts from (0, 0), in local counts from (200, 400).
    x, y = np.array([-200, -167, -166, -134, -133, -150, -150, -201]), np.full(8, -367)
    y[6] = -366
    z = np.array([1, 2, 3, 10, 99, 11, 98, 97])
    wanted = np.array([1, 1, 1, 1, 1, 1, 1, 1], np.bool_)
    highest.add(np.array([x, y, z], np.int32), wanted)
    assert highest.supported(1, 1e9)[0, :, 2].tolist() == [2, 10]
    assert highest.lowest.tolist() == [[1, 3]]
    wanted[1] = False
    again = HighestReturns(highest.window, limits)
    again.add(np.array([x, y, z], np.int32), wanted)
    assert again.supported(1, 1e9)[0, :, 2].tolist() == [1, 10]
