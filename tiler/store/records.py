"""Decoded records of the sources, kept until the classified clouds are written.

Decoding the sources again would take much longer than writing and reading the records.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.store import arrays, layout
from tiler.store.arrays import StoredArray
from tiler.store.layout import SPOOL_CHUNK
from tiler.store.part import StorePart
from tiler.store.storage import Storage

MAX_RECORD_BYTES = 255
"""Size of the longest record that is kept, since blosc cannot shuffle longer items."""


@dataclass(frozen=True)
class KeptPiece:
    """Piece of a source: its name, first record, number of records, and the identity of its content."""

    name: str
    start: int
    count: int
    identity: str | None


class RecordKeeper:
    """Writer of the records of one piece, in chunks of `SPOOL_CHUNK`. The records are valid once `close` was called.

    Parameters
    ----------
    storage : Storage
    piece : str
    identity : str or None
        Identity of the piece's content. The records are not used if the source has changed since.
    record_bytes : int
    """

    def __init__(
        self, storage: Storage, piece: str, identity: str | None, record_bytes: int
    ) -> None:
        path, kind = layout.records_path(piece, record_bytes), layout.records_kind(record_bytes)
        self._array = StoredArray(
            storage, path, kind, (0, record_bytes), 0, {"identity": identity}
        )
        self._chunks = 0
        self._count = 0
        storage.delete_folder(path)

    def add(self, records: npt.NDArray[np.void]) -> None:
        """Append the records of a chunk. Only the last chunk may be shorter than `SPOOL_CHUNK`."""
        chunk = np.zeros(self._array.kind.chunks, np.uint8)
        chunk[: len(records)] = records.view(np.uint8).reshape(len(records), -1)
        self._array.write_row(self._chunks, chunk)
        self._chunks += 1
        self._count += len(records)

    def close(self) -> None:
        """Write the metadata, which makes the records valid."""
        array = self._array
        shape = (self._count, array.shape[1])
        arrays.write_metadata(array.storage, array.path, shape, array.kind, array.attributes)


class KeptRecords:
    """Reader of the records of a source whose pieces were all kept."""

    def __init__(
        self, pieces: Sequence[tuple[int, StoredArray]], dtype: np.dtype[np.void]
    ) -> None:
        self._pieces = pieces
        self._dtype = dtype

    def read(self, start: int, count: int) -> npt.NDArray[np.void]:
        """Return records ``start`` to ``start + count - 1``, structured, shape (count,).

        Raise CorruptStoreError if a chunk is damaged or missing.
        """
        records: npt.NDArray[np.void] = np.empty(count, self._dtype)
        raw = records.view(np.uint8).reshape(count, self._dtype.itemsize)
        for first, array in self._pieces:
            low = max(start - first, 0)
            high = min(start + count - first, array.rows)
            if low >= high:
                continue
            for chunk in range(low // SPOOL_CHUNK, -(-high // SPOOL_CHUNK)):
                at = chunk * SPOOL_CHUNK
                begin, end = max(low, at), min(high, at + SPOOL_CHUNK)
                (values,) = array.read_rows([chunk])
                raw[begin + first - start : end + first - start] = values[begin - at : end - at]
        return records


class RecordStore(StorePart):
    """Records of each source piece."""

    def keep_records(self, piece: str, identity: str | None, record_bytes: int) -> RecordKeeper:
        """Remove the records that an earlier run kept of a source piece, and return a keeper for new ones."""
        return RecordKeeper(self._storage, piece, identity, record_bytes)

    def records(
        self, pieces: Sequence[KeptPiece], count: int, dtype: np.dtype[np.void]
    ) -> KeptRecords | None:
        """Return the ``count`` records of a source that consists of ``pieces`` in this order, or None.

        None means that some records were not kept, or belong to another content of the source.
        """
        if dtype.itemsize > MAX_RECORD_BYTES:
            return None
        piece_arrays: list[tuple[int, StoredArray]] = []
        end = 0
        for piece in pieces:
            path = layout.records_path(piece.name, dtype.itemsize)
            array = arrays.find_array(self._storage, path, layout.records_kind(dtype.itemsize))
            expected: tuple[Any, ...] = (end, piece.count, piece.identity)
            if (
                array is None
                or (piece.start, array.rows, array.attributes.get("identity")) != expected
            ):
                return None
            piece_arrays.append((piece.start, array))
            end += array.rows
        return KeptRecords(piece_arrays, dtype) if end == count else None

    def drop_records(self) -> None:
        """Remove all records that were kept (*coordinator*)."""
        self._storage.delete_folder("records")
