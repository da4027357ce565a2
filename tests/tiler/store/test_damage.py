"""A damaged store raises an error of tiler, and never gives silent zeros."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zarr

from tests.tiler.store.conftest import make_points, pixels
from tiler.core.lattice import Bounds
from tiler.core.raster import Block
from tiler.errors import DiskFullError, ProcessingError, StoreError
from tiler.store import TileStore, open_store

EVERYWHERE = Bounds(-(10**6), -(10**6), 10**6, 10**6)
COLUMNS = {"xyz": "xyz", "attributes": "classification", "rgb": "rgb", "origin": "origin"}

FIELDS = ("classification", "flags", "returns", "rgb", "origin")


def flipped(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


DAMAGES = {
    "gone": None,
    "empty": lambda data: b"",
    "three bytes": lambda data: data[:3],
    "half": lambda data: data[: len(data) // 2],
    "one byte short": lambda data: data[:-1],
    "one bit": flipped,
    "longer": lambda data: data + b"x",
}


@pytest.fixture(params=list(DAMAGES))
def damage(request: pytest.FixtureRequest) -> Callable[[Path], None]:
    change = DAMAGES[request.param]

    def apply(path: Path) -> None:
        if change is None:
            path.unlink()
        else:
            path.write_bytes(change(path.read_bytes()))

    return apply


ARRAYS: dict[str, tuple[str, Callable[[TileStore], object]]] = {
    **{
        c: (f"points/{c}/c.2.0.0", lambda s, f=field: s.window(EVERYWHERE, (f,)))
        for c, field in COLUMNS.items()
    },
    "labels": (
        "labels/p/c.0.0.0",
        lambda store: store.read_labels("p", next(iter(store.buckets()))),
    ),
    "spool": ("spool/a/c.0.0", lambda store: store.read_fragment("a", 10, 20)),
}
"""A chunk of each kind of array, and a function that reads it."""


@pytest.mark.parametrize("kind", list(ARRAYS))
def test_a_damaged_chunk_is_an_error(
    filled: TileStore, damage: Callable[[Path], None], kind: str
) -> None:
    cell, info = next(iter(filled.buckets().items()))
    filled.write_labels("p", cell, np.zeros(info.n, np.uint8))
    filled.write_piece("a", make_points(np.arange(100), np.arange(100)))
    chunk, read = ARRAYS[kind]
    damage(Path(filled.url, chunk))
    with pytest.raises(StoreError):
        read(open_store(filled.url))


def test_a_damaged_raster_is_an_error(
    local_store: TileStore, damage: Callable[[Path], None]
) -> None:
    local_store.create_raster("dtm", pixels(100, 100))
    block = Block(0, 0, 100, 100)
    local_store.write_block("dtm", block, np.arange(10_000, dtype=np.float32).reshape(100, 100))
    path = Path(local_store.url, "rasters", "dtm", "c.0.0")
    damage(path)
    if path.exists():
        with pytest.raises(StoreError, match="rasters/dtm is damaged"):
            local_store.read_block("dtm", block)
    else:  # the block of a tile that failed
        assert np.all(local_store.read_block("dtm", block) == -9999.0)


@pytest.mark.parametrize("path", ["points/xyz/zarr.json", "zarr.json"])
def test_any_flipped_bit_of_the_metadata_is_harmless_or_an_error(
    filled: TileStore, path: str
) -> None:
    """No other exception and no other points; zarr alone would accept a shorter shape or another fill."""
    cell = next(iter(filled.buckets()))
    truth, metadata = filled.read_bucket(cell).xyz, Path(filled.url, path)
    whole, noticed = metadata.read_bytes(), 0
    bits = range(0, 8 * len(whole), 11)
    for bit in bits:
        data = bytearray(whole)
        data[bit // 8] ^= 1 << bit % 8
        metadata.write_bytes(data)
        try:
            found = open_store(filled.url).read_bucket(cell).xyz
        except StoreError:
            noticed += 1
        else:
            assert np.array_equal(found, truth)
    assert noticed > 0.9 * len(bits)


def swap(one: Path, other: Path) -> None:
    first, second = one.read_bytes(), other.read_bytes()
    assert first != second
    one.write_bytes(second)
    other.write_bytes(first)


@pytest.mark.parametrize("kind", list(ARRAYS))
def test_valid_chunks_at_each_others_place_are_an_error(filled: TileStore, kind: str) -> None:
    (cell, info), (neighbour, near) = list(filled.buckets().items())[:2]
    filled.write_labels("p", cell, np.zeros(info.n, np.uint8))
    filled.write_labels("p", neighbour, np.ones(near.n, np.uint8))
    for name in ("a", "b"):
        filled.write_piece(name, make_points(np.arange(100) + ord(name), np.arange(100)))
    chunk, read = ARRAYS[kind]
    others = {"labels": "labels/p/c.1.0.0", "spool": "spool/b/c.0.0"}
    other = others.get(kind, chunk.replace("c.2", "c.1"))
    swap(Path(filled.url, chunk), Path(filled.url, other))
    with pytest.raises(StoreError, match="a chunk of another place"):
        read(open_store(filled.url))


def test_valid_metadata_at_another_place_are_an_error(filled: TileStore) -> None:
    folder = Path(filled.url, "points")
    swap(folder / "xyz" / "zarr.json", folder / "attributes" / "zarr.json")
    with pytest.raises(StoreError, match="points/xyz: its metadata are damaged"):
        open_store(filled.url).window(EVERYWHERE)


def test_valid_values_at_another_place_are_an_error(filled: TileStore) -> None:
    for name in ("plan", "passes"):
        filled.put_state(name, name)
        filled.commit("filter", name, "same digest", {"of": name})
    states, commits = Path(filled.url, "state"), Path(filled.url, "commits", "filter")
    swap(states / "plan.json", states / "passes.json")
    with pytest.raises(StoreError, match=r"state/plan\.json: damaged"):
        filled.get_state("plan")
    swap(commits / "plan.json", commits / "passes.json")
    assert filled.committed("filter") == {}


def test_zarr_reads_every_chunk(filled: TileStore) -> None:
    """It skips the checksum of the place."""
    for cell in filled.buckets():
        row = filled._bucket(cell).row
        xyz = filled.read_bucket(cell).xyz
        array = zarr.open_array(Path(filled.url, "points", "xyz"), mode="r")
        assert np.array_equal(array[row, :, : xyz.shape[1]], xyz)


def test_a_damaged_index_is_an_error(filled: TileStore, damage: Callable[[Path], None]) -> None:
    from tiler.store.points import _loaded

    (path,) = Path(filled.url, "index").glob("*.npy")
    damage(path)
    _loaded.cache_clear()  # as another process would find it
    with pytest.raises(StoreError, match="bucket index is"):
        open_store(filled.url).buckets()


def test_a_damaged_state_is_an_error(local_store: TileStore) -> None:
    local_store.put_state("plan", {"a": 1})
    path = Path(local_store.url, "state", "plan.json")
    path.write_bytes(path.read_bytes().replace(b"1}", b"2}"))
    with pytest.raises(
        StoreError, match=r"state/plan\.json: damaged, its checksum does not fit"
    ):
        local_store.get_state("plan")


@pytest.mark.skipif(
    os.name == "nt" or os.geteuid() == 0, reason="folders are not read-only, or not for root"
)
def test_a_disk_that_refuses_is_a_processing_error(local_store: TileStore) -> None:
    Path(local_store.url).chmod(0o500)
    with pytest.raises(ProcessingError, match=r"state/plan\.json: cannot be written"):
        local_store.put_state("plan", 1)


def test_a_full_disk_is_a_processing_error_with_its_remedy(
    filled: TileStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    import errno

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    cell = next(iter(filled.buckets()))
    with pytest.raises(
        DiskFullError, match="No space left on device.: the disk is full; free some"
    ):
        filled.put_state("plan", 1)
    with pytest.raises(
        DiskFullError, match="points/xyz/c.0.0.0: cannot be written .No space left"
    ):
        filled.write_bucket(cell, filled.read_bucket(cell, FIELDS), 0)
