"""The highest returns, with and without support from their neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.gridding.above_ground import NOTHING, HighestReturns

ROWS, COLUMNS = 6, 7


def surface(
    returns: list[tuple[int, int, int]], reach: int = 1, spike: float = 50.0
) -> np.ndarray:
    """Heights from (row, column, z), each return at a place of its own."""
    highest = HighestReturns(ROWS, COLUMNS)
    cells = np.array([r * COLUMNS + c for r, c, _ in returns], np.int64)
    xyz = (
        np.array([(i, -i, z) for i, (_, _, z) in enumerate(returns)], np.int32).reshape(-1, 3).T
    )
    for part in (slice(0, None, 2), slice(1, None, 2)):
        highest.add(cells[part], np.ascontiguousarray(xyz[:, part]))
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
    highest = HighestReturns(1, 2)
    xyz = np.array([[5, 5, 60], [5, 5, 60], [900, 900, 0]], np.int32)
    highest.add(np.array([0, 0, 1]), xyz)
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
        highest = HighestReturns(3, 4)
        highest.add(cells[order], np.ascontiguousarray(xyz[:, order]))
        found.append(highest.supported(1, 3.0))
    assert np.array_equal(*found)
