"""Spool: decoded points on the way to their buckets, as one array of whole records per source piece."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from tiler.core.points import PointBlock
from tiler.errors import StoreError
from tiler.store import arrays, layout
from tiler.store.layout import SPOOL_CHUNK
from tiler.store.part import StorePart


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
                records[name][: len(part)] = getattr(part, name).T
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
