"""Allocation: each row has one owner, and a bucket that fits stays in its rows."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tiler.store.conftest import make_points
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.errors import StoreError
from tiler.store import BucketInfo, TileStore, open_store
from tiler.store.layout import ROW_POINTS
from tiler.store.points import BucketIndex

cells = st.builds(Cell, st.integers(-5, 5), st.integers(-5, 5))
requests = st.lists(
    st.dictionaries(cells, st.integers(0, 350), max_size=20), min_size=1, max_size=4
)


@given(requests)
def test_each_row_has_one_owner_after_any_requests(steps: list[dict[Cell, int]]) -> None:
    index = BucketIndex.empty()
    largest: dict[Cell, int] = {}
    for counts in steps:
        before = index
        index, moved = index.allocated(counts, 100)
        for cell, count in counts.items():
            largest[cell] = max(largest.get(cell, 0), -(-count // 100))
        for cell, needed in largest.items():
            bucket, old = index.find(cell), before.find(cell)
            assert bucket is not None
            assert bucket.rows == needed
            if old is not None and old.rows == needed:
                assert bucket == old
        was = {c: bucket.rows for c in counts if (bucket := before.find(c)) is not None}
        assert {b.cell for b in moved} == {
            c for c, rows in was.items() if 0 < rows < largest[c]
        }
    found = [index.find(cell) for cell in largest]
    rows = [row for b in found if b is not None for row in range(b.row, b.row + b.rows)]
    assert len(rows) == len(set(rows))
    assert all(row < index.rows for row in rows)


def test_the_same_request_again_changes_nothing() -> None:
    counts = {Cell(2, -1): 150, Cell(0, 0): 1}
    first, _ = BucketIndex.empty().allocated(counts, 100)
    first = first.with_infos({Cell(0, 0): BucketInfo(1, 1)}, 100)
    again, moved = first.allocated(counts, 100)
    assert moved == []
    assert [again.find(c) for c in counts] == [first.find(c) for c in counts]


@pytest.mark.parametrize("info", [BucketInfo(101, 0), BucketInfo(5, 6), BucketInfo(5, -1)])
def test_infos_that_do_not_fit_are_refused(info: BucketInfo) -> None:
    index, _ = BucketIndex.empty().allocated({Cell(0, 0): 100}, 100)
    with pytest.raises(StoreError, match=r"bucket \+00\+00"):
        index.with_infos({Cell(0, 0): info}, 100)
    with pytest.raises(StoreError, match=r"bucket \+09\+09"):
        index.with_infos({Cell(9, 9): BucketInfo(1, 1)}, 100)


@given(st.sets(cells), st.tuples(*[st.integers(-600, 600)] * 4))
def test_overlapping_buckets_are_those_whose_bounds_overlap(
    where: set[Cell], corners: tuple[int, ...]
) -> None:
    lattice, bounds = Lattice(Fraction(310, 3)), Bounds(*corners)
    index, _ = BucketIndex.empty().allocated(dict.fromkeys(where, 1), 100)
    index = index.with_infos(dict.fromkeys(where, BucketInfo(1, 0)), 100)
    expected = {c for c in where if not bounds.empty and lattice.bounds(c).overlaps(bounds)}
    found = [b.cell for b in index.overlapping(lattice, bounds)]
    assert len(found) == len(expected)
    assert set(found) == expected
    assert found == sorted(found, key=lambda c: (c.iy, c.ix))


def test_a_bucket_that_outgrew_its_rows_moves_and_others_stay(filled: TileStore) -> None:
    infos = filled.buckets()
    cell, other = list(infos)[:2]
    filled.write_labels("p", other, np.full(infos[other].n, 7, np.uint8))
    kept = filled.read_bucket(other, ("origin",)).origin
    objects = filled.usage().objects

    filled.allocate({cell: ROW_POINTS + 1, Cell(40, 40): 1})

    assert cell not in filled.buckets()
    assert filled.usage().objects == objects - 4  # the four columns of the bucket that moved
    x0, y0 = (filled.meta.bucket.first(i) for i in (cell.ix, cell.iy))
    grown = make_points(np.full(ROW_POINTS + 1, x0), np.full(ROW_POINTS + 1, y0))
    filled.publish_index({**infos, cell: filled.write_bucket(cell, grown, 1)})
    assert np.array_equal(filled.read_bucket(cell).xyz, grown.xyz)
    assert np.array_equal(filled.read_bucket(other, ("origin",)).origin, kept)
    assert set(filled.read_labels("p", other)) == {7}


def test_a_bucket_that_is_not_published_again_is_gone(filled: TileStore) -> None:
    infos = filled.buckets()
    gone = infos.popitem()
    filled.publish_index(infos)
    assert filled.buckets() == infos
    bounds = filled.meta.bucket.bounds(gone[0])
    assert len(filled.window(bounds)) == 0


def test_an_open_store_sees_a_new_index_after_refresh(filled: TileStore) -> None:
    reader = open_store(filled.url)
    infos = reader.buckets()
    cell, info = infos.popitem()
    filled.publish_index({cell: info})
    reader.refresh()
    assert len(reader.window(Bounds(-(10**6), -(10**6), 10**6, 10**6))) == info.n
