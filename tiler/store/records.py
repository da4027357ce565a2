"""Records of sources as they were decoded, kept until the classified clouds are written: decoding costs far more."""

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

LONGEST_BYTES = 255
"""Longest record that is kept: blosc cannot shuffle longer items."""


@dataclass(frozen=True)
class KeptPiece:
    """A piece of a source: its name, its first record, how many there are, and what it depends on."""

    name: str
    start: int
    count: int
    identity: str | None


class RecordKeeper:
    """Writes the records of one piece, `SPOOL_CHUNK` at a time; they count once `close` was called.

    Parameters
    ----------
    storage : Storage
    piece : str
    identity : str or None
        Of the piece: records of a source that has changed since are not taken for its own.
    record_bytes : int
    """

    def __init__(self, storage: Storage, piece: str, identity: str | None, record_bytes: int) -> None:
        path, kind = layout.records_path(piece, record_bytes), layout.records_kind(record_bytes)
        self._array = StoredArray(storage, path, kind, (0, record_bytes), 0, {"identity": identity})
        self._chunks = self._count = 0
        storage.delete_folder(path)

    def add(self, records: npt.NDArray[np.void]) -> None:
        """Append a whole chunk of records, or the last ones."""
        chunk = np.zeros(self._array.kind.chunks, np.uint8)
        chunk[: len(records)] = records.view(np.uint8).reshape(len(records), -1)
        self._array.write_row(self._chunks, chunk)
        self._chunks += 1
        self._count += len(records)

    def close(self) -> None:
        """Write the metadata that make the records count."""
        a = self._array
        arrays.write_metadata(a.storage, a.path, (self._count, a.shape[1]), a.kind, a.attributes)


class KeptRecords:
    """Reads any records of a source, of whose pieces all were kept."""

    def __init__(self, pieces: Sequence[tuple[int, StoredArray]], dtype: np.dtype[np.void]) -> None:
        self._pieces, self._dtype = pieces, dtype

    def read(self, start: int, count: int) -> npt.NDArray[np.void]:
        """Records ``start`` to ``start + count``, structured, shape (count,); raises DamagedError."""
        found: npt.NDArray[np.void] = np.empty(count, self._dtype)
        raw = found.view(np.uint8).reshape(count, self._dtype.itemsize)
        for first, array in self._pieces:
            low, high = max(start - first, 0), min(start + count - first, array.rows)
            for chunk in range(low // SPOOL_CHUNK, -(-high // SPOOL_CHUNK)) if low < high else ():
                at = chunk * SPOOL_CHUNK
                begin, end = max(low, at), min(high, at + SPOOL_CHUNK)
                (values,) = array.read_rows([chunk])
                raw[begin + first - start : end + first - start] = values[begin - at : end - at]
        return found


class RecordStore(StorePart):
    """The records of each source piece."""

    def keep_records(self, piece: str, identity: str | None, record_bytes: int) -> RecordKeeper:
        """Begin to keep the records of a source piece."""
        return RecordKeeper(self._storage, piece, identity, record_bytes)

    def records(
        self, pieces: Sequence[KeptPiece], count: int, dtype: np.dtype[np.void]
    ) -> KeptRecords | None:
        """The ``count`` records of a source, of these pieces in their order; None where not all are kept."""
        found: list[tuple[int, StoredArray]] = []
        end = 0
        for piece in pieces if dtype.itemsize <= LONGEST_BYTES else ():
            path = layout.records_path(piece.name, dtype.itemsize)
            array = arrays.find_array(self._storage, path, layout.records_kind(dtype.itemsize))
            wanted: tuple[Any, ...] = (end, piece.count, piece.identity)
            if array is None or (piece.start, array.rows, array.attributes.get("identity")) != wanted:
                return None
            found.append((piece.start, array))
            end += array.rows
        return KeptRecords(found, dtype) if end == count else None

    def drop_records(self) -> None:
        """Remove all records that were kept (*coordinator*)."""
        self._storage.delete_folder("records")
