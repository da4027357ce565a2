"""Chunks that were read before are not unpacked again, unless another process changed them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numcodecs import blosc

from tests.tiler.store.conftest import pixels
from tiler.core.raster import Block
from tiler.errors import StoreError
from tiler.store import TileStore, open_store
from tiler.store.arrays import RecentChunks, Unpacked

BLOCK = Block(0, 0, 10, 10)
LIMIT = 1000


def write(store: TileStore, height: float) -> None:
    store.write_block("dtm", BLOCK, np.full((10, 10), height, np.float32))


def test_a_chunk_is_unpacked_once(
    local_store: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    local_store.create_raster("dtm", pixels(10, 10))
    write(local_store, 7)
    unpack, times = blosc.decompress, []

    def counted(data: bytes) -> bytes:
        times.append(len(data))
        return unpack(data)

    monkeypatch.setattr("numcodecs.blosc.decompress", counted)
    for reader in (local_store, open_store(local_store.url)):
        assert (reader.read_block("dtm", BLOCK) == 7).all()
    assert len(times) == 1


def test_a_chunk_that_was_written_again_or_damaged_is_read_again(
    local_store: TileStore,
) -> None:
    local_store.create_raster("dtm", pixels(10, 10))
    reader = open_store(local_store.url)
    for height in (1, 2, 1):
        write(local_store, height)
        for store in (reader, local_store):
            assert (store.read_block("dtm", BLOCK) == height).all()
    chunk = Path(local_store.url, "rasters/dtm/c.0.0")
    data = bytearray(chunk.read_bytes())
    data[-9] ^= 1
    chunk.write_bytes(data)
    with pytest.raises(StoreError, match="damaged"):
        reader.read_block("dtm", BLOCK)
    chunk.unlink()
    assert (reader.read_block("dtm", BLOCK) == -9999).all()


def test_a_caller_cannot_change_what_the_next_one_reads(local_store: TileStore) -> None:
    local_store.create_raster("dtm", pixels(10, 10))
    write(local_store, 3)
    local_store.read_block("dtm", BLOCK)[:] = 0
    assert (local_store.read_block("dtm", BLOCK) == 3).all()


@given(sizes=st.lists(st.tuples(st.sampled_from("abcdefgh"), st.integers(0, 1200))))
def test_the_bytes_of_all_chunks_stay_within_the_limit(sizes: list[tuple[str, int]]) -> None:
    recent = RecentChunks(LIMIT)
    for key, size in sizes:
        chunk = Unpacked(b"", np.zeros(size, np.uint8))
        recent.put(("store", key), chunk)
        found = [recent.get(("store", name)) for name in "abcdefgh" if name != key]
        assert (recent.get(("store", key)) is chunk) == (size <= LIMIT)
        held = [chunk for chunk in (*found, recent.get(("store", key))) if chunk is not None]
        assert sum(chunk.values.nbytes for chunk in held) <= LIMIT
