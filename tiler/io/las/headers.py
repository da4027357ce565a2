"""Reads LAS headers, and checks everything they say against the file.

LAS specification 1.4 R15, tables 3 (header), 5 (VLR) and 6 (EVLR); LAS 1.0 to 1.3 are prefixes of it.
"""

from __future__ import annotations

import hashlib
import math
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from tiler.errors import InputError
from tiler.io.cloud_reading import open_cloud
from tiler.io.las.laz import LazDamage, LazLayout, bytes_of_points, parse_laszip, read_table, walk_chunks
from tiler.io.las.records import VariableRecord, walk_records
from tiler.io.locations import State, is_url, state_of

_BLOCK_BYTES = 1 << 14
"""Bytes of an object read at once: what stands before the points, the chunk table or a record seldom take more."""
_BLOCK = struct.Struct("<4sHH16sBB32s32sHHHIIBHI5I12d")
_LAS14 = struct.Struct("<QQIQ")
_HEADER_SIZES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
_RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
_WKT_BIT = 0x10
_UNKNOWN = 1 << 40
_MANY = 10_000_000
_DENSEST = 1000
"""Points a compressed byte, above which a file of many points is taken for a bomb: clouds have less than one."""

AGAIN = "get the file again"
SALVAGE = "get the file again, or read what is there with --salvage"


@dataclass(frozen=True)
class LasHeader:
    """What a file says of itself, as far as it can be true.

    Attributes
    ----------
    path : Path
    state : State
        Of the file, when the header was read.
    version : tuple of int
    global_encoding, header_size, points_offset, point_format, record_length, point_count : int
        Format without the bit of compression; bytes; points that can be read.
    scales, offsets, mins, maxs : tuple of 3 float
        Finite scales above 0, finite offsets; the bounds are as the file says, true or not.
    waveform_start : int
        Byte of the waveform packets (LAS 1.3 and later), else 0.
    evlrs_start : int
        Byte of the first EVLR that the header tells of (LAS 1.4), else 0.
    vlrs, evlrs : tuple of VariableRecord
        Those that are there.
    laz : LazLayout or None
        None: not compressed.
    digest : str
        Of the bytes before the points and of the table of chunks.
    notes : tuple of str
        What was wrong and yet does no harm.
    created : tuple of int
        Year and day of the year, 1 to 366, on which the file was made; 0 where it does not say.
    """

    path: Path
    state: State
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
    vlrs: tuple[VariableRecord, ...] = ()
    evlrs: tuple[VariableRecord, ...] = ()
    laz: LazLayout | None = None
    digest: str = ""
    notes: tuple[str, ...] = ()
    created: tuple[int, int] = (0, 0)

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self.state.size

    @property
    def stamp(self) -> list[Any]:
        """State and digest: the same as long as the file is, see `tiler.io.las.unchanged`."""
        return [*self.state.to_json(), self.digest]

    @property
    def prefers_wkt(self) -> bool:
        """The global encoding says that the CRS is the WKT record's."""
        return bool(self.global_encoding & _WKT_BIT)

    @property
    def points_end(self) -> int:
        """The first byte that cannot be a point's: of the waveforms, of the EVLRs, or behind the file."""
        starts = (self.waveform_start, self.evlrs_start, self.size)
        return min(start for start in starts if self.points_offset <= start <= self.size)

    def noted(self, text: str) -> LasHeader:
        """A copy of the header with one more note."""
        return replace(self, notes=(*self.notes, text))


def refuse(path: Path, what: str, remedy: str = AGAIN) -> NoReturn:
    """Raise the InputError of one line."""
    raise InputError(f"{path}: {what}; {remedy}")


def _salvaged(header: LasHeader, what: str, salvage: bool) -> LasHeader:
    """The header with a note of a damage that --salvage reads over; raises InputError without it."""
    if not salvage:
        refuse(header.path, what, SALVAGE)
    return header.noted(what)


def read_header(path: Path, salvage: bool = False) -> LasHeader:
    """The header of a LAS or LAZ file, checked against the file.

    Parameters
    ----------
    path : Path
    salvage : bool
        Take the whole records or chunks that are there where a file is cut short.

    Raises
    ------
    InputError
        The file cannot be opened, is no LAS, or claims what cannot be.
    """
    try:
        state = state_of(path)
        # To open a pipe would wait for its other end.
        if not is_url(path) and not path.is_file():
            refuse(path, "is no regular file", "name LAS or LAZ files")
        with open_cloud(path, _BLOCK_BYTES) as stream:
            header = _fixed_block(path, stream, state, salvage)
            header = _records(header, stream)
            if header.laz is None:
                header = _plain_points(header, salvage)
            else:
                header = _compressed_points(header, header.laz, stream, salvage)
            if header.point_count == 0 and header.notes and salvage:
                refuse(path, f"{header.notes[-1]}; not one point can be salvaged")
            return replace(_extended(header, stream, salvage), digest=_digest(header, stream))
    except OSError as error:
        refuse(path, f"cannot be read ({error.strerror or error})", "name a readable LAS or LAZ file")


def read_payload(path: Path, record: VariableRecord, limit: int = 1 << 24) -> bytes:
    """What a record holds, at most ``limit`` bytes."""
    with open_cloud(path, _BLOCK_BYTES) as stream:
        stream.seek(record.payload)
        return stream.read(min(record.length, limit))


def _fixed_block(path: Path, stream: BinaryIO, state: State, salvage: bool) -> LasHeader:
    """The fields of the public header block; the CRS, the records and the points are not looked at."""
    size = state.size
    raw = stream.read(_HEADER_SIZES[4])
    if raw[:4] != b"LASF":
        refuse(path, f"begins with {raw[:4]!r}, not with LASF: no LAS or LAZ file", "name LAS or LAZ files")
    if len(raw) < _BLOCK.size:
        refuse(path, f"has {size} bytes, its header alone needs {_BLOCK.size}")
    fields = _BLOCK.unpack_from(raw)
    encoding, major, minor = fields[2], fields[4], fields[5]
    header_size, points_offset, _, form, length, legacy_count = fields[10:16]
    if major != 1 or minor not in _HEADER_SIZES:
        refuse(path, f"is LAS {major}.{minor}, LAS 1.0 to 1.4 can be read", "convert it")
    least = _HEADER_SIZES[minor]
    unfinished = header_size == 0 and points_offset == 0
    if unfinished and not salvage:
        refuse(path, "its header was never finished (header size 0): whatever wrote it was stopped", SALVAGE)
    if unfinished:
        header_size = least
    elif not least <= header_size <= points_offset <= size:
        what = f"says header of {header_size} bytes, points from byte {points_offset}, in a file of {size}"
        refuse(path, what)
    plain = form & 0x3F
    if form & 0x40 or plain >= len(_RECORD_SIZES):
        refuse(path, f"point format {form} is not known, 0 to 10 are", "convert it")
    if length < _RECORD_SIZES[plain]:
        refuse(path, f"says records of {length} bytes, format {plain} needs {_RECORD_SIZES[plain]}")
    bounds = fields[27:33]
    waveform, evlrs, count = 0, 0, legacy_count
    if minor == 3:
        (waveform,) = struct.unpack_from("<Q", raw, 227)
    if minor >= 4:
        waveform, evlrs, n_evlrs, count = _LAS14.unpack_from(raw, 227)
        evlrs = evlrs if n_evlrs else 0
    header = LasHeader(
        path, state, (major, minor), encoding, header_size, points_offset, plain, length,
        count or legacy_count, fields[21:24], fields[24:27], bounds[1::2], bounds[0::2], waveform, evlrs,
        created=(fields[9], fields[8]),
    )  # fmt: skip
    if not all(math.isfinite(s) and s > 0 for s in header.scales):
        refuse(path, f"scale factors {header.scales} are not all above 0 and finite")
    if not all(math.isfinite(o) for o in header.offsets):
        refuse(path, f"offsets {header.offsets} are not all finite")
    if count and legacy_count not in (0, count):
        what = f"says {count} points, and {legacy_count} in the field of LAS 1.3; {count} counts"
        header = header.noted(what)
    return header


def _records(header: LasHeader, stream: BinaryIO) -> LasHeader:
    """The VLRs, and with them how the points are compressed."""
    unfinished = header.points_offset == 0
    stream.seek(100)
    count, form = struct.unpack("<IB", stream.read(5))
    compressed = bool(form & 0x80)
    end = header.size if unfinished else header.points_offset
    vlrs, whole = walk_records(stream, header.header_size, count, end, extended=False)
    if not whole:
        # Harmless where a count is merely wrong; hopeless where the points do not fit either.
        fits = compressed or header.points_offset + header.point_count * header.record_length <= header.size
        if not fits or unfinished:
            refuse(header.path, f"says {count} variable length records, there is room for {len(vlrs)}")
        header = header.noted(f"says {count} variable length records, {len(vlrs)} are there")
    if unfinished:
        start = vlrs[-1].end if vlrs else header.header_size
        room = _UNKNOWN if compressed else (header.size - start) // header.record_length
        header = replace(header, points_offset=start, point_count=room).noted("header unfinished: rebuilt")
    header = replace(header, vlrs=vlrs)
    if not compressed:
        return header
    laszip = next((v for v in vlrs if v.is_laszip), None)
    if laszip is None:
        refuse(header.path, "says that it is compressed and has no laszip record")
    stream.seek(laszip.payload)
    try:
        layout = parse_laszip(stream.read(laszip.length))
    except LazDamage as damage:
        refuse(header.path, str(damage))
    if layout.item_size != header.record_length:
        what = f"says records of {header.record_length} bytes, its laszip record {layout.item_size}"
        refuse(header.path, what)
    return replace(header, laz=layout)


def _plain_points(header: LasHeader, salvage: bool) -> LasHeader:
    """The points of a LAS file: there must be room for them, and no more than that where there are none."""
    room = (header.points_end - header.points_offset) // header.record_length
    if header.point_count == 0 and room:
        what = f"says 0 points, has room for {room}: it was never finished"
        return replace(_salvaged(header, what, salvage), point_count=room)
    if header.point_count < room:
        return header.noted(f"says {header.point_count} points, has room for {room}: the rest is not read")
    room = max(header.size - header.points_offset, 0) // header.record_length
    if header.point_count <= room:
        return header
    what = f"says {header.point_count} points, has room for {room}: cut short"
    return replace(_salvaged(header, what, salvage), point_count=room)


def _compressed_points(header: LasHeader, layout: LazLayout, stream: BinaryIO, salvage: bool) -> LasHeader:
    """The points of a LAZ file: the table of chunks must be there and agree."""
    behind = bytes_of_points(stream, header.points_offset, header.points_end, header.size)
    if header.point_count == 0 and behind < layout.least_chunk:
        return header
    if header.point_count > max(_MANY, _DENSEST * header.size) and header.point_count != _UNKNOWN:
        refuse(header.path, f"says {header.point_count} points in {header.size} bytes")
    try:
        if header.point_count == 0:
            header = replace(header, point_count=_UNKNOWN)
            raise LazDamage(f"says 0 points, has {behind} bytes of them: it was never finished")
        counts, sizes = read_table(stream, layout, header.points_offset, header.size, header.point_count)
        return replace(header, laz=replace(layout, counts=counts, sizes=sizes))
    except LazDamage as damage:
        header = _salvaged(header, str(damage), salvage)
    if not layout.layers:
        # Chunks of this kind have no header to walk by: the decoder finds where they end.
        return replace(header, laz=replace(layout, rebuilt=True))
    counts, sizes = walk_chunks(stream, layout, header.points_offset, header.size)
    layout = replace(layout, counts=counts, sizes=sizes, rebuilt=True)
    return replace(header, laz=layout, point_count=int(counts.sum()))


def _extended(header: LasHeader, stream: BinaryIO, salvage: bool) -> LasHeader:
    """The EVLRs of LAS 1.4."""
    if header.version[1] < 4:
        return header
    stream.seek(227)
    _, start, count, _ = _LAS14.unpack(stream.read(_LAS14.size))
    if count == 0:
        return header
    points_end = header.points_offset + (0 if header.laz else header.point_count * header.record_length)
    evlrs: tuple[VariableRecord, ...] = ()
    whole = False
    if start >= points_end:
        evlrs, whole = walk_records(stream, start, count, header.size, extended=True)
    if not whole:
        what = (
            f"says {count} extended records from byte {start}, {len(evlrs)} are whole in {header.size} bytes"
        )
        header = _salvaged(header, what, salvage)
    return replace(header, evlrs=evlrs)


def _digest(header: LasHeader, stream: BinaryIO) -> str:
    """Digest of the bytes before the points, read in bounded pieces, and of the table of chunks."""
    digest, left = hashlib.blake2b(digest_size=16), header.points_offset
    stream.seek(0)
    while left > 0 and (part := stream.read(min(left, 1 << 20))):
        digest.update(part)
        left -= len(part)
    if header.laz is not None:
        digest.update(header.laz.counts.tobytes() + header.laz.sizes.tobytes())
    return digest.hexdigest()
