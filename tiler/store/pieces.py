"""Points of the pieces of sources: the spool on the way to the buckets, and the decoded records.

Both are arrays of whole records. Those of the sources are kept until the classified clouds are written, as decoding
the sources again would take much longer than writing and reading them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.points import PointBlock
from tiler.core.records import KnownSums
from tiler.errors import StoreError
from tiler.store import arrays, layout
from tiler.store.arrays import StoredArray, StorePart
from tiler.store.layout import SPOOL_CHUNK
from tiler.store.storage import Storage


class SpoolStore(StorePart):
    """Points of each source piece, sorted by bucket."""

    def write_piece(self, piece: str, block: PointBlock) -> None:
        """Write a piece in place of an earlier attempt. Raise StoreError if a column is missing."""
        record_type = layout.record_type(self.meta.has_rgb)
        for name in record_type.names or ():
            if getattr(block, name) is None:
                raise StoreError(f"piece {piece}: needs a column {name}")
        path = layout.spool_path(piece)
        kind = layout.spool_kind(self.meta.has_rgb)
        self._storage.delete_folder(path)
        array = arrays.write_metadata(
            self._storage, path, (len(block), record_type.itemsize), kind
        )
        for chunk, start in enumerate(range(0, len(block), SPOOL_CHUNK)):
            part = block.take(slice(start, start + SPOOL_CHUNK))
            records = np.zeros(SPOOL_CHUNK, dtype=record_type)
            for name in record_type.names or ():
                # All components at once would be copied point by point, which takes three times as long.
                components = np.atleast_2d(getattr(part, name))
                for target, values in zip(
                    np.atleast_2d(records[name].T), components, strict=True
                ):
                    target[: len(part)] = values
            array.write_row(chunk, records.view(np.uint8).reshape(kind.chunks))

    def read_fragment(self, piece: str, start: int, stop: int) -> PointBlock:
        """Return points ``start`` to ``stop - 1`` of a piece with all columns. Only their chunks are read."""
        kind = layout.spool_kind(self.meta.has_rgb)
        array = arrays.open_array(self._storage, layout.spool_path(piece), kind)
        if not 0 <= start <= stop <= array.rows:
            raise StoreError(f"piece {piece}: has {array.rows} points, not {start} to {stop}")
        first = start // SPOOL_CHUNK
        chunks = array.read_rows(range(first, -(-stop // SPOOL_CHUNK)))
        pieces = []
        for number, chunk in enumerate(chunks, first):
            at = number * SPOOL_CHUNK
            pieces.append(chunk[max(start - at, 0) : stop - at])
        nothing = np.empty((0, array.kind.chunks[1]), np.uint8)
        raw = pieces[0] if len(pieces) == 1 else np.concatenate([nothing, *pieces])
        records = raw.reshape(-1).view(layout.record_type(self.meta.has_rgb))
        names = [f.name for f in fields(PointBlock) if f.name in (records.dtype.names or ())]
        return PointBlock(**{name: np.ascontiguousarray(records[name].T) for name in names})

    def pieces(self) -> set[str]:
        """Return the names of the pieces in the spool, including pieces that were only partly written."""
        return set(self._storage.names("spool"))

    def drop_spool(self) -> None:
        """Remove the spool (*coordinator*)."""
        self._storage.delete_folder("spool")


MAX_RECORD_BYTES = 255
"""Size of the longest record that is kept, since blosc cannot shuffle longer items."""


@dataclass(frozen=True)
class KeptPiece:
    """Piece of a source: its name, first record, number of records, identity of its content, and sums of its fields."""

    name: str
    start: int
    count: int
    identity: str | None
    sums: KnownSums | None = None


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
