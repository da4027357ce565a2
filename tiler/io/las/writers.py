"""Writers of points after the header, which the caller writes: as LAZ, LAS, or COPC 1.0. lazrs compresses points.

If only the classes of a LAZ file change, its other layers are copied as bytes. COPC is LAZ whose chunks are nodes of
an octree (https://copc.io).
"""

from __future__ import annotations

import os
import struct
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import Any, BinaryIO

import lazrs
import numpy as np

from ptd.arrays import Int8, Int64
from tiler.io.las.class_layer import ClassEncoder
from tiler.io.las.headers import LasHeader
from tiler.io.las.layout import (
    COPC_USER,
    LASZIP_RECORD,
    LASZIP_USER,
    checked_layers,
    coding_of,
    packed_record,
    with_chunk_size,
)
from tiler.io.las.octree import (
    CELLS_OF_NODE,
    DEPTH,
    Key,
    Levels,
    Places,
    curve,
    octree_batches,
    runs,
)
from tiler.io.las.reader import Records, decoding, rows_at_once

_COPY = 1 << 20
_CLASS_BYTE = 16
"""Position of the class in a record of formats 6 to 10."""
_CLASS_LAYER = 2
"""Number of the layer of classes, after those of x and y and of z."""
CLASS_RECORD = np.dtype(
    [(name, "u1") for name in ("classification", "bit_fields", "classification_flags")]
)
"""Fields that the layer of classes depends on: class, byte with the returns, and byte with the flags and the scanner
channel."""
MAX_CHUNK_POINTS = 1 << 22
"""Largest chunk whose layers are copied, since its classes are in memory. LASzip makes chunks of 50,000 points."""


def laszip_vlr(
    header: LasHeader, own_sizes: bool = False, chunk_points: int | None = None
) -> bytes:
    """Return the laszip record for points like those of ``header``, in chunks of equal or different sizes.

    Equal chunks have ``chunk_points`` points, by default as many as `PointWriter` writes.
    """
    data = bytes(_layout_of(header, own_sizes).record_data())
    if chunk_points is not None:
        data = with_chunk_size(data, chunk_points)
    return packed_record(LASZIP_USER, LASZIP_RECORD, "lazrs", data)


def _layout_of(header: LasHeader, own_sizes: bool = False) -> Any:
    """Return lazrs' settings for points like those of ``header``, in chunks of equal or different sizes."""
    bare = lazrs.LazVlr.new_for_compression(header.point_format, 0).item_size()
    return lazrs.LazVlr.new_for_compression(
        header.point_format, header.record_length - bare, own_sizes
    )


class PointWriter:
    """Writer of compressed records from the current position of ``target``. `close` adds the chunk table.

    Parameters
    ----------
    target : BinaryIO
        Seekable file, whose position after `close` is undefined.
    header : LasHeader
        Header of a file with the same point format and record length.
    threads : int
        Number of threads that compress chunks, which does not change the bytes. The first number above 1 in a process
        applies to all its writers.
    """

    def __init__(self, target: BinaryIO, header: LasHeader, threads: int = 1) -> None:
        self._compressor: Any
        if threads > 1:
            # The default of this variable is the number of cores.
            os.environ.setdefault("RAYON_NUM_THREADS", str(threads))
            self._compressor = lazrs.ParLasZipCompressor(target, _layout_of(header))
        else:
            self._compressor = lazrs.LasZipCompressor(target, _layout_of(header))

    def write(self, records: Records) -> None:
        """Append records. Raise OSError if they cannot be written."""
        try:
            self._compressor.compress_many(np.ascontiguousarray(records).view(np.uint8))
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error

    def close(self) -> None:
        """Write the remaining points and the chunk table. Raise OSError if they cannot be written."""
        try:
            self._compressor.done()
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error


def has_class_layer(header: LasHeader) -> bool:
    """Return whether the layers of a file can be copied with other classes.

    They can if the file is LAZ of formats 6 to 10, is not damaged, has chunks of equal size, and
    its points are compressed as lazrs would. Chunks of different sizes, as in COPC, are
    written again in equal ones, in which more programs find points.
    """
    layout = header.laz
    return (
        layout is not None
        and layout.layers > 0
        and not header.salvaged
        and not layout.rebuilt
        and layout.chunk_size is not None
        and 0 < layout.counts.size == layout.sizes.size
        and int(layout.counts.max()) <= MAX_CHUNK_POINTS
        and coding_of(layout.record_data) == coding_of(bytes(_layout_of(header).record_data()))
    )


class ClassWriter:
    """Writer of the chunks of a LAZ file with other classes, from the current position of ``target``.

    Only the layer of classes is encoded. The chunk table is written by `close`.

    Parameters
    ----------
    target : BinaryIO
        Seekable file, whose position after `close` is undefined.
    source : BinaryIO
        File whose layers are copied.
    header : LasHeader
        Header of ``source``, for which `has_class_layer` is True.
    """

    def __init__(self, target: BinaryIO, source: BinaryIO, header: LasHeader) -> None:
        if header.laz is None:
            raise ValueError(f"{header.path} is not compressed")
        self._target, self._source, self._path = target, source, header.path
        self._layout = header.laz
        self._begin = target.tell()
        self._start = header.points_offset + 8
        self._encoder = ClassEncoder()
        # fields of `CLASS_RECORD` of the points of the current chunk
        self._points = np.empty((3, int(self._layout.counts.max())), np.uint8)
        self._filled = 0
        self._chunks: list[tuple[int, int]] = []
        target.write(bytes(8))

    def write(self, records: Records) -> None:
        """Append records in the order of the source. Only the fields of `CLASS_RECORD` are used.

        Raise InputError if a chunk of the source is damaged.
        """
        rest = records
        while len(rest):
            wanted = int(self._layout.counts[len(self._chunks)])
            part = rest[: wanted - self._filled]
            end = self._filled + len(part)
            for values, name in zip(self._points, CLASS_RECORD.names or (), strict=True):
                values[self._filled : end] = part[name]
            self._filled = end
            if end == wanted:
                self._write_chunk(wanted)
            rest = rest[len(part) :]

    def _write_chunk(self, count: int) -> None:
        layout, start = self._layout, self._start
        with decoding(self._path):
            sizes = checked_layers(self._source, layout, len(self._chunks), start)
        layer = self._encoder.encode(*self._points[:, :count])
        new_sizes = [*sizes[:_CLASS_LAYER], len(layer), *sizes[_CLASS_LAYER + 1 :]]
        head = struct.pack(f"<{1 + layout.layers}I", count, *new_sizes)
        copy_bytes(self._source, self._target, start, start + _CLASS_BYTE)
        self._target.write(self._points[0, :1].tobytes())
        copy_bytes(
            self._source, self._target, start + _CLASS_BYTE + 1, start + layout.item_size
        )
        self._target.write(head)
        data = start + layout.min_chunk
        before, after = sum(sizes[:_CLASS_LAYER]), sum(sizes[: _CLASS_LAYER + 1])
        copy_bytes(self._source, self._target, data, data + before)
        self._target.write(layer)
        copy_bytes(self._source, self._target, data + after, data + sum(sizes))
        self._start += int(layout.sizes[len(self._chunks)])
        self._chunks.append((count, layout.min_chunk + sum(new_sizes)))
        self._filled = 0

    def close(self) -> None:
        """Write the chunk table. Raise OSError if it cannot be written."""
        table = self._begin + 8 + sum(size for _, size in self._chunks)
        try:
            lazrs.write_chunk_table(
                self._target, self._chunks, lazrs.LazVlr(self._layout.record_data)
            )
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error
        self._target.seek(self._begin)
        self._target.write(struct.pack("<q", table))


def copy_bytes(source: BinaryIO, target: BinaryIO, start: int, stop: int) -> None:
    """Copy bytes ``start`` to ``stop`` of the source, in bounded pieces. Raise OSError if the source ends before."""
    source.seek(start)
    left = stop - start
    while left > 0:
        part = source.read(min(left, _COPY))
        if not part:
            raise OSError(f"the source ends at byte {stop - left}")
        target.write(part)
        left -= len(part)


class PlainWriter:
    """Writer of records without compression from the current position of ``target``."""

    def __init__(self, target: BinaryIO) -> None:
        self._target = target

    def write(self, records: Records) -> None:
        """Append records. Raise OSError if they cannot be written."""
        self._target.write(np.ascontiguousarray(records).view(np.uint8).data)

    def close(self) -> None:
        """Do nothing, since all records are written."""


HEADER_BYTES = 375
INFO_BYTES = 54 + 160
"""Size of the info record, which is the first record after the header, in bytes."""
BRICK_POINTS = 1 << 19
"""Number of points that are distributed to nodes at a time."""

_INFO_RECORD = 1
_HIERARCHY_RECORD = 1000
_INFO = struct.Struct("<5dQQdd88x")
_ENTRY = struct.Struct("<iiiiQii")
_AXES = ("X", "Y", "Z")


@dataclass(frozen=True)
class _Cube:
    """Cube of an octree.

    Attributes
    ----------
    corner : tuple of 3 int
        Lowest corner, in the integers of the records.
    sides : tuple of 3 float
        Side along each axis, in the integers of the records.
    centre : tuple of 3 float
        Centre, in units of the CRS.
    half : float
        Half a side, in units of the CRS.
    """

    corner: tuple[int, ...]
    sides: tuple[float, ...]
    centre: tuple[float, ...]
    half: float

    def places(self, records: Records) -> Places:
        """Return the positions of records in the cube."""
        positions = np.empty((3, len(records)), dtype=np.int32)
        for axis, (name, low, side) in enumerate(
            zip(_AXES, self.corner, self.sides, strict=True)
        ):
            raised = (records[name].astype(np.int64) - low) * (2**DEPTH / side)
            positions[axis] = np.clip(raised, 0, 2**DEPTH - 1)
        return positions


class CopcWriter:
    """Writer of records of format 6, 7 or 8 after the header, which the caller writes. `close` makes the octree.

    It is a context manager.

    Parameters
    ----------
    target : BinaryIO
        File, at the position where the points begin.
    header : LasHeader
        Header for the records.
    folder : str
        Folder for temporary files, which need twice the size of all records.
    """

    def __init__(self, target: BinaryIO, header: LasHeader, folder: str) -> None:
        self._target = target
        self._header = header
        self._folder = folder
        self._begin = target.tell()
        self._step = rows_at_once(header.record_length, BRICK_POINTS)
        self._spool = TemporaryFile(dir=folder)  # noqa: SIM115 - closed at the end of the context
        self._dtype: np.dtype[np.void] | None = None
        self._points = 0
        self._low = [2**31] * 3
        self._high = [-(2**31)] * 3
        self._times = [np.inf, -np.inf]
        self._entries: list[tuple[Key, int]] = []
        self.hierarchy_start = 0

    def __enter__(self) -> CopcWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self._spool.close()

    def write(self, records: Records) -> None:
        """Append records."""
        if not len(records):
            return
        self._dtype = records.dtype
        records.tofile(self._spool)
        self._points += len(records)
        for axis, name in enumerate(_AXES):
            self._low[axis] = min(self._low[axis], int(records[name].min()))
            self._high[axis] = max(self._high[axis], int(records[name].max()))
        times = records["gps_time"][np.isfinite(records["gps_time"])]
        if times.size:
            low, high = self._times
            self._times = [min(low, float(times.min())), max(high, float(times.max()))]

    def close(self) -> None:
        """Write points, chunk table, hierarchy and the info record. Raise OSError if they cannot be written."""
        layout = _layout_of(self._header, own_sizes=True)
        cube = self._cube()
        try:
            compressor = lazrs.LasZipCompressor(self._target, layout)
            for key, records in self._nodes(cube):
                if self._entries:
                    compressor.finish_current_chunk()
                compressor.compress_many(np.ascontiguousarray(records).view(np.uint8))
                self._entries.append((key, len(records)))
            compressor.done()
            self._target.flush()
            self._target.seek(self._begin)
            table = lazrs.read_chunk_table(self._target, layout)
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error
        self._write_hierarchy(cube, table)

    def _write_hierarchy(self, cube: _Cube, table: list[tuple[int, int]]) -> None:
        offset = self._begin + 8
        entries = b""
        # Without points there is one chunk and no entry.
        for (key, points), (_, size) in zip(self._entries, table, strict=False):
            entries += _ENTRY.pack(*key, offset, size, points)
            offset += size
        self._target.seek(0, 2)
        record = packed_record(
            COPC_USER, _HIERARCHY_RECORD, "EPT hierarchy", entries, extended=True
        )
        self.hierarchy_start = self._target.tell()
        page = self.hierarchy_start + len(record) - len(entries)
        self._target.write(record)
        times = self._times if self._times[0] <= self._times[1] else [0.0, 0.0]
        info = _INFO.pack(
            *cube.centre,
            cube.half,
            2 * cube.half / 2**CELLS_OF_NODE,
            page,
            len(entries),
            *times,
        )
        self._target.seek(HEADER_BYTES)
        self._target.write(packed_record(COPC_USER, _INFO_RECORD, "COPC info VLR", info))
        self._target.seek(0, 2)

    def _cube(self) -> _Cube:
        """Return the cube around all points, one integer wider so that no point lies on its far side."""
        scales, offsets = self._header.scales, self._header.offsets
        low, high = [0] * 3, [0] * 3
        if self._points:
            low, high = self._low, self._high
        side = max((b - a + 1) * scale for a, b, scale in zip(low, high, scales, strict=True))
        corner = [
            a * scale + offset for a, scale, offset in zip(low, scales, offsets, strict=True)
        ]
        return _Cube(
            corner=tuple(low),
            sides=tuple(side / scale for scale in scales),
            centre=tuple(c + side / 2 for c in corner),
            half=side / 2,
        )

    def _pieces(self) -> Iterator[Records]:
        """Yield all records in their order from the temporary file, which is then closed."""
        self._spool.seek(0)
        with self._spool:
            while raw := self._spool.read(self._step * self._header.record_length):
                yield np.frombuffer(raw, dtype=self._dtype)

    def _nodes(self, cube: _Cube) -> Iterator[tuple[Key, Records]]:
        """Yield nodes and their points, sorted by GPS time. A node larger than a brick comes after all its bricks."""
        levels = Levels()
        above: dict[Key, list[Records]] = defaultdict(list)
        if not self._points:
            return
        for brick, unsorted in octree_batches(
            self._pieces(), self._points, self._step, cube.places, self._folder
        ):
            done = sorted((key for key in above if not _holds(key, brick)), reverse=True)
            for key in done:
                yield key, _by_time(np.concatenate(above.pop(key)))
            records = _by_time(unsorted)
            places = cube.places(records)
            level_of = levels.of_brick(brick, places)
            for key, rows in _of_levels(places, level_of, brick):
                if key[0] < brick[0]:
                    above[key].append(records[rows])
                else:
                    yield key, records[rows]
        for key in sorted(above, reverse=True):
            yield key, _by_time(np.concatenate(above[key]))


def _of_levels(places: Places, level_of: Int8, brick: Key) -> list[tuple[Key, Int64]]:
    """Return nodes and the ascending rows of their points. Nodes near each other follow one another."""
    nodes: list[tuple[Key, Int64]] = []
    for level in np.unique(level_of).tolist():
        rows = np.flatnonzero(level_of == level)
        corners = places[:, rows] >> DEPTH - level
        number = (
            (corners[0].astype(np.int64) << 42)
            | (corners[1].astype(np.int64) << 21)
            | corners[2]
        )
        order = np.argsort(number, kind="stable")
        starts = runs(number[order])[0]
        keys = corners[:, order[starts]].T.tolist()
        parts = np.split(rows[order], starts[1:])
        nodes += [((level, *key), part) for key, part in zip(keys, parts, strict=True)]
    corners = np.array(
        [[v << DEPTH - key[0] for v in key[1:]] for key, _ in nodes], dtype=np.int32
    ).T
    along = curve(corners, brick[0])
    levels = np.array([key[0] for key, _ in nodes])
    return [nodes[i] for i in np.lexsort((levels, along)).tolist()]


def _holds(key: Key, brick: Key) -> bool:
    """Return whether the cube of a node contains a brick."""
    down = brick[0] - key[0]
    return down >= 0 and all(b >> down == k for b, k in zip(brick[1:], key[1:], strict=True))


def _by_time(records: Records) -> Records:
    """Sort records by GPS time, the order that compresses best."""
    return records[np.argsort(records["gps_time"], kind="stable")]
