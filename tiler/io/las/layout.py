"""Layout of a LAS or LAZ file besides its header: variable length records (VLRs and EVLRs), and the table of chunks.

Both are checked against the size of the file.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

import lazrs
import numpy as np

from ptd.arrays import Int64

_VLR = struct.Struct("<H16sHH32s")
_EVLR = struct.Struct("<H16sHQ32s")

PROJECTION_USER = "LASF_Projection"
LASZIP_USER = "laszip encoded"
LASZIP_RECORD = 22204
COPC_USER = "copc"

MAX_RECORDS = 10_000
"""Maximum number of records that are read: a large file could have more empty records than fit
into memory."""


@dataclass(frozen=True)
class Vlr:
    """Position of a VLR or EVLR in its file.

    Attributes
    ----------
    user_id : str
        User ID up to the first NUL.
    record_id : int
    start : int
        Byte offset of the record's own header.
    payload : int
        Byte offset of the content.
    length : int
        Length of the content in bytes.
    """

    user_id: str
    record_id: int
    start: int
    payload: int
    length: int

    @property
    def end(self) -> int:
        """Byte offset of the first byte after the record."""
        return self.payload + self.length

    @property
    def is_laszip(self) -> bool:
        """Whether the record describes the compression of the points."""
        return self.record_id == LASZIP_RECORD and self.user_id == LASZIP_USER

    @property
    def is_copc(self) -> bool:
        """Whether the record belongs to the octree of a COPC file."""
        return self.user_id == COPC_USER


def packed_record(
    user_id: str, record_id: int, description: str, payload: bytes, extended: bool = False
) -> bytes:
    """Return a complete VLR or EVLR as bytes."""
    form = _EVLR if extended else _VLR
    return (
        form.pack(0, user_id.encode(), record_id, len(payload), description.encode()) + payload
    )


def walk_records(
    stream: BinaryIO, start: int, count: int, end: int, extended: bool
) -> tuple[tuple[Vlr, ...], bool]:
    """Return the records from ``start`` that fit before ``end``, and whether all ``count`` records fit.

    Only the headers of the records are read, and at most `MAX_RECORDS` of them.
    """
    form = _EVLR if extended else _VLR
    records: list[Vlr] = []
    position = start
    for _ in range(min(count, MAX_RECORDS)):
        if position + form.size > end:
            return tuple(records), False
        stream.seek(position)
        _, user, record_id, length, _ = form.unpack(stream.read(form.size))
        payload = position + form.size
        if payload + length > end:
            return tuple(records), False
        name = user.split(b"\0")[0].decode("ascii", "replace")
        records.append(Vlr(name, record_id, position, payload, length))
        position = payload + length
    return tuple(records), count <= MAX_RECORDS


_LASZIP = struct.Struct("<HHBBHIIqqH")
_ITEM = struct.Struct("<HHH")
_POINTWISE_CHUNKED = 2
_LAYERED = 3
_VARIABLE = 2**32 - 1
"""Size of the chunks in a laszip record if the chunks have different sizes."""
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Number of layers by kind of item."""
_BYTE14 = 14
"""Kind of the item for extra bytes, which has one layer per byte."""
_ITEM_VERSION = 3

MAX_CHUNKS = 1 << 21
"""Maximum number of chunks of a file. With 50,000 points each, no file has more. A longer table
would fill memory."""


class CorruptLazError(Exception):
    """Fault of the compressed points, which callers convert to an InputError that names the file."""

    def __init__(self, problem: str, remedy: str = "get the file again") -> None:
        super().__init__(problem)
        self.remedy = remedy


def is_panic(error: BaseException) -> bool:
    """Return whether a Rust extension panicked, by the name of the exception.

    The class of the exception is not derived from Exception and cannot be imported.
    """
    return type(error).__name__ == "PanicException"


@dataclass(frozen=True)
class LazLayout:
    """Layout of compressed points.

    Attributes
    ----------
    record_data : bytes
        Content of the laszip record.
    chunk_size : int or None
        Number of points in a chunk, or None if chunks have different numbers of points (COPC).
    layers : int
        Number of compressed layers in a chunk (point formats 6 to 10), or 0 if whole points follow one another.
    item_size : int
        Size of one decoded record in bytes.
    counts, sizes : int64, shape (chunks,)
        Number of points and bytes of each chunk, empty if neither the table nor the chunks have them.
    rebuilt : bool
        Whether the file has no usable table, so that `counts` and `sizes` come from the chunks themselves.
    """

    record_data: bytes
    chunk_size: int | None
    layers: int
    item_size: int
    counts: Int64
    sizes: Int64
    rebuilt: bool = False

    @property
    def min_chunk(self) -> int:
        """Minimum size of a chunk in bytes."""
        if not self.layers:
            return self.item_size
        return self.item_size + 4 + 4 * self.layers


def parse_laszip(record_data: bytes) -> LazLayout:
    """Return the layout in a laszip record, without the chunk table. Raise CorruptLazError if the record is wrong."""
    if len(record_data) < _LASZIP.size:
        raise CorruptLazError(
            f"its laszip record has {len(record_data)} bytes, {_LASZIP.size} are needed"
        )
    fields = _LASZIP.unpack_from(record_data)
    compressor, *_, chunk_size, _, _, n_items = fields
    if compressor not in (_POINTWISE_CHUNKED, _LAYERED):
        raise CorruptLazError(
            f"compressor {compressor} of its laszip record is not known (2 and 3 are)"
        )
    if len(record_data) < _LASZIP.size + n_items * _ITEM.size or n_items == 0:
        raise CorruptLazError(
            f"its laszip record says {n_items} items and has {len(record_data)} bytes"
        )
    if (
        chunk_size == 0
    ):  # Some writers of COPC mean chunks of different sizes, whose numbers of points the table has.
        chunk_size = _VARIABLE
        record_data = with_chunk_size(record_data, chunk_size)
    items = [
        _ITEM.unpack_from(record_data, _LASZIP.size + i * _ITEM.size) for i in range(n_items)
    ]
    newer = [
        version for kind, _, version in items if kind in _LAYERS and version > _ITEM_VERSION
    ]
    if newer:
        raise CorruptLazError(
            f"its points are compressed by items of version {newer[0]}, {_ITEM_VERSION} can be read",
            "write it as LAS or with a program that makes LAZ of LAS 1.4",
        )
    layers = 0
    if compressor == _LAYERED:
        layers = sum(
            size if kind == _BYTE14 else _LAYERS.get(kind, 0) for kind, size, _ in items
        )
    return LazLayout(
        record_data=record_data,
        chunk_size=None if chunk_size == _VARIABLE else chunk_size,
        layers=layers,
        item_size=sum(size for _, size, _ in items),
        counts=np.empty(0, dtype=np.int64),
        sizes=np.empty(0, dtype=np.int64),
    )


def with_chunk_size(record_data: bytes, chunk_size: int) -> bytes:
    """Return the content of a laszip record with another number of points in a chunk."""
    fields = _LASZIP.unpack_from(record_data)
    start = _LASZIP.pack(*fields[:6], chunk_size, *fields[7:])
    return start + record_data[_LASZIP.size :]


def coding_of(record_data: bytes) -> tuple[int, int, bytes]:
    """Return what a laszip record says of the compression of points: compressor, coder, and all items."""
    compressor, coder, *_, n_items = _LASZIP.unpack_from(record_data)
    return compressor, coder, record_data[_LASZIP.size :][: n_items * _ITEM.size]


def read_table(
    stream: BinaryIO, layout: LazLayout, points_offset: int, file_size: int, point_count: int
) -> tuple[Int64, Int64]:
    """Return the number of points and bytes of every chunk, int64 each. Raise CorruptLazError if the table is wrong.

    The number of chunks is compared with the size of the file before lazrs reads the table.
    """
    data = points_offset + 8
    table = _table_position(stream, data, file_size)
    if not data <= table <= file_size - 8:
        raise CorruptLazError(
            f"its chunk table should be at byte {table} of {file_size}: the file is cut short or unfinished"
        )
    stream.seek(table)
    _, chunks = struct.unpack("<II", stream.read(8))
    # There may be one chunk more than needed, since some writers end with an empty chunk.
    if (chunks - 1) * layout.item_size > table - data or chunks > point_count + 1:
        raise CorruptLazError(
            f"its chunk table says {chunks} chunks, {table - data} bytes hold {point_count} points"
        )
    if chunks > MAX_CHUNKS:
        raise CorruptLazError(f"its chunk table says {chunks} chunks, {MAX_CHUNKS} can be read")
    stream.seek(points_offset)
    try:
        entries = np.asarray(
            lazrs.read_chunk_table(stream, lazrs.LazVlr(layout.record_data)), dtype=np.int64
        )
    except (lazrs.LazrsError, ValueError, OverflowError) as error:
        raise CorruptLazError(f"its chunk table cannot be read ({error})") from error
    except BaseException as error:
        if not is_panic(error):
            raise
        raise CorruptLazError(f"its chunk table makes the decoder fail ({error})") from error
    counts, sizes = entries.reshape(-1, 2).T
    counts = _true_counts(layout, counts, sizes, point_count)
    sizes = sizes[: counts.size]
    if sizes.size and (int(sizes.min()) < 0 or int(sizes.sum()) > table - data):
        raise CorruptLazError(
            f"its chunk table says {int(sizes.sum())} bytes of points, {table - data} are there"
        )
    return counts, np.ascontiguousarray(sizes)


def _true_counts(
    layout: LazLayout,
    counts: Int64,
    sizes: Int64,
    point_count: int,
) -> Int64:
    """Return the number of points in each chunk. The last chunk may not be full.

    Raise CorruptLazError if the numbers do not fit ``point_count``.
    """
    if layout.chunk_size is None:
        if int(counts.sum()) != point_count:
            raise CorruptLazError(
                f"its chunks have {int(counts.sum())} points, its header says {point_count}"
            )
        return np.ascontiguousarray(counts)
    needed = -(-point_count // layout.chunk_size)
    behind = int(sizes[needed]) if counts.size == needed + 1 else 0
    if not needed <= counts.size <= needed + 1 or behind >= layout.min_chunk:
        raise CorruptLazError(
            f"its chunk table has {counts.size} chunks, {point_count} points need {needed}"
        )
    full = np.full(needed, layout.chunk_size, dtype=np.int64)
    if needed:
        full[-1] = point_count - (needed - 1) * layout.chunk_size
    return full


def bytes_of_points(stream: BinaryIO, points_offset: int, end: int, file_size: int) -> int:
    """Return the size of the compressed points, which end at the chunk table, or at ``end`` if there is no table."""
    data = points_offset + 8
    table = _table_position(stream, data, file_size)
    if data <= table <= file_size - 8:
        end = table
    return end - data


def _table_position(stream: BinaryIO, data: int, file_size: int) -> int:
    """Return the first byte of the chunk table according to the file."""
    stream.seek(data - 8)
    table = _int64(stream)
    if (
        table == -1 and file_size >= data + 8
    ):  # A writer that cannot seek writes the position at the end of the file.
        stream.seek(file_size - 8)
        table = _int64(stream)
    return table


def _int64(stream: BinaryIO) -> int:
    raw = stream.read(8)
    return int.from_bytes(raw, "little", signed=True) if len(raw) == 8 else -1


def layered_chunk(stream: BinaryIO, layout: LazLayout, start: int) -> tuple[int, int] | None:
    """Return the number of points and bytes that the layered chunk at byte ``start`` states.

    The result is None at the end of the file. A chunk contains its first record uncompressed,
    its number of points, the sizes of the layers, and the layers.
    """
    head = read_chunk_head(stream, layout, start)
    if head is None:
        return None
    points, sizes = head
    return points, layout.min_chunk + sum(sizes)


def read_chunk_head(
    stream: BinaryIO, layout: LazLayout, start: int
) -> tuple[int, list[int]] | None:
    """Return the number of points, and the sizes of the layers, of the layered chunk at byte ``start``, or None."""
    stream.seek(start + layout.item_size)
    head = stream.read(4 + 4 * layout.layers)
    if len(head) < 4 + 4 * layout.layers:
        return None
    points, *sizes = struct.unpack(f"<{1 + layout.layers}I", head)
    return points, sizes


def check_layers(
    stream: BinaryIO, layout: LazLayout, points_offset: int, first: int, stop: int
) -> None:
    """Compare the layers of chunks ``first`` to ``stop - 1`` with the table. Raise CorruptLazError if they differ.

    Without this check, lazrs would allocate the size that a damaged layer states, up to 4 GiB.
    """
    start = points_offset + 8 + int(layout.sizes[:first].sum())
    for chunk in range(first, stop):
        if layout.counts[chunk]:
            checked_layers(stream, layout, chunk, start)
        start += int(layout.sizes[chunk])


def checked_layers(stream: BinaryIO, layout: LazLayout, chunk: int, start: int) -> list[int]:
    """Return the sizes of the layers of a chunk at byte ``start``. Raise CorruptLazError if the table has others."""
    size = int(layout.sizes[chunk])
    head = read_chunk_head(stream, layout, start)
    if head is None:
        raise CorruptLazError(
            f"chunk {chunk} says more bytes than the chunk table ({size}): damaged"
        )
    points, layer_sizes = head
    claimed = layout.min_chunk + sum(layer_sizes)
    if claimed > size:
        raise CorruptLazError(
            f"chunk {chunk} says {claimed} bytes, the chunk table {size}: damaged"
        )
    if points != layout.counts[chunk]:
        raise CorruptLazError(
            f"chunk {chunk} has {points} points, by the header {layout.counts[chunk]}"
        )
    return layer_sizes


def walk_chunks(
    stream: BinaryIO, layout: LazLayout, points_offset: int, file_size: int
) -> tuple[Int64, Int64]:
    """Return the number of points and bytes of the complete layered chunks of a file without a usable table."""
    chunks: list[tuple[int, int]] = []
    start = points_offset + 8
    limit = layout.chunk_size or _VARIABLE
    while (claim := layered_chunk(stream, layout, start)) is not None:
        points, size = claim
        if not 0 < points <= limit or start + size > file_size:
            break
        chunks.append((points, size))
        start += size
        if layout.chunk_size is not None and points < layout.chunk_size:
            break
    table = np.asarray(chunks, dtype=np.int64).reshape(-1, 2)
    return np.ascontiguousarray(table[:, 0]), np.ascontiguousarray(table[:, 1])
