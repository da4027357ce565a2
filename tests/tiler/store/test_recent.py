"""Unpacked chunks of rasters that were read recently."""

from __future__ import annotations

from unittest.mock import patch

import numcodecs.blosc
import numpy as np

from tiler.core.raster import Block
from tiler.store import TileStore, open_store
from tiler.store.recent import MAX_CHUNKS, RecentChunks

BLOCK = Block(0, 0, 512, 512)


def test_a_chunk_is_unpacked_once_and_read_anew_after_it_was_written(local_store: TileStore) -> None:
    values = np.arange(512 * 512, dtype=np.float32).reshape(512, 512)
    local_store.create_raster("dtm", 512, 512)
    local_store.write_block("dtm", BLOCK, values)
    with patch.object(numcodecs.blosc, "decompress", wraps=numcodecs.blosc.decompress) as decompress:
        for _ in range(3):
            assert np.array_equal(open_store(local_store.url).read_block("dtm", BLOCK), values)
        assert decompress.call_count == 1
        local_store.write_block("dtm", BLOCK, values + 1)
        assert np.array_equal(open_store(local_store.url).read_block("dtm", BLOCK), values + 1)


def test_changing_what_was_read_changes_no_later_reading(local_store: TileStore) -> None:
    local_store.create_raster("dtm", 512, 1024)
    local_store.write_block("dtm", BLOCK, np.ones((512, 512), np.float32))
    both = Block(0, 0, 512, 1024)
    local_store.read_block("dtm", both)[:] = 5.0
    heights = local_store.read_block("dtm", both)
    assert np.all(heights[:, :512] == 1.0)
    assert np.all(heights[:, 512:] == -9999.0)


def test_the_chunk_that_was_used_least_recently_makes_room() -> None:
    recent, values = RecentChunks(), np.zeros(1)
    for number in range(MAX_CHUNKS):
        recent.keep(str(number), b"packed", values)
    assert recent.find("0", b"packed") is values
    recent.keep("another", b"packed", values)
    assert recent.find("0", b"packed") is values
    assert recent.find("1", b"packed") is None
    assert recent.find("0", b"other bytes") is None
