"""Masks of cells against other definitions: morphology of scipy, sets of cells, and half-planes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.ndimage import binary_fill_holes, binary_opening
from scipy.spatial import ConvexHull

from tiler.apps.acceptance.cells import Coverage, areas, closed, convex_hull, filled, opened
from tiler.apps.acceptance.counts import CellCounter, Cells, decoded
from tiler.apps.acceptance.duplicates import DigestFiles, digests, number_of_parts, repeated

masks = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14))


@given(masks)
def test_holes_are_those_of_scipy(mask: np.ndarray) -> None:
    np.testing.assert_array_equal(filled(mask), binary_fill_holes(mask))


@given(masks)
def test_opening_is_that_of_scipy(mask: np.ndarray) -> None:
    np.testing.assert_array_equal(opened(mask), binary_opening(mask, np.ones((3, 3))))


@given(masks, st.integers(1, 4))
def test_closing_only_adds_and_is_done_at_once(mask: np.ndarray, steps: int) -> None:
    once = closed(mask, steps)
    assert (once | ~mask).all()
    np.testing.assert_array_equal(closed(once, steps), once)


@pytest.mark.parametrize("width", [1, 3, 4, 5, 9])
@pytest.mark.parametrize("steps", [2, 4])
def test_closing_closes_gaps_up_to_twice_its_steps(width: int, steps: int) -> None:
    mask = np.ones((40, 60), np.bool_)
    mask[:, 20 : 20 + width] = False
    assert closed(mask, steps)[20].all() == (width <= 2 * steps)


@given(masks)
def test_a_hull_has_the_cells_inside_all_half_planes(mask: np.ndarray) -> None:
    hull = convex_hull(mask)
    assert (hull | ~mask).all()
    rows, columns = np.nonzero(mask)
    points = np.stack((columns, rows), axis=1)
    if len(points) < 3 or np.linalg.matrix_rank(points - points[0]) < 2:
        return
    planes = ConvexHull(points).equations
    row, column = np.indices(mask.shape)
    beyond = planes[:, 0, None, None] * column + planes[:, 1, None, None] * row
    inside = (beyond + planes[:, 2, None, None] <= 1e-9).all(axis=0)
    np.testing.assert_array_equal(hull, inside)


@given(masks, st.integers(1, 5))
def test_areas_have_all_cells_of_large_components(mask: np.ndarray, least: int) -> None:
    labels, numbers, found = areas(mask, least)
    assert [area.cells for area in found] == sorted(
        (area.cells for area in found), reverse=True
    )
    assert all(
        area.cells == (labels == n).sum() >= least
        for n, area in zip(numbers, found, strict=True)
    )
    everything = areas(mask, 1)[2]
    assert sum(area.cells for area in everything) == mask.sum()
    assert len(found) == sum(area.cells >= least for area in everything)


def test_a_gap_is_between_two_swaths_and_not_in_one() -> None:
    coverage = Coverage((80, 100))
    footprint = np.ones((80, 40), np.bool_)
    footprint[30:50, 10:30] = False
    other = np.ones((80, 50), np.bool_)
    coverage.add((slice(0, 80), slice(0, 40)), footprint, footprint, footprint.astype(np.int32))
    coverage.add((slice(0, 80), slice(50, 100)), other, other, other.astype(np.int32))
    (gap,) = coverage.gaps()
    assert gap.column == pytest.approx(44.5)
    assert gap.row == pytest.approx(39.5, abs=0.5)
    assert gap.cells == pytest.approx(800, rel=0.1)


tiny = st.integers(0, 3)


@given(
    st.lists(st.tuples(tiny, tiny, tiny, tiny), max_size=60),
    st.integers(0, 2**32),
)
def test_repeated_points_are_all_but_the_first_of_equal_ones(
    rows: list[tuple[int, ...]], seed: int
) -> None:
    points = np.array(rows, np.float64).reshape(-1, 4)
    order = np.random.default_rng(seed).permutation(len(points))
    found = digests(points[order, :3].T, points[order, 3])
    again = repeated(found)
    assert again.size == len(rows) - len(set(rows))
    kept = np.delete(points[order], again, axis=0)
    assert len({tuple(row) for row in kept}) == len(kept)


def test_digests_differ_in_each_column_and_equal_zeros_do_not() -> None:
    base = np.zeros((4, 1))
    for column in range(4):
        moved = base.copy()
        moved[column] = 1e-3
        pair = [digests(v[:3], v[3]) for v in (base, moved)]
        assert (pair[0] != pair[1]).all()
    np.testing.assert_array_equal(digests(-base[:3], -base[3]), digests(base[:3], base[3]))
    assert (digests(base[:3], None) != digests(base[:3], base[3])).any()


def test_parts_have_all_digests_and_leave_no_file(tmp_path: pytest.TempPathFactory) -> None:
    values = np.random.default_rng(1).uniform(size=(4, 1000))
    found = digests(values[:3], values[3])
    files = DigestFiles(tmp_path, "a", 8)
    for start in range(0, 1000, 300):
        files.add(found[start : start + 300])
    parts = list(files.take())
    assert len(parts) == 8
    assert all(len(part) > 60 for part in parts)
    assert {tuple(d) for part in parts for d in part.tolist()} == {
        tuple(d) for d in found.tolist()
    }
    assert not list(tmp_path.iterdir())


def test_the_number_of_parts_is_a_power_of_two() -> None:
    assert [number_of_parts(n) for n in (0, 1, 2_000_000, 2_000_001, 6_500_000)] == [
        1,
        1,
        1,
        2,
        4,
    ]


@given(st.lists(st.lists(st.integers(0, 9), max_size=12), max_size=8))
def test_pieces_of_cells_are_added(pieces: list[list[int]]) -> None:
    counter = CellCounter()
    for piece in pieces:
        counter.add(np.array(piece, np.uint64))
    keys, counts = counter.merge()
    expected = np.unique([key for piece in pieces for key in piece], return_counts=True)
    np.testing.assert_array_equal(keys, expected[0])
    np.testing.assert_array_equal(counts, expected[1])


def test_keys_keep_source_column_and_row() -> None:
    cells = Cells.around(1000.0, -2000.0, 0.7)
    x, y = np.array([1000.0, 1000.7, 1e9]), np.array([-2000.0, -1990.0, 0.0])
    source, column, row = decoded(cells.keys(x, y, np.array([7, 65_535, 1], np.uint16)))
    assert source.tolist() == [7, 65_535]  # The third point is too far away.
    assert (column + cells.column).tolist() == [1428, 1429]
    assert (row + cells.row).tolist() == [-2858, -2843]
