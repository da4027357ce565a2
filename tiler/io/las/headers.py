"""LAS headers, with all fields checked against the file.

The layout is that of the LAS specification 1.5 R00, tables of the header, of VLRs and of EVLRs.
The headers of LAS 1.0 to 1.4 are prefixes of it.
"""

from __future__ import annotations

import math
import os
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from tiler.core.records import new_digest
from tiler.errors import InputError
from tiler.io.cloud_formats import FORMAT_NAMES, open_cloud
from tiler.io.foreign_content import packing_of
from tiler.io.las.layout import (
    CorruptLazError,
    LazLayout,
    Vlr,
    bytes_of_points,
    parse_laszip,
    read_table,
    walk_chunks,
    walk_records,
)
from tiler.io.locations import FileState, is_url, reading_remedy, state_of

_BLOCK_BYTES = 1 << 14
"""Bytes per request to a URL. The bytes before the points, the chunk table or a record are
seldom more."""
_BLOCK = struct.Struct("<4sHH16sBB32s32sHHHIIBHI5I12d")
_LAS14 = struct.Struct("<QQIQ")
_RETURNS14 = struct.Struct("<15Q")
_LAS15 = struct.Struct("<ddH")

HEADER_SIZES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}
"""Length of the header by minor version, in bytes."""
_POSITION = struct.Struct("<3i")
_PROBED = 1000
"""Largest number of records behind the last point that are looked at."""
_RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
_WKT_BIT = 0x10
_STANDARD_TIME_BIT, _TIME_OFFSET_BIT = 0x01, 0x40
_WITHOUT_TIME = (0, 2)
_OLDEST_FORMAT_15 = 6
_UNKNOWN = 1 << 40
"""Number of points of a compressed file whose header does not give it."""
_MANY = 10_000_000
"""Number of points above which a file is checked for being a decompression bomb."""
_DENSEST = 1000
"""Number of points per compressed byte above which a file is refused as a bomb. Real clouds
have less than one."""

FINEST_SCALE = 1e-9
"""Smallest scale factor, in units of the CRS. With a smaller one all points would lie within
four units."""
COARSEST_SCALE = 1e3
"""Largest scale factor, in units of the CRS. With a larger one the points would not be on
earth."""

AGAIN = "get the file again"
SALVAGE = "get the file again, or read its intact part with --salvage"


@dataclass(frozen=True)
class LasHeader:
    """Header of a file, with values that are possible in this file.

    Attributes
    ----------
    path : Path
    state : FileState
        State of the file when the header was read.
    size : int
        Size in bytes of the LAS or LAZ file, or of the one as which a file of another format is read.
    version : tuple of int
    global_encoding, header_size, points_offset, record_length : int
    point_format : int
        Format without the bit for compression.
    point_count : int
        Number of points that can be read.
    stated_points : int
        Number of points that the file states, 0 if it states none.
    salvaged : bool
        Whether the file is damaged and is read nevertheless.
    unread_points : int
        Number of records behind the last point that the file states, which are only read with salvage.
    scales, offsets : tuple of 3 float
        Scales from `FINEST_SCALE` to `COARSEST_SCALE`, and finite offsets.
    mins, maxs : tuple of 3 float
        Bounds in the header, which may be wrong, or all NaN if the writer did not know them.
    waveform_start : int
        First byte of the waveform packets (LAS 1.3 and later), or 0.
    evlrs_start : int
        First byte of the EVLRs according to the header (LAS 1.4), or 0.
    vlrs, evlrs : tuple of Vlr
        Records that were found.
    laz : LazLayout or None
        Layout of the compressed points, or None if the points are not compressed.
    digest : str
        Digest of the bytes before the points and of the chunk table.
    notes : tuple of str
        Harmless faults of the file, and with salvage also damage.
    created : tuple of int
        Year and day of the year (1 to 366) on which the file was made, 0 if unknown.
    gps_times : tuple of 2 float, or None
        First and last GPS time in a LAS 1.5 header. None if both are 0, and in earlier versions.
    time_offset : int or None
        Millions of seconds that were subtracted from the GPS times of the points, if the global encoding of LAS 1.5
        has the bit for it.
    points_by_return : tuple of int
        Number of points of each return, from the first one, as the header states them: 5, or 15 in LAS 1.4 and later.
    """

    path: Path
    state: FileState
    size: int
    version: tuple[int, int]
    global_encoding: int
    header_size: int
    points_offset: int
    point_format: int
    record_length: int
    point_count: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    mins: tuple[float, float, float]
    maxs: tuple[float, float, float]
    waveform_start: int
    evlrs_start: int = 0
    vlrs: tuple[Vlr, ...] = ()
    evlrs: tuple[Vlr, ...] = ()
    laz: LazLayout | None = None
    digest: str = ""
    notes: tuple[str, ...] = ()
    created: tuple[int, int] = (0, 0)
    gps_times: tuple[float, float] | None = None
    time_offset: int | None = None
    stated_points: int = 0
    salvaged: bool = False
    unread_points: int = 0
    points_by_return: tuple[int, ...] = ()

    @property
    def stamp(self) -> list[Any]:
        """State and digest, which change if the file changes (see `tiler.io.las.reader`)."""
        return [*self.state.to_json(), self.digest]

    @property
    def has_bounds(self) -> bool:
        """Whether any of the bounds in the header is a number."""
        return not all(map(math.isnan, (*self.mins, *self.maxs)))

    @property
    def prefers_wkt(self) -> bool:
        """Whether the global encoding has the bit for a CRS in the WKT record."""
        return bool(self.global_encoding & _WKT_BIT)

    @property
    def has_standard_times(self) -> bool:
        """Whether the points have adjusted standard GPS times, which give dates."""
        standard = self.global_encoding & _STANDARD_TIME_BIT
        return bool(standard) and self.point_format not in _WITHOUT_TIME

    @property
    def points_end(self) -> int:
        """End of the bytes that can contain points: the first byte of waveforms or EVLRs, or the end of the file."""
        starts = (self.waveform_start, self.evlrs_start, self.size)
        return min(start for start in starts if self.points_offset <= start <= self.size)

    def noted(self, text: str) -> LasHeader:
        """Return a copy of the header with one more note."""
        return replace(self, notes=(*self.notes, text))


def refuse(path: Path, what: str, remedy: str = AGAIN) -> NoReturn:
    """Raise an InputError."""
    raise InputError(f"{path}: {what}; {remedy}")


def _salvaged(header: LasHeader, what: str, salvage: bool) -> LasHeader:
    """Return the header with a note about its damage. Raise InputError if ``salvage`` is False."""
    if not salvage:
        refuse(header.path, what, SALVAGE)
    return replace(header.noted(what), salvaged=True)


def read_header(path: Path, salvage: bool = False) -> LasHeader:
    """Read the header of a LAS or LAZ file and check it against the file.

    Parameters
    ----------
    path : Path
    salvage : bool
        Whether to use the complete records or chunks of a file that is cut short.

    Raises
    ------
    InputError
        The file cannot be opened, is not a LAS file, or its header contradicts the file.
    """
    try:
        state = state_of(path)
        # Opening a pipe would wait for its other end.
        if not is_url(path) and not path.is_file():
            refuse(path, "is not a regular file", f"give {FORMAT_NAMES} files")
        with open_cloud(path, _BLOCK_BYTES) as stream:
            header = _fixed_block(path, stream, state, salvage)
            header = _records(header, stream)
            if header.laz is None:
                header = _plain_points(header, stream, salvage)
            else:
                header = _compressed_points(header, header.laz, stream, salvage)
            if header.point_count == 0 and header.notes and salvage:
                refuse(path, f"{header.notes[-1]}; not one point can be salvaged")
            return replace(_extended(header, stream, salvage), digest=_digest(header, stream))
    except OSError as error:
        refuse(
            path,
            f"cannot be read ({error.strerror or error})",
            reading_remedy(path, f"give a readable {FORMAT_NAMES} file"),
        )


def stated_bounds(path: str) -> list[float] | None:
    """Return west, south, east and north in the header of a LAS or LAZ file that may be damaged, or None."""
    try:
        if not Path(path).is_file():
            return None
        with open(path, "rb") as stream:
            raw = stream.read(_BLOCK.size)
    except (OSError, ValueError):  # A name with a NUL.
        return None
    if raw[:4] != b"LASF" or len(raw) < _BLOCK.size:
        return None
    east, west, north, south = _BLOCK.unpack(raw)[-6:-2]
    is_area = -math.inf < west < east < math.inf and -math.inf < south < north < math.inf
    return [west, south, east, north] if is_area else None


def read_payload(path: Path, record: Vlr, limit: int = 1 << 24) -> bytes:
    """Return the content of a record, at most ``limit`` bytes."""
    with open_cloud(path, _BLOCK_BYTES) as stream:
        stream.seek(record.payload)
        return stream.read(min(record.length, limit))


def _fixed_block(path: Path, stream: BinaryIO, state: FileState, salvage: bool) -> LasHeader:
    """Return the header with only the fields of the public header block."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    raw = stream.read(HEADER_SIZES[5])
    if not raw:
        refuse(path, "is empty")
    if raw[:4] != b"LASF":
        if packing := packing_of(raw):
            refuse(
                path,
                f"is a file that is packed with {packing}, not a LAS or LAZ file",
                "unpack it and give the LAS or LAZ files in it",
            )
        refuse(
            path,
            f"begins with {raw[:4]!r}, not with LASF: not a LAS or LAZ file",
            f"give {FORMAT_NAMES} files",
        )
    if len(raw) < _BLOCK.size:
        refuse(path, f"has {size} bytes, its header alone needs {_BLOCK.size}")
    fields = _BLOCK.unpack_from(raw)
    encoding, major, minor = fields[2], fields[4], fields[5]
    header_size, points_offset, _, form, length, legacy_count = fields[10:16]
    if major != 1 or minor not in HEADER_SIZES:
        refuse(
            path, f"is LAS {major}.{minor}, LAS 1.0 to 1.5 can be read", "convert it to LAS 1.4"
        )
    least = HEADER_SIZES[minor]
    if size < least:
        refuse(path, f"has {size} bytes, its header alone needs {least}")
    unfinished = header_size == 0 and points_offset == 0
    if unfinished and not salvage:
        refuse(
            path,
            "its header was never finished (header size 0): its writer was stopped",
            SALVAGE,
        )
    if unfinished:
        header_size = least
    elif not least <= header_size <= points_offset <= size:
        problem = f"says header of {header_size} bytes, points from byte {points_offset}, in a file of {size}"
        refuse(path, problem)
    plain = form & 0x3F
    if form & 0x40 or plain >= len(_RECORD_SIZES):
        refuse(path, f"point format {form} is not known, 0 to 10 are", "convert it to LAS 1.4")
    if length < _RECORD_SIZES[plain]:
        refuse(
            path, f"says records of {length} bytes, format {plain} needs {_RECORD_SIZES[plain]}"
        )
    bounds = fields[27:33]
    by_return = fields[16:21]
    waveform = evlrs = 0
    count = legacy_count
    if minor == 3:
        (waveform,) = struct.unpack_from("<Q", raw, 227)
    if minor >= 4:
        waveform, evlrs, n_evlrs, count = _LAS14.unpack_from(raw, 227)
        if count:
            by_return = _RETURNS14.unpack_from(raw, 227 + _LAS14.size)
        if n_evlrs == 0:
            evlrs = 0
    header = LasHeader(
        path=path,
        state=state,
        size=size,
        version=(major, minor),
        global_encoding=encoding,
        header_size=header_size,
        points_offset=points_offset,
        point_format=plain,
        record_length=length,
        point_count=count or legacy_count,
        stated_points=count or legacy_count,
        salvaged=unfinished,
        scales=fields[21:24],
        offsets=fields[24:27],
        mins=bounds[1::2],
        maxs=bounds[0::2],
        waveform_start=waveform,
        evlrs_start=evlrs,
        created=(fields[9], fields[8]),
        points_by_return=by_return,
    )
    if not all(FINEST_SCALE <= scale <= COARSEST_SCALE for scale in header.scales):
        problem = f"has scale factors {header.scales}, not all from {FINEST_SCALE:g} to {COARSEST_SCALE:g}"
        refuse(path, problem, "write it again with scales like 0.001")
    if not all(math.isfinite(o) for o in header.offsets):
        refuse(path, f"offsets {header.offsets} are not all finite")
    if minor >= 5:
        header = _with_times(header, raw)
    if count and legacy_count not in (0, count):
        problem = (
            f"says {count} points, and {legacy_count} in the field of LAS 1.3; {count} counts"
        )
        header = header.noted(problem)
    return header


def _with_times(header: LasHeader, raw: bytes) -> LasHeader:
    """Return the header with the fields that LAS 1.5 added."""
    last, first, offset = _LAS15.unpack_from(raw, HEADER_SIZES[4])
    if header.point_format < _OLDEST_FORMAT_15:
        header = header.noted(
            f"has points of format {header.point_format}; LAS 1.5 has formats 6 to 10"
        )
    # GPS week times have no offset.
    if header.has_standard_times and header.global_encoding & _TIME_OFFSET_BIT:
        header = replace(header, time_offset=offset)
    if first == last == 0:
        return header
    if not first <= last:
        return header.noted(f"says GPS times from {first} to {last}")
    return replace(header, gps_times=(first, last))


def _records(header: LasHeader, stream: BinaryIO) -> LasHeader:
    """Return the header with its VLRs and, from them, the compression of the points."""
    unfinished = header.points_offset == 0
    stream.seek(100)
    count, form = struct.unpack("<IB", stream.read(5))
    compressed = bool(form & 0x80)
    end = header.size if unfinished else header.points_offset
    vlrs, whole = walk_records(stream, header.header_size, count, end, extended=False)
    if not whole:
        # Only a wrong count is harmless. If the points do not fit either, the file is damaged.
        fits = (
            compressed
            or header.points_offset + header.point_count * header.record_length <= header.size
        )
        if not fits or unfinished:
            refuse(
                header.path,
                f"says {count} variable length records, there is room for {len(vlrs)}",
            )
        header = header.noted(f"says {count} variable length records, {len(vlrs)} are there")
    if unfinished:
        start = vlrs[-1].end if vlrs else header.header_size
        room = _UNKNOWN if compressed else (header.size - start) // header.record_length
        header = replace(header, points_offset=start, point_count=room).noted(
            "header unfinished: rebuilt"
        )
    header = replace(header, vlrs=vlrs)
    if not compressed:
        return header
    laszip = next((v for v in vlrs if v.is_laszip), None)
    if laszip is None:
        refuse(header.path, "says that it is compressed and has no laszip record")
    stream.seek(laszip.payload)
    try:
        layout = parse_laszip(stream.read(laszip.length))
    except CorruptLazError as damage:
        refuse(header.path, str(damage), damage.remedy)
    if layout.item_size != header.record_length:
        problem = f"says records of {header.record_length} bytes, its laszip record {layout.item_size}"
        refuse(header.path, problem)
    return replace(header, laz=layout)


def _plain_points(header: LasHeader, stream: BinaryIO, salvage: bool) -> LasHeader:
    """Check the number of points of a LAS file against the bytes for them."""
    room = (header.points_end - header.points_offset) // header.record_length
    if header.point_count == 0 and room:
        problem = f"says 0 points, has room for {room}: it was never finished"
        return replace(_salvaged(header, problem, salvage), point_count=room)
    if header.point_count < room:
        problem = f"says {header.point_count} points, has room for {room}"
        if not _are_points(header, stream, room - header.point_count):
            return header.noted(f"{problem}: the rest is not read")
        if salvage:
            return replace(_salvaged(header, problem, salvage), point_count=room)
        header = header.noted(f"{problem}, and the rest looks like points")
        return replace(header, unread_points=room - header.point_count)
    room = max(header.size - header.points_offset, 0) // header.record_length
    if header.point_count <= room:
        return header
    problem = f"says {header.point_count} points, has room for {room}: cut short"
    return replace(_salvaged(header, problem, salvage), point_count=room)


def _are_points(header: LasHeader, stream: BinaryIO, n_records: int) -> bool:
    """Return whether most records behind the last point lie in the bounds of the header or beside them.

    Bytes of another meaning would be coordinates all over the earth. Records of zeros are room that was not used.
    """
    stream.seek(header.points_offset + header.point_count * header.record_length)
    raw = stream.read(min(n_records, _PROBED) * header.record_length)
    axes = list(zip(header.scales, header.offsets, header.mins, header.maxs, strict=True))
    n_inside = 0
    for start in range(0, len(raw), header.record_length):
        counts = _POSITION.unpack_from(raw, start)
        n_inside += any(raw[start : start + header.record_length]) and all(
            2 * low - high <= count * scale + offset <= 2 * high - low
            for count, (scale, offset, low, high) in zip(counts, axes, strict=True)
        )
    return 2 * n_inside * header.record_length > len(raw)


def _compressed_points(
    header: LasHeader, layout: LazLayout, stream: BinaryIO, salvage: bool
) -> LasHeader:
    """Read the chunk table of a LAZ file, and check it against the number of points."""
    behind = bytes_of_points(stream, header.points_offset, header.points_end, header.size)
    if header.point_count == 0 and behind < layout.min_chunk:
        return header
    if (
        header.point_count > max(_MANY, _DENSEST * header.size)
        and header.point_count != _UNKNOWN
    ):
        refuse(header.path, f"says {header.point_count} points in {header.size} bytes")
    try:
        if header.point_count == 0:
            header = replace(header, point_count=_UNKNOWN)
            raise CorruptLazError(
                f"says 0 points, has {behind} bytes of them: it was never finished"
            )
        counts, sizes = read_table(
            stream, layout, header.points_offset, header.size, header.point_count
        )
        return replace(header, laz=replace(layout, counts=counts, sizes=sizes))
    except CorruptLazError as damage:
        header = _salvaged(header, str(damage), salvage)
    if not layout.layers:
        # Chunks without layers do not contain their size, so the decoder finds their ends.
        return replace(header, laz=replace(layout, rebuilt=True))
    counts, sizes = walk_chunks(stream, layout, header.points_offset, header.size)
    layout = replace(layout, counts=counts, sizes=sizes, rebuilt=True)
    return replace(header, laz=layout, point_count=int(counts.sum()))


def _extended(header: LasHeader, stream: BinaryIO, salvage: bool) -> LasHeader:
    """Return the header with the EVLRs of LAS 1.4."""
    if header.version[1] < 4:
        return header
    stream.seek(227)
    _, start, count, _ = _LAS14.unpack(stream.read(_LAS14.size))
    if count == 0:
        return header
    points_end = header.points_offset
    if header.laz is None:
        points_end += header.point_count * header.record_length
    evlrs: tuple[Vlr, ...] = ()
    whole = False
    if start >= points_end:
        evlrs, whole = walk_records(stream, start, count, header.size, extended=True)
    if not whole:
        complete = f"only {len(evlrs)} are complete in {header.size} bytes"
        problem = f"says {count} extended records from byte {start}, {complete}"
        header = _salvaged(header, problem, salvage)
    return replace(header, evlrs=evlrs)


def _digest(header: LasHeader, stream: BinaryIO) -> str:
    digest = new_digest()
    left = header.points_offset
    stream.seek(0)
    while left > 0 and (part := stream.read(min(left, 1 << 20))):
        digest.update(part)
        left -= len(part)
    if header.laz is not None:
        digest.update(header.laz.counts.tobytes() + header.laz.sizes.tobytes())
    return digest.hexdigest()
