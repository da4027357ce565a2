"""The spool: points between decoding and their buckets, one array of whole records per source piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from tiler.core.points import PointBlock
from tiler.errors import StoreError
from tiler.store import arrays, layout
from tiler.store.layout import SPOOL_CHUNK
from tiler.store.part import StorePart

Runs = Sequence[tuple[int, int, int]]
"""Runs of points, in order: bucket column, bucket row, count."""


class SpoolStore(StorePart):
    """The points of each source piece, sorted by bucket."""

    def write_piece(self, piece: str, block: PointBlock, index: Runs) -> None:
        """Write a piece, replacing what an earlier attempt left.

        Raises
        ------
        StoreError
            ``index`` does not count the points, or a column is missing.
        """
        if sum(count for _, _, count in index) != len(block):
            raise StoreError(f"piece {piece}: its index does not count its {len(block)} points")
        record_type = layout.record_type(self.meta.has_rgb)
        for name in record_type.names or ():
            if getattr(block, name) is None:
                raise StoreError(f"piece {piece}: needs a column {name}")
        path, kind = layout.spool_path(piece), layout.spool_kind(self.meta.has_rgb)
        self._storage.delete_folder(path)
        # A piece of no points still has an array, with its index, so that it reads like any other.
        shape = (len(block), record_type.itemsize)
        attributes = {"index": [[int(v) for v in run] for run in index]}
        array = arrays.write_metadata(self._storage, path, shape, kind, attributes)
        for chunk, start in enumerate(range(0, len(block), SPOOL_CHUNK)):
            part = block.take(slice(start, start + SPOOL_CHUNK))
            records = np.zeros(SPOOL_CHUNK, dtype=record_type)
            for name in record_type.names or ():
                records[name][: len(part)] = getattr(part, name).T
            array.write_row(chunk, records.view(np.uint8).reshape(kind.chunks))

    def piece_index(self, piece: str) -> Runs:
        """The index that a piece was written with."""
        runs: Any = self._piece(piece).attributes["index"]
        return [(int(ix), int(iy), int(count)) for ix, iy, count in runs]

    def read_fragment(self, piece: str, start: int, stop: int) -> PointBlock:
        """Points ``start`` to ``stop - 1`` of a piece, all columns; reads only the chunks that hold them."""
        array = self._piece(piece)
        if not 0 <= start <= stop <= array.rows:
            raise StoreError(f"piece {piece}: has {array.rows} points, not {start} to {stop}")
        first = start // SPOOL_CHUNK
        chunks = array.read_rows(range(first, -(-stop // SPOOL_CHUNK)))
        pieces = []
        for number, chunk in enumerate(chunks, first):
            at = number * SPOOL_CHUNK
            pieces.append(chunk[max(start - at, 0) : stop - at])
        raw = np.concatenate([np.empty((0, array.kind.chunks[1]), np.uint8), *pieces])
        records = raw.reshape(-1).view(layout.record_type(self.meta.has_rgb))
        names = [f.name for f in fields(PointBlock) if f.name in (records.dtype.names or ())]
        return PointBlock(**{name: np.ascontiguousarray(records[name].T) for name in names})

    def pieces(self) -> set[str]:
        """Names of the pieces in the spool; some that were written in part may be among them."""
        return set(self._storage.names("spool"))

    def drop_spool(self) -> None:
        """Remove the spool (*coordinator*)."""
        self._storage.delete_folder("spool")

    def _piece(self, piece: str) -> arrays.StoredArray:
        path, kind = layout.spool_path(piece), layout.spool_kind(self.meta.has_rgb)
        return arrays.open_array(self._storage, path, kind)
