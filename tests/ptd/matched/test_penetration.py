"""What is seen through: areas of points below points, not walls, and the same for any tiles and order."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import Scale, Window
from ptd.matched.penetration import CELL_M, COUNTS, REACH_M, seen_through

MM = Scale()


def counts(*columns: np.ndarray) -> np.ndarray:
    return np.rint(np.stack(columns) * 1000).astype(np.int32)


def town(rng: np.random.Generator, plants: bool) -> np.ndarray:
    """60 m x 60 m: a house of 16 m x 12 m, trees of 16 m x 14 m that a laser passes at a third of its pulses."""
    x, y = 60 * rng.random((2, 20_000))
    z = 0.1 * x
    z[(x >= 10) & (x < 26) & (y >= 10) & (y < 22)] = 9.0
    tree = (x >= 34) & (x < 50) & (y >= 30) & (y < 44)
    crown = 8.0 + 4.0 * rng.random(x.size)
    z = np.where(tree & (rng.random(x.size) < 2 / 3 if plants else True), crown, z)
    return counts(x, y, z)


def test_plants_are_seen_through_and_walls_are_not() -> None:
    everything = Window.everything()
    matched = seen_through(town(np.random.default_rng(1), plants=False), everything, MM)
    assert (matched["looks"], matched["through"]) == (900, 0)
    scanned = seen_through(town(np.random.default_rng(1), plants=True), everything, MM)
    # 8 x 7 cells; those at the edges have 4 or 6 of 9.
    assert (scanned["looks"], scanned["through"]) == (900, 6 * 5)


@pytest.mark.parametrize("plants", [False, True])
def test_sparse_plants_are_seen_through_in_wide_cells_and_walls_are_not(plants: bool) -> None:
    """At 1.4 points/m2; 5 x 4 wide cells touch the trees, 9 of them whole; walls part the points of theirs."""
    sparse = town(np.random.default_rng(1), plants)[:, :5000]
    found = seen_through(sparse, Window.everything(), MM)
    assert found["wide_looks"] == 225
    assert found["wide_gaps"] >= 14  # the walls of the house
    assert (9 <= found["wide_through"] <= 20) if plants else found["wide_through"] == 0


@pytest.mark.parametrize(
    ("low", "n", "through"),
    [((2.0, 2.0), 3, 1), ((2.0, 2.0), 2, 0), ((0.5, 2.0), 3, 0), ((0.4, 0.4), 3, 0)],
)
def test_points_below_are_seen_through_others_where_no_line_parts_them(
    low: tuple[float, float], n: int, through: int
) -> None:
    """Low points amid eight high ones in a cell of 4 m, or beside them; four cells are the same. Two are blunders."""
    ring = [
        (1.0, 1.0),
        (2.0, 1.0),
        (3.0, 1.0),
        (1.0, 2.0),
        (3.0, 2.0),
        (1.0, 3.0),
        (2.0, 3.0),
        (3.0, 3.0),
    ]
    one = np.array([(x, y, 5.0) for x, y in ring] + n * [(*low, 0.0)])
    xyz = np.concatenate([one + [4.0 * i, 4.0 * j, 0.0] for i in (0, 1) for j in (0, 1)])
    found = seen_through(counts(*xyz.T), Window(0, 0, 4000, 4000), MM)
    assert (found["wide_looks"], found["wide_gaps"], found["wide_through"]) == (1, 1, through)


@pytest.mark.parametrize(
    ("heights", "gap"),
    [
        ([0.0, 2.99], False),  # bins 0 and 2: one is empty
        ([0.0, 3.0], True),
        ([0.0, 1.5, 2.5, 3.5, 4.5], False),
        ([-7.0, -5.5, -3.5, -0.5], True),  # bins 0, 1, 3, 6
        ([0.0, 500.0], True),  # far above: the last bin
        ([5.0], False),
    ],
)
def test_a_gap_is_two_empty_metres_between_points(heights: list[float], gap: bool) -> None:
    """The middle one of 3 x 3 cells that all hold the same heights."""
    xs, ys, zs = (a.ravel() for a in np.meshgrid([1.0, 3.0, 5.0], [1.0, 3.0, 5.0], heights))
    found = seen_through(counts(xs, ys, zs), Window(2000, 2000, 4000, 4000), MM)
    assert (found["looks"], found["through"]) == (1, int(gap))
    feet = Scale(Fraction(3048, 10_000_000), Fraction(3048, 10_000_000))
    xyz = np.rint(np.stack([xs, ys, zs]) / 0.3048 * 1000 + [[0.5], [0.5], [0]]).astype(np.int32)
    side = round(2 / 0.3048 * 1000)
    # a height at a bin's edge is rounded in feet
    if 500.0 not in heights and 3.0 not in heights:
        in_feet = seen_through(xyz, Window(side, side, 2 * side, 2 * side), feet)
        assert (in_feet["looks"], in_feet["through"]) == (1, int(gap))


def test_a_point_alone_and_no_point() -> None:
    none = dict.fromkeys(COUNTS, 0)
    assert seen_through(np.zeros((3, 0), np.int32), Window.everything(), MM) == none
    assert seen_through(counts(*np.ones((3, 1))), Window.everything(), MM) == none | {
        "looks": 1
    }


@pytest.mark.parametrize("n", [5000, 20_000])
def test_cores_add_up_in_any_order_of_points(n: int) -> None:
    rng = np.random.default_rng(2)
    xyz = town(rng, plants=True)[:, :n]
    whole = seen_through(xyz, Window.everything(), MM)
    total = dict.fromkeys(whole, 0)
    edges = [-1, 17_300, 41_111, 61_000]  # within cells
    reach = round(REACH_M * 1000)
    for west, east in itertools.pairwise(edges):
        for south, north in itertools.pairwise(edges):
            x, y, _ = xyz
            near = (
                (x >= west - reach)
                & (x < east + reach)
                & (y >= south - reach)
                & (y < north + reach)
            )
            index = rng.permutation(np.flatnonzero(near))
            part = seen_through(xyz[:, index], Window(west, south, east, north), MM)
            total = {name: total[name] + part[name] for name in total}
    assert total == whole
    assert CELL_M * 1000 == 2000
