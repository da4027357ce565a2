"""Copying of header and records of a source into its classified cloud, with correct file positions.

laspy drops text after a NUL, reserved bytes, counts, dates and bytes between records. Here all
of them are copied as bytes, and only the points pass through lazrs.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from typing import BinaryIO

from tiler.export.cloud_crs import WKT_BIT, NewCrs, without_crs
from tiler.export.cloud_statistics import CloudStatistics
from tiler.io.las.headers import HEADER_SIZES, LasHeader
from tiler.io.las.layout import Vlr
from tiler.io.las.point_formats import changes_of_format, upgraded_header
from tiler.io.las.writers import HEADER_BYTES, INFO_BYTES, CopcWriter, laszip_vlr

_COPY = 1 << 20
_COMPRESSED = 0x80
"""Bit of the point format in the header of a LAZ file."""
_OLDEST_HEADER_BYTES = 227
_MARKED_BYTES = 2
"""Length of the mark between records and points of LAS 1.0."""
_WAVE_USER, _WAVE_RECORDS = "LASF_Spec", (*range(100, 355), 65535)


def _kept(records: Sequence[Vlr], crs: NewCrs | None) -> list[Vlr]:
    """Return the records of the source without the octree and without a CRS that is replaced."""
    if crs is not None:
        records = without_crs(records)
    return [record for record in records if not record.is_copc]


def write_front(
    header: LasHeader, source: BinaryIO, target: BinaryIO, compressed: bool, crs: NewCrs | None
) -> list[str]:
    """Write the header, the VLRs and all bytes before the points, and return notes for the user."""
    form = "LAZ" if compressed else "LAS"
    notes = []
    if any(vlr.is_copc for vlr in header.vlrs):
        notes.append(f"COPC written as plain {form}, without its octree")
    _copy(source, target, 0, header.header_size)
    written = 0
    laszip_done = not compressed
    for vlr in _kept(header.vlrs, crs):
        if vlr.is_laszip:
            if laszip_done:
                continue
            target.write(laszip_vlr(header))
            laszip_done = True
        else:
            _copy(source, target, vlr.start, vlr.end)
        written += 1
    if not laszip_done:
        target.write(laszip_vlr(header))
        written += 1
    if crs is not None:
        target.write(crs.record)
        written += 1
        if crs.note:
            notes.append(crs.note)
    _copy(source, target, _end_of_records(header), header.points_offset)
    points = target.tell()
    _patch(target, 94, "<HII", header.header_size, points, written)
    form_byte = header.point_format
    if compressed:
        form_byte |= _COMPRESSED
    _patch(target, 104, "<B", form_byte)
    if crs is not None and crs.is_wkt and header.version >= (1, 4):
        _patch(target, 6, "<H", header.global_encoding | WKT_BIT)
    _patch_counts(header, target)
    target.seek(points)
    return notes


def _end_of_records(header: LasHeader) -> int:
    """Return the position after the last VLR, or after the header if there is no VLR."""
    if header.vlrs:
        return header.vlrs[-1].end
    return header.header_size


def _patch(target: BinaryIO, position: int, form: str, *values: float) -> None:
    target.seek(position)
    target.write(struct.pack(form, *values))


def _patch_counts(header: LasHeader, target: BinaryIO) -> None:
    """Write the number of points if the header states another number, as in a salvaged file."""
    target.seek(107)
    (legacy,) = struct.unpack("<I", target.read(4))
    if header.version[1] < 4:
        if legacy != header.point_count:
            _patch(target, 107, "<I", header.point_count)
        return
    target.seek(247)
    (count,) = struct.unpack("<Q", target.read(8))
    if count not in (header.point_count, 0) or (count == 0 and legacy != header.point_count):
        _patch(target, 247, "<Q", header.point_count)
        _patch(target, 107, "<I", header.point_count if legacy else 0)


def patch_counts_and_bounds(target: BinaryIO, statistics: CloudStatistics) -> None:
    """Write counts and bounds of the written points into a LAS 1.4 header."""
    fields = statistics.to_json()["fields"]
    ends = [0.0] * 6
    if fields:
        ends = []
        for axis in "XYZ":
            ends += [fields[axis]["maximum"], fields[axis]["minimum"]]
    _patch(target, 107, "<6I", *[0] * 6)
    _patch(target, 179, "<6d", *ends)
    _patch(target, 247, "<16Q", statistics.points, *statistics.by_return)
    target.seek(0, os.SEEK_END)


def write_back(
    header: LasHeader, source: BinaryIO, target: BinaryIO, crs: NewCrs | None
) -> None:
    """Write the EVLRs, or the waveform packets of LAS 1.3, and the positions of both."""
    target.seek(0, os.SEEK_END)
    if header.version[1] >= 4:
        kept = _kept(header.evlrs, crs)
        begin = target.tell()
        waveform = 0
        for record in kept:
            if record.start == header.waveform_start:
                waveform = target.tell()
            _copy(source, target, record.start, record.end)
        _patch(target, 235, "<QI", begin if kept else 0, len(kept))
        if header.waveform_start:
            _patch(target, 227, "<Q", waveform)
    elif header.version[1] == 3 and header.points_offset < header.waveform_start < header.size:
        begin = target.tell()
        _copy(source, target, header.waveform_start, header.size)
        _patch(target, 227, "<Q", begin)
    target.seek(0, os.SEEK_END)


def write_copc_front(
    header: LasHeader, source: BinaryIO, target: BinaryIO, crs: NewCrs | None
) -> list[str]:
    """Write header and VLRs of a COPC file, and return notes for the user.

    Counts, bounds and the position of the hierarchy are only known at the end, so their bytes
    are reserved.
    """
    form, notes = upgraded_header(header), changes_of_format(header)
    source.seek(0)
    target.write(source.read(_OLDEST_HEADER_BYTES).ljust(HEADER_BYTES + INFO_BYTES, b"\0"))
    target.write(laszip_vlr(form, own_sizes=True))
    records = [r for r in _kept_by_copc(header.vlrs, crs) if not r.is_laszip]
    for record in records:
        _copy(source, target, record.start, record.end)
    if crs is not None:
        target.write(crs.record)
        notes.append(crs.note)
    lost = max(header.header_size - max(HEADER_BYTES, HEADER_SIZES[header.version[1]]), 0)
    gap = header.points_offset - _end_of_records(header)
    if gap > _MARKED_BYTES:
        lost += gap
    if lost:
        notes.append(
            f"{lost} bytes between header, records and points left out: COPC has no place for them"
        )
    begin = target.tell()
    _patch(target, 6, "<H", form.global_encoding)
    _patch(target, 24, "<BB", *form.version)
    count = len(records) + 2 + (crs is not None)
    _patch(
        target,
        94,
        "<HIIBH",
        HEADER_BYTES,
        begin,
        count,
        form.point_format | _COMPRESSED,
        form.record_length,
    )
    target.seek(begin)
    return notes


def write_copc_back(
    header: LasHeader,
    source: BinaryIO,
    target: BinaryIO,
    crs: NewCrs | None,
    copc: CopcWriter,
    statistics: CloudStatistics,
) -> None:
    """Write the EVLRs of a COPC file after its hierarchy, and the counts and bounds in its header."""
    kept = _kept_by_copc(header.evlrs, crs)
    for record in kept:
        _copy(source, target, record.start, record.end)
    patch_counts_and_bounds(target, statistics)
    _patch(target, 227, "<QQI", 0, copc.hierarchy_start, 1 + len(kept))
    target.seek(0, os.SEEK_END)


def _kept_by_copc(records: Sequence[Vlr], crs: NewCrs | None) -> list[Vlr]:
    """Return the records of the source without the octree, waveforms, and a CRS that is replaced."""
    return [record for record in _kept(records, crs) if not _is_waveform(record)]


def _is_waveform(record: Vlr) -> bool:
    return record.user_id == _WAVE_USER and record.record_id in _WAVE_RECORDS


def _copy(source: BinaryIO, target: BinaryIO, start: int, stop: int) -> None:
    """Copy bytes ``start`` to ``stop`` of the source, in bounded pieces."""
    source.seek(start)
    left = stop - start
    while left > 0:
        part = source.read(min(left, _COPY))
        if not part:
            raise OSError(f"the source ends at byte {stop - left}")
        target.write(part)
        left -= len(part)
