"""The spool: pieces come back in fragments, with every column."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from tests.tiler.store.conftest import make_points
from tiler.core.points import PointBlock
from tiler.errors import StoreError
from tiler.store import StoreMeta, TileStore, create_store, open_store
from tiler.store.layout import SPOOL_CHUNK


@pytest.mark.parametrize("has_rgb", [True, False])
def test_fragments_come_back(store_url: str, meta: StoreMeta, has_rgb: bool) -> None:
    store = create_store(store_url, replace(meta, has_rgb=has_rgb))
    n = SPOOL_CHUNK + 100
    block = make_points(np.arange(n) % 3000, np.arange(n) % 77, has_rgb)
    store.write_piece("source-1.0", block)
    reader = open_store(store_url)
    for start, stop in [(0, n), (0, 1), (SPOOL_CHUNK - 1, SPOOL_CHUNK + 1), (n - 7, n), (5, 5)]:
        found = reader.read_fragment("source-1.0", start, stop)
        for name in (f.name for f in fields(PointBlock)):
            expected = getattr(block.take(slice(start, stop)), name)
            if expected is None:
                assert getattr(found, name) is None
            else:
                assert getattr(found, name).dtype == expected.dtype
                assert np.array_equal(getattr(found, name), expected)
                assert getattr(found, name).flags.c_contiguous


def test_a_piece_without_points_is_written_and_read(local_store: TileStore) -> None:
    local_store.write_piece("p", make_points(*np.empty((2, 0), np.int64)))
    assert len(local_store.read_fragment("p", 0, 0)) == 0


def test_a_piece_that_is_written_again_is_replaced(local_store: TileStore) -> None:
    local_store.write_piece("p", make_points(np.arange(50), np.arange(50)))
    again = make_points(np.arange(20), np.arange(20), seed=4)
    local_store.write_piece("p", again)
    assert np.array_equal(local_store.read_fragment("p", 0, 20).xyz, again.xyz)


def test_wrong_pieces_and_ranges_are_refused(local_store: TileStore) -> None:
    block = make_points(np.arange(5), np.arange(5))
    with pytest.raises(StoreError, match="needs a column origin"):
        local_store.write_piece("p", replace(block, origin=None))
    local_store.write_piece("p", block)
    for start, stop in [(0, 6), (-1, 2), (3, 2)]:
        with pytest.raises(StoreError, match="has 5 points"):
            local_store.read_fragment("p", start, stop)


def test_the_spool_can_be_dropped(store: TileStore) -> None:
    store.write_piece("p", make_points(np.arange(5), np.arange(5)))
    store.drop_spool()
    with pytest.raises(StoreError, match="there is no spool/p"):
        store.read_fragment("p", 0, 5)
    store.drop_spool()
