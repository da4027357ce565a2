"""The spool: points between decoding and their buckets, one array of whole records per source piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.points import PointBlock
from tiler.errors import StoreError
from tiler.store import arrays, layout
from tiler.store.layout import SPOOL_CHUNK
from tiler.store.rows import RowArray, open_rows
from tiler.store.storage import Storage

Index = list[tuple[int, int, int]]
"""Runs of points, in order: bucket column, bucket row, count."""


def write_piece(
    storage: Storage, piece: str, block: PointBlock, index: Sequence[tuple[int, int, int]], has_rgb: bool
) -> None:
    """Write a piece, replacing what an earlier attempt left.

    Raises
    ------
    StoreError
        ``index`` does not count the points, or a column is missing.
    """
    if sum(count for _, _, count in index) != len(block):
        raise StoreError(f"piece {piece}: its index does not count its {len(block)} points")
    record_type = layout.record_type(has_rgb)
    for name in record_type.names or ():
        if getattr(block, name) is None:
            raise StoreError(f"piece {piece}: needs a column {name}")
    path = layout.spool_path(piece)
    storage.delete_folder(path)
    kind = layout.spool_kind(has_rgb)
    # A piece of no points still has an array, with its index, so that it reads like any other.
    shape = (len(block), record_type.itemsize)
    attributes = {"index": [[int(v) for v in run] for run in index]}
    arrays.create_metadata(storage, path, shape, kind, attributes)
    array = RowArray(storage, path, kind, len(block), attributes)
    for chunk, start in enumerate(range(0, len(block), SPOOL_CHUNK)):
        part = block.take(slice(start, start + SPOOL_CHUNK))
        records = np.zeros(SPOOL_CHUNK, dtype=record_type)
        for name in record_type.names or ():
            records[name][: len(part)] = getattr(part, name).T
        array.write(chunk, records.view(np.uint8).reshape(kind.chunks))


def piece_index(storage: Storage, piece: str, has_rgb: bool) -> Index:
    """The index that the piece was written with."""
    runs: Any = _open(storage, piece, has_rgb).attributes["index"]
    return [(int(ix), int(iy), int(count)) for ix, iy, count in runs]


def read_fragment(storage: Storage, piece: str, start: int, stop: int, has_rgb: bool) -> PointBlock:
    """Points ``start`` to ``stop - 1`` of a piece; reads only the chunks that hold them."""
    array = _open(storage, piece, has_rgb)
    if not 0 <= start <= stop <= array.rows:
        raise StoreError(f"piece {piece}: has {array.rows} points, not {start} to {stop}")
    records = _rows(array, start, stop).reshape(-1).view(layout.record_type(has_rgb))
    return PointBlock(
        **{
            f.name: np.ascontiguousarray(records[f.name].T)
            for f in fields(PointBlock)
            if f.name in (records.dtype.names or ())
        }
    )


def _open(storage: Storage, piece: str, has_rgb: bool) -> RowArray:
    return open_rows(storage, layout.spool_path(piece), layout.spool_kind(has_rgb))


def _rows(array: RowArray, start: int, stop: int) -> npt.NDArray[np.uint8]:
    """Records ``start`` to ``stop - 1``, uint8 (n, size)."""
    first = start // SPOOL_CHUNK
    chunks = array.read(range(first, -(-stop // SPOOL_CHUNK)))
    pieces = []
    for number, chunk in enumerate(chunks, first):
        at = number * SPOOL_CHUNK
        pieces.append(chunk[max(start - at, 0) : stop - at])
    return np.concatenate([np.empty((0, array.kind.chunks[1]), np.uint8), *pieces])
