"""Arrays whose chunks follow one another along the first axis, read and written in whole chunks by the calling thread.

The bytes are zarr's (blosc, then a crc32c), and zarr reads them. Through its event loop and pool of threads a chunk
costs more than a millisecond of CPU time whatever is in it, and tasks read little else: see docs/decisions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import google_crc32c
import numcodecs.blosc
import numpy as np
import numpy.typing as npt

from tiler.errors import DamagedError
from tiler.store import arrays
from tiler.store.layout import ArrayKind
from tiler.store.storage import Storage

numcodecs.blosc.use_threads = False  # parallelism is over processes

_CHECKSUM_BYTES = 4
_UNPACKED = slice(4, 8)
"""Where a blosc frame says how many bytes it unpacks to (C-Blosc, README_CHUNK_FORMAT)."""


@dataclass(frozen=True)
class RowArray:
    """An array that is open.

    Attributes
    ----------
    storage : Storage
    path : str
    kind : ArrayKind
        Its chunks span all axes but the first.
    rows : int
        Length of the first axis.
    attributes : dict
    """

    storage: Storage
    path: str
    kind: ArrayKind
    rows: int
    attributes: dict[str, Any]

    def read(self, chunks: Sequence[int]) -> list[npt.NDArray[Any]]:
        """The chunks of these numbers, read-only; raises DamagedError, which names those damaged or missing."""
        keys = [self._key(chunk) for chunk in chunks]
        found, bad, reason = [], [], ""
        for key, data in zip(keys, self.storage.get_many(keys), strict=True):
            try:
                found.append(_decoded(data, self.kind))
            except (ValueError, RuntimeError) as error:
                bad.append(key)
                reason = reason or str(error)
        if bad:
            raise DamagedError(
                f"{self.storage.url}: {self.path} is damaged ({reason}); run again, and it is made anew",
                tuple(bad),
            )
        return found

    def write(self, chunk: int, values: npt.NDArray[Any]) -> None:
        """Write a whole chunk; raises ProcessingError where the file system refuses."""
        self.storage.put(self._key(chunk), _encoded(values, self.kind))

    def delete(self, chunk: int) -> None:
        """Remove a chunk if it is there."""
        self.storage.delete(self._key(chunk))

    def _key(self, chunk: int) -> str:
        return f"{self.path}/c/{chunk}" + "/0" * (len(self.kind.chunks) - 1)


def find_rows(storage: Storage, path: str, kind: ArrayKind) -> RowArray | None:
    """The array at ``path``; None where there is none, StoreError where it is not one that tiler writes."""
    metadata = arrays.find_metadata(storage, path, kind)
    if metadata is None:
        return None
    return RowArray(storage, path, kind, int(metadata["shape"][0]), metadata["attributes"])


def open_rows(storage: Storage, path: str, kind: ArrayKind) -> RowArray:
    """The array at ``path``; DamagedError where there is none."""
    array = find_rows(storage, path, kind)
    if array is None:
        raise arrays.no_array(storage, path)
    return array


def made_rows(storage: Storage, path: str, kind: ArrayKind, rows: int) -> RowArray:
    """The array at ``path``, made by the first task that writes to it; others make the same."""
    array = find_rows(storage, path, kind)
    if array is None:
        arrays.create_metadata(storage, path, (rows, *kind.chunks[1:]), kind)
        array = open_rows(storage, path, kind)
    return array


def lengthen_rows(storage: Storage, path: str, kind: ArrayKind, rows: int) -> None:
    """Make the array at ``path``, or let it be longer; never shortens."""
    array = made_rows(storage, path, kind, rows)
    if array.rows < rows:
        arrays.replace_metadata(storage, path, (rows, *kind.chunks[1:]), kind, array.attributes)


def _encoded(values: npt.NDArray[Any], kind: ArrayKind) -> bytes:
    items = np.ascontiguousarray(values, kind.dtype).reshape(-1).view(f"V{kind.shuffled}")
    body: bytes = numcodecs.blosc.compress(items, kind.codec.encode(), kind.level, numcodecs.blosc.SHUFFLE)
    checksum: int = google_crc32c.value(body)
    return body + checksum.to_bytes(_CHECKSUM_BYTES, "little")


def _decoded(data: bytes | None, kind: ArrayKind) -> npt.NDArray[Any]:
    """The values of a chunk; ValueError or RuntimeError (of blosc) say what is wrong with it.

    One that says it unpacks to something else than a chunk is not decoded: blosc would allocate what it says.
    """
    if data is None:
        raise ValueError("a chunk is missing")
    if int.from_bytes(data[_UNPACKED], "little") != kind.chunk_bytes:
        raise ValueError("a chunk of another size")
    body = data[:-_CHECKSUM_BYTES]
    if google_crc32c.value(body) != int.from_bytes(data[-_CHECKSUM_BYTES:], "little"):
        raise ValueError("a wrong checksum")
    return np.frombuffer(numcodecs.blosc.decompress(body), kind.dtype).reshape(kind.chunks)
