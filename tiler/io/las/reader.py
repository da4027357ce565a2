"""Reader of any range of records of a LAS or LAZ file, decoded in one thread.

When a task reads an input after the plan, `unchanged` checks that the file is the same.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import laspy
import lazrs
import numpy as np
import numpy.typing as npt

from tiler.errors import DiskFullError, InputError, TilerError
from tiler.io.cloud_formats import open_cloud
from tiler.io.cloud_reading import BLOCK_BYTES, reopen
from tiler.io.las.headers import AGAIN, LasHeader, read_header, refuse
from tiler.io.las.layout import CorruptLazError, LazLayout, check_layers, is_panic
from tiler.io.locations import FileState, state_of

Records = npt.NDArray[np.void]

COLOURS = lazrs.SELECTIVE_DECOMPRESS_RGB

NEEDED = (
    lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
    | lazrs.SELECTIVE_DECOMPRESS_Z
    | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
    | lazrs.SELECTIVE_DECOMPRESS_FLAGS
    | COLOURS
)
"""Layers of point formats 6 to 10 that a store keeps, colours not always. Other fields of the
decoded records are undefined."""

TO_SELECT = (
    NEEDED | lazrs.SELECTIVE_DECOMPRESS_SCAN_ANGLE | lazrs.SELECTIVE_DECOMPRESS_POINT_SOURCE_ID
)
"""Layers that a store keeps, and layers by which `tiler.core.selection` selects points."""

CLASS_LAYERS = (
    lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
)
"""Layers with the fields on which the layer of classes depends
(`tiler.io.las.writers.CLASS_RECORD`)."""

QUALITY = (
    lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
    | lazrs.SELECTIVE_DECOMPRESS_Z
    | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
    | lazrs.SELECTIVE_DECOMPRESS_FLAGS
    | lazrs.SELECTIVE_DECOMPRESS_INTENSITY
    | lazrs.SELECTIVE_DECOMPRESS_GPS_TIME
    | lazrs.SELECTIVE_DECOMPRESS_POINT_SOURCE_ID
)
"""Layers by which a specification of a survey judges its points (`tiler.apps.acceptance`)."""

EVERYTHING = lazrs.SELECTIVE_DECOMPRESS_ALL
COORDINATES = lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_Z

BYTES_PER_BATCH = 1 << 27
"""Maximum size of the decoded records that are read at a time. A single record may have 64
KiB."""

_STEP = 1 << 16


def rows_at_once(record_length: int, most: int) -> int:
    """Return the number of records to read at a time: ``most``, or fewer if they are long."""
    return max(min(most, BYTES_PER_BATCH // record_length), 1)


def record_dtype(point_format: int, record_length: int) -> np.dtype[np.void]:
    """Return the dtype of a record with the field names of laspy. The field ``extra`` contains all extra bytes."""
    fields: np.dtype[np.void] = laspy.PointFormat(point_format).dtype()
    extra = record_length - fields.itemsize
    if extra == 0:
        return fields
    return np.dtype([*fields.descr, ("extra", np.uint8, (extra,))])


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """Convert every error of a decoder about damaged bytes to an InputError that names the file.

    This includes the panic of a Rust extension, but not KeyboardInterrupt and SystemExit.
    """
    try:
        yield
    except (
        CorruptLazError,
        lazrs.LazrsError,
        OSError,
        ValueError,
        RuntimeError,
        OverflowError,
    ) as error:
        refuse(path, f"its points cannot be decoded ({_line(error)})", AGAIN)
    except BaseException as error:
        if not is_panic(error):
            raise
        refuse(path, f"its points make the decoder fail ({_line(error)})", AGAIN)


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


class PointReader:
    """Reader of ranges of records of one file. It is a context manager.

    Parameters
    ----------
    header : LasHeader
    selection : int
        Layers to decode (`NEEDED`, `EVERYTHING`, `COORDINATES`). Only point formats 6 to 10 have layers.
    block_bytes : int
        Bytes per request to a URL.
    ranges : sequence of (int, int), optional
        First record and number of records of each range that will be read, from its beginning to its end. The default
        is the whole file. Ranges are whole chunks, and only their bytes are requested from a URL.
    """

    def __init__(
        self,
        header: LasHeader,
        selection: int = NEEDED,
        block_bytes: int = BLOCK_BYTES,
        ranges: Sequence[tuple[int, int]] | None = None,
    ) -> None:
        self.header = header
        self._ranges = [(0, header.point_count)] if ranges is None else ranges
        self._stops = {start: start + count for start, count in ranges or ()}
        self.dtype = record_dtype(header.point_format, header.record_length)
        self._selection = selection
        with decoding(header.path):
            self._file: BinaryIO = open_cloud(
                header.path, block_bytes, _parts(header, ranges or ())
            )
            # The decoder needs the position of its file, so checks of the next chunks use a
            # separate file.
            self._probe: BinaryIO = reopen(self._file, header.path)
        self._decoder: Any = None
        self._next = 0

    def __enter__(self) -> PointReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._decoder = None
        self._file.close()
        self._probe.close()

    def read(self, start: int, count: int) -> Records:
        """Return records ``start`` to ``start + count - 1``, structured, shape (count,).

        Raise InputError if they cannot be decoded.
        """
        with decoding(self.header.path):
            if count <= 0:
                return np.empty(0, dtype=self.dtype)
            if self.header.laz is None:
                raw = self._read_plain(start, count)
            else:
                raw = self._read_compressed(self.header.laz, start, count)
            return np.frombuffer(raw, dtype=self.dtype)

    def pieces(self, most: int = 1_000_000) -> Iterator[Records]:
        """Yield all records of the ranges in their order, ``most`` at a time or fewer if they are long."""
        step = rows_at_once(self.header.record_length, most)
        for first, count in self._ranges:
            for start in range(first, first + count, step):
                yield self.read(start, min(step, first + count - start))

    def _read_plain(self, start: int, count: int) -> bytearray:
        length = self.header.record_length
        self._file.seek(self.header.points_offset + start * length)
        raw = bytearray(count * length)
        got = self._file.readinto(raw)  # type: ignore[attr-defined]
        if got != len(raw):
            raise CorruptLazError(f"{got} of {len(raw)} bytes from record {start} on")
        return raw

    def _read_compressed(self, layout: LazLayout, start: int, count: int) -> bytearray:
        first = stop = 0
        ends = np.cumsum(layout.counts)
        if layout.sizes.size:
            first, last = np.searchsorted(
                ends, (start, start + count - 1), side="right"
            ).tolist()
            stop = last + 1
            if layout.layers:
                check_layers(self._probe, layout, self.header.points_offset, first, stop)
        if self._decoder is None or start != self._next or start in self._stops:
            end = None
            known = self._stops.get(start)
            if known is not None:  # The decoder must not read beyond the range.
                end = int(np.searchsorted(ends, known - 1, side="right")) + 1
            self._decoder, self._next = self._open_decoder(layout, start, first, end)
            self._skip(start - self._next)
        raw = bytearray(count * self.header.record_length)
        self._decoder.decompress_many(raw)
        self._next = start + count
        return raw

    def _open_decoder(
        self, layout: LazLayout, start: int, chunk: int, stop: int | None
    ) -> tuple[Any, int]:
        """Return a decoder and the record that it decodes next: ``start`` or an earlier one of the same chunk.

        lazrs seeks to the right point only if there is a table and all chunks have the same
        size. With chunks of different sizes it would silently decode other points. In the other
        cases it gets a view of the file that begins with ``chunk`` and ends before chunk
        ``stop``.
        """
        selection = lazrs.DecompressionSelection(self._selection)
        if layout.chunk_size is not None and not layout.rebuilt:
            self._file.seek(self.header.points_offset)
            decoder = lazrs.LasZipDecompressor(self._file, layout.record_data, selection)
            decoder.seek(start)
            return decoder, start
        data = self.header.points_offset + 8
        skipped = first_record = 0
        if layout.sizes.size:
            skipped = int(layout.sizes[:chunk].sum())
            first_record = int(layout.counts[:chunk].sum())
            counts = layout.counts[chunk:stop].tolist()
            chunks = list(zip(counts, layout.sizes[chunk:stop].tolist(), strict=True))
        else:
            chunks = [(layout.chunk_size or 1, self.header.size - data)]
        view = _ChunkView(self._file, data + skipped, chunks, layout.record_data)
        return lazrs.LasZipDecompressor(
            io.BufferedReader(view), layout.record_data, selection
        ), first_record

    def _skip(self, count: int) -> None:
        most = rows_at_once(self.header.record_length, _STEP)
        while count > 0:
            step = min(most, count)
            self._decoder.decompress_many(bytearray(step * self.header.record_length))
            count -= step


def _parts(header: LasHeader, ranges: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return first and end byte of the chunks with some ranges of records. Adjacent chunks are joined."""
    if not ranges or header.laz is None:
        return []
    ends = np.cumsum(header.laz.counts)
    offsets = header.points_offset + 8 + np.concatenate([[0], np.cumsum(header.laz.sizes)])
    parts: list[tuple[int, int]] = []
    for start, count in ranges:
        first, last = np.searchsorted(ends, (start, start + count - 1), side="right").tolist()
        begin, end = int(offsets[first]), int(offsets[last + 1])
        if parts and parts[-1][1] == begin:
            begin = parts.pop()[0]
        parts.append((begin, end))
    return parts


class _ChunkView(io.RawIOBase):
    """Stream of some chunks of a LAZ file as if they were the whole file: position of the table, chunks, table.

    The chunks begin at byte ``start``, and ``chunks`` contains the number of points and bytes
    of each.
    """

    def __init__(
        self, file: BinaryIO, start: int, chunks: list[tuple[int, int]], record_data: bytes
    ) -> None:
        self._file = file
        self._start = start - 8
        table = io.BytesIO()
        lazrs.write_chunk_table(table, chunks, lazrs.LazVlr(record_data))
        self._table = table.getvalue()
        self._table_at = 8 + sum(size for _, size in chunks)
        self._pointer = self._table_at.to_bytes(8, "little")
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        end = self._table_at + len(self._table)
        self._position = (
            offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: end}[whence]
        )
        return self._position

    def readinto(self, target: Any) -> int:
        position = self._position
        if position < 8:
            part = self._pointer[position : position + len(target)]
        elif position < self._table_at:
            self._file.seek(self._start + position)
            part = self._file.read(min(len(target), self._table_at - position))
        else:
            part = self._table[position - self._table_at :][: len(target)]
        target[: len(part)] = part
        self._position += len(part)
        return len(part)


def count_decodable(header: LasHeader) -> int:
    """Return the number of points in a file. Without usable table and sizes in the chunks, decode and count them."""
    if header.laz is None or not header.laz.rebuilt or header.laz.sizes.size:
        return header.point_count
    n_points = 0
    with PointReader(header, COORDINATES) as reader, suppress(InputError):
        for records in reader.pieces(header.laz.chunk_size or _STEP):
            n_points += len(records)
    return n_points


_AGAIN = "run again once the file is complete"


@contextmanager
def unchanged(path: Path, stamp: list[Any] | None, salvage: bool) -> Iterator[LasHeader]:
    """Yield the header of a file, and check before and after the block that the file has not changed.

    Parameters
    ----------
    path : Path
    stamp : list, optional
        `LasHeader.stamp` in the plan, or None to check only that the file does not change during the block.
    salvage : bool
        See `tiler.io.las.headers.read_header`.

    Raises
    ------
    InputError
        The file has changed.
    """
    try:
        header = read_header(path, salvage)
        if stamp is not None and header.stamp != list(stamp):
            raise _changed(path, FileState(*stamp[:3]), header.state)
        yield header
    except DiskFullError:
        raise
    except TilerError:
        # A partly written file cannot be decoded, and its change is the true cause.
        if stamp is not None:
            validate_unchanged(path, FileState(*stamp[:3]))
        raise
    validate_unchanged(path, header.state)


def validate_unchanged(path: Path, state: FileState) -> None:
    """Raise InputError if a file is no longer in this state."""
    try:
        now = state_of(path)
    except OSError as error:
        raise InputError(
            f"{path}: was removed during the run ({error.strerror or error}); {_AGAIN}"
        ) from error
    if now != state:
        raise _changed(path, state, now)


def _changed(path: Path, before: FileState, now: FileState) -> InputError:
    how = "as large as before, with another time, tag or header"
    if before.size != now.size:
        how = f"{before.size:,} bytes before, {now.size:,} now"
    return InputError(f"{path}: was replaced or changed during the run ({how}); {_AGAIN}")
