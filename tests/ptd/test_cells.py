"""Lattices anchored at CRS coordinate 0, and points by their cells."""

from __future__ import annotations

import random
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.cells import (
    CellIndex,
    lowest_per_cell,
    occupied,
    quotient,
    sample_per_cell,
    slot_of,
    sort_in_cells,
)
from ptd.frame import CellLattice, Scale

FEET = Fraction(3048, 10**7)
Points = list[tuple[int, int, int]]


def columns(points: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, y, z = np.array(points, np.int32).reshape(-1, 3).T
    return np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(z)


def expected(points: Points, size: Fraction, origin: tuple[int, int]) -> Points:
    """The lowest point of each cell by sets and sorting, in row-major order."""
    best: dict[tuple[int, int], tuple[int, int, int]] = {}
    for x, y, z in points:
        key = (y + origin[1]) // size, (x + origin[0]) // size
        best[key] = min(best.get(key, (z, x, y)), (z, x, y))
    return [(x, y, z) for _, (z, x, y) in sorted(best.items())]


near = st.tuples(st.integers(-300, 300), st.integers(-300, 300), st.integers(-3, 3))
far = st.tuples(st.integers(-(2**25), 2**25), st.integers(-(2**25), 2**25), st.integers(-3, 3))


@settings(max_examples=60, deadline=None)
@given(
    points=st.one_of(st.lists(near, max_size=60), st.lists(far, max_size=12)),
    size=st.sampled_from([0.01, 0.05, 0.1, 0.33, 1.0, 20.0]),
    unit=st.sampled_from([Fraction(1, 1000), Fraction(1, 100), FEET]),
    origin=st.tuples(st.integers(-(10**9), 10**9), st.integers(-(10**9), 10**9)),
    shuffle=st.randoms(use_true_random=False),
)
def test_the_lowest_of_each_cell(
    points: Points, size: float, unit: Fraction, origin: tuple[int, int], shuffle: object
) -> None:
    cells = CellLattice.of(size, Scale(unit, unit, origin))
    want = expected(points, Fraction(repr(size)) / unit, origin)
    for _ in range(2):
        x, y, z = columns(points)
        got = lowest_per_cell(x, y, z, cells)
        assert [(int(x[i]), int(y[i]), int(z[i])) for i in got] == want
        shuffle.shuffle(points)  # type: ignore[attr-defined]


def mixed(x: int, y: int, z: int) -> int:
    """Mix a position with the finaliser of the sample, in integers of any size."""
    factors = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
    value = (x * factors[0] + y * factors[1] + z * factors[2]) % 2**64
    for factor in factors[1:]:
        value = (value ^ value >> 32) * factor % 2**64
    return value


@settings(max_examples=60, deadline=None)
@given(
    points=st.one_of(st.lists(near, max_size=60), st.lists(far, max_size=12)),
    repeats=st.integers(1, 2),
    size=st.integers(1, 400),
    origin=st.tuples(st.integers(-(10**9), 10**9), st.integers(-(10**9), 10**9)),
)
def test_a_sample_has_the_first_point_with_the_smallest_mixed_position_of_each_cell(
    points: Points, repeats: int, size: int, origin: tuple[int, int]
) -> None:
    points *= repeats
    first: dict[tuple[int, int], tuple[int, int]] = {}
    for i, (x, y, z) in enumerate(points):
        east, north = x + origin[0], y + origin[1]
        key = north // size, east // size
        first[key] = min(first.get(key, (2**64, 0)), (mixed(east, north, z), i))
    got = sample_per_cell(*columns(points), CellLattice(size, 1, *origin))
    assert got.tolist() == [i for _, (_, i) in sorted(first.items())]
    wide = sample_per_cell(*columns(points), CellLattice(2 * size, 1, *origin))
    assert set(wide.tolist()) <= set(got.tolist())


full = st.integers(-(2**31) + 1, 2**31 - 1)
tall = st.tuples(st.integers(0, 9), st.integers(0, 9), full)
anywhere = st.tuples(full, full, full)


@settings(max_examples=200, deadline=None)
@given(
    points=st.one_of(*(st.lists(kind, min_size=1) for kind in (near, far, tall, anywhere))),
    repeats=st.integers(1, 3),
    extra=st.integers(0, 10**6),
    q=st.sampled_from([1, 7, 381]),
    origin=st.tuples(st.integers(-(10**9), 10**9), st.integers(-(10**9), 10**9)),
    shuffle=st.randoms(use_true_random=False),
)
def test_points_are_sorted_by_row_column_z_x_and_y(
    points: Points,
    repeats: int,
    extra: int,
    q: int,
    origin: tuple[int, int],
    shuffle: random.Random,
) -> None:
    p, points = 2 * q + extra, points * repeats
    shuffle.shuffle(points)
    order, keys, is_repeat = sort_in_cells(*columns(points), CellLattice(p, q, *origin))
    cells = [((y + origin[1]) * q // p, (x + origin[0]) * q // p) for x, y, _ in points]
    expected_order = sorted(
        (*cell, z, x, y) for cell, (x, y, z) in zip(cells, points, strict=True)
    )
    assert sorted(order.tolist()) == list(range(len(points)))
    in_order = [(*cells[i], points[i][2], *points[i][:2]) for i in order]
    assert in_order == expected_order
    assert is_repeat.tolist() == [False, *(a == b for a, b in pairwise(in_order))]
    assert [len(set(cells)), sorted(set(cells))] == [
        len(set(keys.tolist())),
        [cells[i] for i in np.unique(keys, return_index=True)[1]],
    ]


@pytest.mark.parametrize("size", [1, 50, 5000])
def test_many_points_in_a_cell_are_sorted(size: int) -> None:
    rng = np.random.default_rng(5)
    x, y, z = rng.integers(0, 100, (3, 20_000)).astype(np.int32)
    order, _, is_repeat = sort_in_cells(x, y, z, CellLattice(size, 1, 0, 0))
    assert np.array_equal(
        np.stack([x, y, z])[:, order],
        np.stack([x, y, z])[:, np.lexsort((y, x, z, x // size, y // size))],
    )
    assert is_repeat.sum() == x.size - len(
        set(zip(x.tolist(), y.tolist(), z.tolist(), strict=True))
    )


@pytest.mark.parametrize("spread", [1, 100_000])
def test_dense_and_sparse_clouds_give_the_same(spread: int) -> None:
    """Cells of the same points, close together (raster) and far apart (sorting)."""
    rng = np.random.default_rng(1)
    column, row, z = rng.integers(0, 20, (3, 500))
    x, y = (column * 200 * spread).astype(np.int32), (row * 200 * spread).astype(np.int32)
    dx, dy = rng.integers(0, 200, (2, 500)).astype(np.int32)
    x, y, z = (x + dx).astype(np.int32), (y + dy).astype(np.int32), (z % 5).astype(np.int32)
    got = lowest_per_cell(x, y, z, CellLattice.of(0.2, Scale()))
    best = np.lexsort((y, x, z, column, row))
    first = np.unique((row * 20 + column)[best], return_index=True)[1]
    assert np.array_equal(np.stack([x, y, z])[:, got], np.stack([x, y, z])[:, best[first]])


@pytest.mark.parametrize("size", [1.0, 20.0, 0.3])
def test_a_shift_by_whole_cells_changes_nothing(size: float) -> None:
    x, y, z = columns(np.random.default_rng(3).integers(-50_000, 50_000, (400, 3)).tolist())
    cells = CellLattice.of(size, Scale(origin=(17, -333)))
    step = int(size * 1000)
    want = lowest_per_cell(x, y, z, cells)
    moved = (x + 7 * step).astype(np.int32), (y - 11 * step).astype(np.int32)
    assert np.array_equal(lowest_per_cell(*moved, z, cells), want)


def test_the_frame_has_no_effect() -> None:
    x, y, z = columns(np.random.default_rng(4).integers(-50_000, 50_000, (400, 3)).tolist())
    want = lowest_per_cell(x, y, z, CellLattice.of(1.0, Scale(origin=(5, 12_345))))
    moved = (x + 5).astype(np.int32), (y + 12_345).astype(np.int32)
    assert np.array_equal(lowest_per_cell(*moved, z, CellLattice.of(1.0, Scale())), want)


@given(
    column=st.integers(-(10**6), 10**6),
    size=st.sampled_from([0.1, 0.3, 1.0, 20.0, 30.48]),
    unit=st.sampled_from([Fraction(1, 1000), FEET, Fraction(1, 7)]),
    origin=st.integers(-(10**9), 10**9),
)
def test_west_is_the_first_count_of_a_column(
    column: int, size: float, unit: Fraction, origin: int
) -> None:
    cells = CellLattice.of(size, Scale(unit, unit, (origin, -origin)))
    if Fraction(repr(size)) / unit < 1:
        return
    west, south = cells.west(column), cells.south(column)
    assert cells.column(west) == column == cells.row(south)
    assert cells.column(west - 1) == column - 1 == cells.row(south - 1)


def test_sizes_are_the_decimal_numbers_of_their_text() -> None:
    assert CellLattice.of(0.1, Scale()) == CellLattice(100, 1, 0, 0)
    assert CellLattice.of(20, Scale(FEET, FEET)) == CellLattice(25_000_000, 381, 0, 0)


def test_lengths_in_counts() -> None:
    scale = Scale(FEET, Fraction(1, 100))
    assert scale.counts(3.048) == pytest.approx(10_000, rel=1e-15)
    assert scale.counts_z(1.4) == 140.0
    assert scale.z_ratio == pytest.approx(0.01 / 0.0003048, rel=1e-15)


@pytest.mark.parametrize("spread", [1, 1000])
def test_an_index_lists_each_point_under_its_cell(spread: int) -> None:
    rng = np.random.default_rng(6)
    x, y = (rng.integers(-9000, 9000, (2, 300)) * spread).astype(np.int32)
    cells = CellLattice.of(1.0, Scale(origin=(3, -77)))
    index = CellIndex(x, y, cells)
    table = index.table
    assert (table.slots.size > 0) == (spread == 1)
    listed = 0
    for k in range(300):
        column, row = cells.column(int(x[k])) - index.col0, cells.row(int(y[k])) - index.row0
        slot = slot_of(table, column, row)
        members = table.order[table.starts[slot] : table.starts[slot + 1]]
        assert k in members
        listed += 1 / members.size
    assert listed == pytest.approx(table.keys.size)
    for column, row in ((-1, 0), (0, -1), (table.width, 0), (0, table.height)):
        assert slot_of(table, column, row) == -1


def test_no_points_no_cells() -> None:
    assert lowest_per_cell(*columns([]), CellLattice.of(1.0, Scale())).size == 0


@pytest.mark.parametrize("n_cells", [50, 10**9])
def test_occupied_cells_in_a_raster_or_sorted(n_cells: int) -> None:
    keys = np.array([7, 3, 49, 3, 7, 0], np.int64)
    found, slot = occupied(keys, n_cells)
    assert found.tolist() == [0, 3, 7, 49]
    assert slot.tolist() == [2, 1, 3, 1, 2, 0]
    assert occupied(keys[:0], n_cells)[0].size == 0


@settings(max_examples=300, deadline=None)
@given(
    found=st.integers(-(2**40), 2**40),
    rest=st.integers(0, 2**22),
    divisor=st.integers(1, 2**22),
)
def test_quotients_are_those_of_integers(found: int, rest: int, divisor: int) -> None:
    for value in (found * divisor + rest % divisor, found * divisor - 1):
        assert quotient(value, divisor, 1.0 / divisor) == value // divisor
