"""Arrays of a store, and the base of its parts, which opens them.

Zarr makes the metadata, and the calling thread reads and writes whole chunks.
The chunks are packed as zarr packs them (blosc, then a crc32c), so that zarr can read them. Between the two is the
checksum of the chunk's key, which blosc skips: a valid chunk at another place is damage. The size in blosc's frame
includes it, since GDAL compares this size with that of the chunk.
They do not go through zarr itself, whose event loop and thread pool need more than a
millisecond of CPU time per chunk of any size. See docs/decisions.md.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any, NamedTuple

import google_crc32c
import numcodecs.blosc
import numpy as np
import zarr
from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec
from zarr.core.buffer import Buffer
from zarr.storage import MemoryStore

from ptd.arrays import AnyArray
from tiler.errors import CorruptStoreError, StoreError
from tiler.store import layout
from tiler.store.georeference import DIMENSIONS
from tiler.store.layout import ALLOWED_CODECS, ArrayKind, StoreMeta
from tiler.store.storage import Storage, place_checksum, seal_holds, sealed

_CHECKSUM_BYTES = 4
_UNPACKED = slice(4, 8)
"""Bytes of a blosc frame that contain its uncompressed size (C-Blosc, README_CHUNK_FORMAT)."""
_PACKED = slice(12, 16)
"""Bytes of a blosc frame that contain its own size."""
_FLAGS, _IS_COPY = 2, 0x2
"""Byte of a blosc frame with flags, and the flag of values that are not compressed. Their frame has a fixed size."""

RECENT_BYTES = 48 << 20
"""Bytes of unpacked chunks that a process keeps, see docs/decisions.md."""

Chunk = tuple[int, ...]
"""Number of a chunk along each axis."""


@dataclass(frozen=True)
class StoredArray:
    """Open array.

    Attributes
    ----------
    storage : Storage
    path : str
    kind : ArrayKind
    shape : tuple of int
    fill : float
        Value of every element that was never written: the `fill` of ``kind``, except for rasters.
    attributes : mapping
    """

    storage: Storage
    path: str
    kind: ArrayKind
    shape: tuple[int, ...]
    fill: float
    attributes: Mapping[str, Any]

    @property
    def rows(self) -> int:
        """Length of the first axis."""
        return self.shape[0]

    def read_rows(self, numbers: Sequence[int]) -> list[AnyArray]:
        """Return whole chunks as `read` does, for an array whose chunks follow one another along the first axis."""
        return self.read([self._row(number) for number in numbers])

    def read(self, chunks: Sequence[Chunk]) -> list[AnyArray]:
        """Return whole chunks, read-only. Raise CorruptStoreError with the keys of damaged and missing chunks."""
        keys = [layout.chunk_key(self.path, chunk) for chunk in chunks]
        decoded = []
        bad = []
        reason = ""
        for key, data in zip(keys, self.storage.get_many(keys), strict=True):
            try:
                decoded.append(self._decoded(key, data))
            except (ValueError, RuntimeError) as error:
                bad.append(key)
                reason = reason or str(error)
        if bad:
            raise CorruptStoreError(
                f"{self.storage.url}: {self.path} is damaged ({reason}); run again to rebuild it",
                tuple(bad),
            )
        return decoded

    def write_row(self, number: int, values: AnyArray) -> None:
        """Write a whole chunk as `write` does, for an array whose chunks follow one another along the first axis."""
        self.write(self._row(number), values)

    def write(self, chunk: Chunk, values: AnyArray) -> None:
        """Write a whole chunk. Raise ProcessingError if the file system refuses."""
        key = layout.chunk_key(self.path, chunk)
        if self.kind.sparse and np.all(values == self.fill):
            self.storage.delete(key)
        else:
            self.storage.put(key, _encoded(key, values, self.kind))

    def _row(self, number: int) -> Chunk:
        return (number, *(0,) * (len(self.shape) - 1))

    def _decoded(self, key: str, data: bytes | None) -> AnyArray:
        """Return the values of a chunk. Raise ValueError, or RuntimeError from blosc, if the chunk is damaged.

        The size in the blosc frame is checked first, since blosc allocates any size that a
        damaged frame states.
        """
        if data is None:
            if self.kind.sparse:
                return np.full(self.kind.chunks, self.fill, self.kind.dtype)
            raise ValueError("a chunk is missing")
        if int.from_bytes(data[_UNPACKED], "little") != self.kind.chunk_bytes:
            raise ValueError("a chunk of another size")
        known = _recent.get((self.storage.url, key))
        if known is not None and known.packed == data and known.values.dtype == self.kind.dtype:
            return known.values
        body = data[:-_CHECKSUM_BYTES]
        if google_crc32c.value(body) != int.from_bytes(data[-_CHECKSUM_BYTES:], "little"):
            raise ValueError("a wrong checksum")
        if body[-_CHECKSUM_BYTES:] != _place(key):
            raise ValueError("a chunk of another place")
        values = np.frombuffer(numcodecs.blosc.decompress(body), self.kind.dtype)
        values = values.reshape(self.kind.chunks)
        _recent.put((self.storage.url, key), Unpacked(data, values))
        return values


class Unpacked(NamedTuple):
    """Chunk as it is stored, and its values."""

    packed: bytes
    values: AnyArray


class RecentChunks:
    """Chunks that this process unpacked last, since tiles and blocks next to each other read the same ones.

    They are valid as long as the stored bytes are the same, so that a changed chunk is unpacked again.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._chunks: OrderedDict[tuple[str, str], Unpacked] = OrderedDict()
        self._lock = Lock()

    def get(self, at: tuple[str, str]) -> Unpacked | None:
        """Return the chunk of a store and a key, or None if it is not kept."""
        with self._lock:
            chunk = self._chunks.get(at)
            if chunk is not None:
                self._chunks.move_to_end(at)
            return chunk

    def put(self, at: tuple[str, str], chunk: Unpacked) -> None:
        """Keep a chunk of a store and a key in place of those that were not used for the longest time."""
        with self._lock:
            self._remove(at)
            self._chunks[at] = chunk
            self._bytes += _bytes_of(chunk)
            while self._bytes > self._most_bytes:
                self._remove(next(iter(self._chunks)))

    def _remove(self, at: tuple[str, str]) -> None:
        chunk = self._chunks.pop(at, None)
        if chunk is not None:
            self._bytes -= _bytes_of(chunk)


def _bytes_of(chunk: Unpacked) -> int:
    return len(chunk.packed) + chunk.values.nbytes


_recent = RecentChunks(RECENT_BYTES)


@contextmanager
def packed_by_one_thread() -> Iterator[None]:
    """Pack and unpack chunks only in the calling thread, as tasks do: processes do the parallel work."""
    used_threads = numcodecs.blosc.use_threads
    numcodecs.blosc.use_threads = False
    try:
        yield
    finally:
        numcodecs.blosc.use_threads = used_threads


def _encoded(key: str, values: AnyArray, kind: ArrayKind) -> bytes:
    items = np.ascontiguousarray(values, kind.dtype).reshape(-1).view(f"V{kind.shuffled}")
    packed: bytes = numcodecs.blosc.compress(
        items, kind.codec.encode(), kind.level, numcodecs.blosc.SHUFFLE
    )
    place = _place(key)
    if not packed[_FLAGS] & _IS_COPY:
        # GDAL refuses a frame that is shorter than the chunk, so the frame includes the place.
        size = (len(packed) + len(place)).to_bytes(4, "little")
        packed = packed[: _PACKED.start] + size + packed[_PACKED.stop :]
    body = packed + place
    checksum: int = google_crc32c.value(body)
    return body + checksum.to_bytes(_CHECKSUM_BYTES, "little")


def _place(key: str) -> bytes:
    return place_checksum(key).to_bytes(_CHECKSUM_BYTES, "little")


def _metadata_key(path: str) -> str:
    return f"{path}/zarr.json"


def find_array(storage: Storage, path: str, kind: ArrayKind) -> StoredArray | None:
    """Return the array at ``path``, or None if there is none.

    Raise CorruptStoreError if its metadata are damaged, and StoreError if tiler does not write
    such an array.
    """
    data = storage.get(_metadata_key(path))
    if data is None:
        return None
    metadata = _checked(data, f"{storage.url}: {path}", path, kind)
    shape = tuple(map(int, metadata["shape"]))
    fill = float(metadata["fill_value"])
    return StoredArray(storage, path, kind, shape, fill, metadata["attributes"])


def open_array(storage: Storage, path: str, kind: ArrayKind) -> StoredArray:
    """Return the array at ``path``.

    Raises
    ------
    CorruptStoreError
        There is no array at ``path``, or its metadata are damaged.
    StoreError
        Tiler does not write such an array.
    """
    array = find_array(storage, path, kind)
    if array is None:
        raise CorruptStoreError(
            f"{storage.url}: there is no {path}; run the stage that writes it first", (path,)
        )
    return array


def find_or_make(storage: Storage, path: str, kind: ArrayKind, rows: int) -> StoredArray:
    """Return the array at ``path``, and make it if there is none.

    Tasks that make it at the same time write the same bytes.
    """
    array = find_array(storage, path, kind)
    return array or write_metadata(storage, path, kind.shape(rows), kind)


def lengthen_rows(storage: Storage, path: str, kind: ArrayKind, rows: int) -> None:
    """Make the array at ``path``, or lengthen it to ``rows``. It is never shortened."""
    array = find_or_make(storage, path, kind, rows)
    if array.rows < rows:
        write_metadata(storage, path, kind.shape(rows), kind, array.attributes)


def write_metadata(
    storage: Storage,
    path: str,
    shape: tuple[int, ...],
    kind: ArrayKind,
    attributes: Mapping[str, Any] | None = None,
) -> StoredArray:
    """Write the metadata of a new or changed array. The chunks do not change.

    Zarr makes the metadata in memory, so that they are written in one piece and with a
    checksum.
    """
    attributes = attributes or {}
    blosc = BloscCodec(
        typesize=kind.shuffled, cname=kind.codec, clevel=kind.level, shuffle="shuffle"
    )
    written: dict[str, Buffer] = {}
    zarr.create_array(
        MemoryStore(written),
        shape=shape,
        chunks=kind.chunks,
        dtype=kind.dtype,
        fill_value=kind.fill,
        serializer=BytesCodec(),
        filters=None,
        compressors=[blosc, Crc32cCodec()],
        attributes=dict(attributes),
        dimension_names=attributes.get(DIMENSIONS),
        chunk_key_encoding={"name": "default", "separator": layout.CHUNK_SEPARATOR},
        zarr_format=3,
    )
    metadata: dict[str, Any] = json.loads(written["zarr.json"].to_bytes())
    key = _metadata_key(path)
    storage.put(key, json.dumps(sealed(key, metadata)).encode())
    return StoredArray(storage, path, kind, shape, kind.fill, attributes)


def make_group(storage: Storage, path: str) -> None:
    """Make the folder at ``path`` a group of zarr if it is not one. The store itself needs no groups in it."""
    key = _metadata_key(path)
    if storage.get(key) is None:
        group = {"attributes": {}, "zarr_format": 3, "node_type": "group"}
        storage.put(key, json.dumps(sealed(key, group)).encode())


def _checked(data: bytes, where: str, path: str, kind: ArrayKind) -> dict[str, Any]:
    """Return the metadata of an array. Raise CorruptStoreError or StoreError if tiler cannot have written them."""
    try:
        metadata: dict[str, Any] = json.loads(data)
        if not seal_holds(_metadata_key(path), metadata):
            raise ValueError("its checksum does not fit")
        recorded = {
            "zarr_format": metadata["zarr_format"],
            "node_type": metadata["node_type"],
            "data_type": metadata["data_type"],
            "chunks": tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"]),
        }
        codecs = {codec["name"] for codec in metadata["codecs"]}
        transformers = metadata.get("storage_transformers")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise CorruptStoreError(
            f"{where}: its metadata are damaged; run again to rebuild it", (path,)
        ) from error
    expected = {
        "zarr_format": 3,
        "node_type": "array",
        "data_type": kind.dtype,
        "chunks": kind.chunks,
    }
    if recorded != expected or transformers:
        raise StoreError(
            f"{where}: not an array that this version writes; run again with --overwrite"
        )
    if not codecs <= ALLOWED_CODECS:
        strange = ", ".join(sorted(map(str, codecs - ALLOWED_CODECS)))
        raise StoreError(
            f"{where}: codec {strange} is not allowed in a store; run again with --overwrite"
        )
    return metadata


class StorePart:
    """Part of `tiler.store.store.TileStore`, which inherits from all parts.

    Attributes
    ----------
    url : str
    meta : StoreMeta
    """

    def __init__(self, storage: Storage, meta: StoreMeta) -> None:
        self.url = storage.url
        self.meta = meta
        self._storage = storage
        self._open: dict[str, StoredArray] = {}

    def _opened(self, path: str, kind: ArrayKind) -> StoredArray:
        """Return the array at a path, which the first call opens. Raise CorruptStoreError if there is no array."""
        if path not in self._open:
            self._open[path] = open_array(self._storage, path, kind)
        return self._open[path]
