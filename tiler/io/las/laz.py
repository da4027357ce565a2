"""How the points of a LAZ file are compressed: laszip record and chunk table, checked against the file."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

import lazrs
import numpy as np
import numpy.typing as npt

_LASZIP = struct.Struct("<HHBBHIIqqH")
_ITEM = struct.Struct("<HHH")
_POINTWISE_CHUNKED, _LAYERED = 2, 3
_VARIABLE = 2**32 - 1
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTE14 = 14
_ITEM_VERSION = 3


MOST_CHUNKS = 1 << 21
"""Most chunks of a file: with 50,000 points each, more than any file has; a longer table would fill the memory."""


class LazDamage(Exception):
    """What is wrong with the compressed points; becomes an InputError that names the file."""


def is_panic(error: BaseException) -> bool:
    """Whether a Rust extension panicked: pyo3's exception is no Exception, cannot be imported, and has this name."""
    return type(error).__name__ == "PanicException"


@dataclass(frozen=True)
class LazLayout:
    """How points are compressed.

    Attributes
    ----------
    record_data : bytes
        What the laszip record holds.
    chunk_size : int or None
        Points of a chunk; None: every chunk has its own number (COPC).
    layers : int
        Compressed layers of a chunk (point formats 6 to 10); 0: points follow one another.
    item_size : int
        Bytes of one decoded record.
    counts, sizes : int64, shape (chunks,)
        Points and bytes of each chunk; empty where the file has no usable table.
    rebuilt : bool
        The file has no usable table: `counts` and `sizes` were found by walking the chunks.
    """

    record_data: bytes
    chunk_size: int | None
    layers: int
    item_size: int
    counts: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    rebuilt: bool = False

    @property
    def least_chunk(self) -> int:
        """Bytes that a chunk of one point has at least."""
        return self.item_size + (4 + 4 * self.layers if self.layers else 0)


def parse_laszip(record_data: bytes) -> LazLayout:
    """The layout that a laszip record describes, without a table; raises LazDamage."""
    if len(record_data) < _LASZIP.size:
        raise LazDamage(f"its laszip record has {len(record_data)} bytes, {_LASZIP.size} are needed")
    compressor, _, _, _, _, _, chunk_size, _, _, n_items = _LASZIP.unpack_from(record_data)
    if compressor not in (_POINTWISE_CHUNKED, _LAYERED):
        raise LazDamage(f"compressor {compressor} of its laszip record is not known (2 and 3 are)")
    if len(record_data) < _LASZIP.size + n_items * _ITEM.size or n_items == 0:
        raise LazDamage(f"its laszip record says {n_items} items and has {len(record_data)} bytes")
    if chunk_size == 0:
        raise LazDamage("its laszip record says chunks of 0 points")
    items = [_ITEM.unpack_from(record_data, _LASZIP.size + i * _ITEM.size) for i in range(n_items)]
    newer = [version for kind, _, version in items if kind in _LAYERS and version > _ITEM_VERSION]
    if newer:
        raise LazDamage(
            f"its points are compressed by items of version {newer[0]}, {_ITEM_VERSION} can be read"
        )
    layers = 0
    if compressor == _LAYERED:
        layers = sum(size if kind == _BYTE14 else _LAYERS.get(kind, 0) for kind, size, _ in items)
    nothing = np.empty(0, dtype=np.int64)
    size = None if chunk_size == _VARIABLE else chunk_size
    return LazLayout(record_data, size, layers, sum(i[1] for i in items), nothing, nothing)


def read_table(
    stream: BinaryIO, layout: LazLayout, points_offset: int, file_size: int, point_count: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Points and bytes of every chunk, int64 each; raises LazDamage where the table cannot be right.

    The number of chunks is held against the bytes that are there before lazrs reads the table.
    """
    data = points_offset + 8
    table = _table_position(stream, data, file_size)
    if not data <= table <= file_size - 8:
        raise LazDamage(
            f"its chunk table should be at byte {table} of {file_size}: the file is cut short or unfinished"
        )
    stream.seek(table)
    _, chunks = struct.unpack("<II", stream.read(8))
    # One more than needed: some writers end with an empty chunk.
    if (chunks - 1) * layout.item_size > table - data or chunks > point_count + 1:
        raise LazDamage(
            f"its chunk table says {chunks} chunks, {table - data} bytes hold {point_count} points"
        )
    if chunks > MOST_CHUNKS:
        raise LazDamage(f"its chunk table says {chunks} chunks, {MOST_CHUNKS} can be read")
    stream.seek(points_offset)
    try:
        entries = np.asarray(lazrs.read_chunk_table(stream, lazrs.LazVlr(layout.record_data)), dtype=np.int64)
    except (lazrs.LazrsError, ValueError, OverflowError) as error:
        raise LazDamage(f"its chunk table cannot be read ({error})") from error
    except BaseException as error:
        if not is_panic(error):
            raise
        raise LazDamage(f"its chunk table makes the decoder fail ({error})") from error
    counts, sizes = entries.reshape(-1, 2).T
    counts = _true_counts(layout, counts, sizes, point_count)
    sizes = sizes[: counts.size]
    if sizes.size and (int(sizes.min()) < 0 or int(sizes.sum()) > table - data):
        raise LazDamage(f"its chunk table says {int(sizes.sum())} bytes of points, {table - data} are there")
    return counts, np.ascontiguousarray(sizes)


def _true_counts(
    layout: LazLayout, counts: npt.NDArray[np.int64], sizes: npt.NDArray[np.int64], point_count: int
) -> npt.NDArray[np.int64]:
    """Points of each chunk (the last one of equal chunks is not full); raises LazDamage."""
    if layout.chunk_size is None:
        if int(counts.sum()) != point_count:
            raise LazDamage(f"its chunks have {int(counts.sum())} points, its header says {point_count}")
        return np.ascontiguousarray(counts)
    needed = -(-point_count // layout.chunk_size)
    behind = int(sizes[needed]) if counts.size == needed + 1 else 0
    if not needed <= counts.size <= needed + 1 or behind >= layout.least_chunk:
        raise LazDamage(f"its chunk table has {counts.size} chunks, {point_count} points need {needed}")
    full = np.full(needed, layout.chunk_size, dtype=np.int64)
    if needed:
        full[-1] = point_count - (needed - 1) * layout.chunk_size
    return full


def bytes_of_points(stream: BinaryIO, points_offset: int, end: int, file_size: int) -> int:
    """Bytes between the position of the table of chunks and the table, or ``end`` where none is there."""
    data = points_offset + 8
    table = _table_position(stream, data, file_size)
    return (table if data <= table <= file_size - 8 else end) - data


def _table_position(stream: BinaryIO, data: int, file_size: int) -> int:
    """Byte of the chunk table, as the file says."""
    stream.seek(data - 8)
    table = _int64(stream)
    if table == -1 and file_size >= data + 8:  # a writer that could not seek put the position last
        stream.seek(file_size - 8)
        table = _int64(stream)
    return table


def _int64(stream: BinaryIO) -> int:
    raw = stream.read(8)
    return int.from_bytes(raw, "little", signed=True) if len(raw) == 8 else -1


def layered_chunk(stream: BinaryIO, layout: LazLayout, start: int) -> tuple[int, int] | None:
    """Points and bytes that the chunk of layers at byte ``start`` says it has; None where the file ends.

    A chunk holds its first record raw, its number of points, the bytes of each layer, and the layers.
    """
    stream.seek(start + layout.item_size)
    head = stream.read(4 + 4 * layout.layers)
    if len(head) < 4 + 4 * layout.layers:
        return None
    points, *sizes = struct.unpack(f"<{1 + layout.layers}I", head)
    return points, layout.item_size + len(head) + sum(sizes)


def check_layers(stream: BinaryIO, layout: LazLayout, points_offset: int, first: int, stop: int) -> None:
    """Hold the layers of chunks ``first`` to ``stop`` against the table; raises LazDamage.

    lazrs allocates what a layer says it has, up to 4 GiB each, before it reads.
    """
    start = points_offset + 8 + int(layout.sizes[:first].sum())
    for chunk in range(first, stop):
        size = int(layout.sizes[chunk])
        claim = layered_chunk(stream, layout, start)
        if layout.counts[chunk] and (claim is None or claim[1] > size):
            raise LazDamage(
                f"chunk {chunk} says {claim[1] if claim else 'more'} bytes, its table {size}: damaged"
            )
        if layout.counts[chunk] and claim is not None and claim[0] != layout.counts[chunk]:
            raise LazDamage(f"chunk {chunk} has {claim[0]} points, by the header {layout.counts[chunk]}")
        start += size


def walk_chunks(
    stream: BinaryIO, layout: LazLayout, points_offset: int, file_size: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Points and bytes of the whole chunks of layers that are there, for a file without a usable table."""
    found: list[tuple[int, int]] = []
    start = points_offset + 8
    limit = layout.chunk_size or _VARIABLE
    while (claim := layered_chunk(stream, layout, start)) is not None:
        points, size = claim
        if not 0 < points <= limit or start + size > file_size:
            break
        found.append((points, size))
        start += size
        if layout.chunk_size is not None and points < layout.chunk_size:
            break
    table = np.asarray(found, dtype=np.int64).reshape(-1, 2)
    return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1])
