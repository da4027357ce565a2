"""Labels are stored in the order of their bucket's points."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tiler.store.conftest import make_points, put_points
from tiler.core.lattice import Cell
from tiler.errors import StoreError
from tiler.store import TileStore, open_store
from tiler.store.layout import ELECTED, ROW_POINTS


def test_labels_come_back_by_pass(store: TileStore) -> None:
    rng = np.random.default_rng(3)
    put_points(store, make_points(*rng.integers(-5000, 5000, (2, 500))))
    written = {}
    for name in ("first", "second"):
        for cell, info in store.buckets().items():
            written[name, cell] = rng.integers(0, 256, info.n).astype(np.uint8)
            store.write_labels(name, cell, written[name, cell])
    reader = open_store(store.url)
    for (name, cell), labels in written.items():
        found = reader.read_labels(name, cell)
        assert found.dtype == np.uint8
        assert np.array_equal(found, labels)


def test_labels_of_several_rows_come_back(local_store: TileStore) -> None:
    n = ROW_POINTS + 3
    local_store.allocate({Cell(0, 0): n})
    local_store.publish_index(
        {
            Cell(0, 0): local_store.write_bucket(
                Cell(0, 0), make_points(*np.zeros((2, n), int)), 0
            )
        }
    )
    labels = np.arange(n).astype(np.uint8)
    local_store.write_labels("p", Cell(0, 0), labels)
    assert np.array_equal(local_store.read_labels("p", Cell(0, 0)), labels)


def test_labels_of_another_length_or_type_are_refused(filled: TileStore) -> None:
    cell, info = next(iter(filled.buckets().items()))
    for labels in (np.zeros(info.n + 1, np.uint8), np.zeros(info.n, np.int64)):
        with pytest.raises(StoreError, match=f"need {info.n} uint8"):
            filled.write_labels("p", cell, labels)


def test_labels_that_were_not_written_are_not_read_as_zeros(filled: TileStore) -> None:
    first, second = list(filled.buckets())[:2]
    with pytest.raises(StoreError, match="there is no labels/p"):
        filled.read_labels("p", first)
    filled.write_labels("p", first, np.zeros(filled.buckets()[first].n, np.uint8))
    assert not filled.read_labels("p", first).any()
    with pytest.raises(StoreError, match="missing"):
        filled.read_labels("p", second)


PIECE = ELECTED.chunks[-1]


@pytest.mark.parametrize(
    "n_elected",
    [
        0,
        5,
        PIECE - 1,
        PIECE,
        PIECE + 1,
        ROW_POINTS - 1,
        ROW_POINTS,
        ROW_POINTS + 2,
        2 * ROW_POINTS,
    ],
)
def test_elected_points_come_back_with_their_labels(
    local_store: TileStore, n_elected: int
) -> None:
    cells = [Cell(0, 0), Cell(1, 0)]
    local_store.allocate(dict.fromkeys(cells, 2 * ROW_POINTS))
    infos, written, labels = {}, {}, {}
    rng = np.random.default_rng(8)
    for cell in cells:
        # The neighbour has few elected points, so its last rows stay unread.
        m = n_elected if cell.ix == 0 else 3
        bounds = local_store.meta.bucket.bounds(cell)
        x = rng.integers(bounds.x0, bounds.x1, 2 * ROW_POINTS)
        block = make_points(x, np.full(x.size, bounds.y0))
        infos[cell] = local_store.write_bucket(cell, block, 0)
        written[cell] = np.ascontiguousarray(block.xyz[:, :m])
        labels[cell] = rng.integers(0, 256, m).astype(np.uint8)
    local_store.publish_index(infos)
    for cell in cells:
        local_store.write_elected("e", cell, written[cell])
        local_store.write_elected_labels("l", cell, labels[cell])
    places: dict[Cell, slice] = {}
    found = local_store.elected("e", local_store.meta.bucket.hull(cells), "l", places)
    assert found.labels is not None
    for cell in cells:
        assert np.array_equal(found.xyz[:, places[cell]], written[cell])
        assert np.array_equal(found.labels[places[cell]], labels[cell])
    assert len(found) == n_elected + 3


def test_elected_points_that_do_not_fit_are_refused(filled: TileStore) -> None:
    cell = next(iter(filled.buckets()))
    bounds = filled.meta.bucket.bounds(cell)
    ox, oy = filled.meta.frame.origin
    xyz = np.tile(np.array([[bounds.x0 - ox], [bounds.y0 - oy], [0]], np.int32), ROW_POINTS + 1)
    with pytest.raises(StoreError, match="elected points do not fit"):
        filled.write_elected("e", cell, xyz)
