"""Header and records of classified clouds, copied from the source with the positions in them moved.

laspy rewrites what it does not keep (text behind a NUL, reserved bytes, counts, dates, bytes between
records); here all is copied as bytes, and only the points pass through lazrs.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from contextlib import suppress
from typing import BinaryIO

from pyproj import CRS
from pyproj.exceptions import CRSError

from tiler.export.cloud_statistics import CloudStatistics
from tiler.io.las.copc_writer import HEADER_BYTES, INFO_BYTES, CopcWriter
from tiler.io.las.headers import LasHeader
from tiler.io.las.newer_formats import changes_of_format, newer_header
from tiler.io.las.records import PROJECTION_USER, VariableRecord, packed_record
from tiler.io.las.writer import laszip_vlr

_COPY = 1 << 20
_COMPRESSED = 0x80
"""Bit of the point format in the header of a LAZ file."""
_OLDEST_HEADER_BYTES = 227
_MARKED_BYTES = 2
"""Between records and points of LAS 1.0: a mark."""
_WKT, _GEOTIFF = 2112, (34735, 34736, 34737)
_WAVE_USER, _WAVE_RECORDS = "LASF_Spec", (*range(100, 355), 65535)


def _kept(records: Sequence[VariableRecord]) -> list[VariableRecord]:
    return [r for r in records if not r.is_copc]


def write_front(header: LasHeader, source: BinaryIO, target: BinaryIO, compressed: bool) -> list[str]:
    """Header, VLRs and whatever lies between them and the points; returns notes."""
    form = "LAZ" if compressed else "LAS"
    notes = (
        [f"COPC written as plain {form}, without its octree"] if any(v.is_copc for v in header.vlrs) else []
    )
    _copy(source, target, 0, header.header_size)
    written = 0
    laszip_done = not compressed
    for vlr in _kept(header.vlrs):
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
    _copy(source, target, header.vlrs[-1].end if header.vlrs else header.header_size, header.points_offset)
    points = target.tell()
    _patch(target, 94, "<HII", header.header_size, points, written)
    _patch(target, 104, "<B", header.point_format | (_COMPRESSED if compressed else 0))
    _patch_counts(header, target)
    target.seek(points)
    return notes


def _patch(target: BinaryIO, position: int, form: str, *values: float) -> None:
    target.seek(position)
    target.write(struct.pack(form, *values))


def _patch_counts(header: LasHeader, target: BinaryIO) -> None:
    """The number of points, where the header's was not what could be read (salvaged files)."""
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


def patch_window(target: BinaryIO, statistics: CloudStatistics) -> None:
    """Write counts and bounds of a cloud that holds a part of its source: LAS 1.4, as COPC is."""
    fields = statistics.to_json()["fields"]
    ends = [fields[axis][end] if fields else 0.0 for axis in "XYZ" for end in ("maximum", "minimum")]
    _patch(target, 107, "<6I", *[0] * 6)
    _patch(target, 179, "<6d", *ends)
    _patch(target, 247, "<16Q", statistics.points, *statistics.by_return)
    target.seek(0, os.SEEK_END)


def write_back(header: LasHeader, source: BinaryIO, target: BinaryIO) -> None:
    """EVLRs, or the waveform packets of LAS 1.3, and the positions of both."""
    target.seek(0, os.SEEK_END)
    if header.version[1] >= 4:
        kept = _kept(header.evlrs)
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


def write_copc_front(header: LasHeader, source: BinaryIO, target: BinaryIO, wkt: str | None) -> list[str]:
    """Header and VLRs of a COPC file, with room for what is known at its end; returns notes.

    Parameters
    ----------
    header : LasHeader
    source, target : BinaryIO
    wkt : str or None
        The CRS, where the source does not have it as WKT.
    """
    form, notes = newer_header(header), changes_of_format(header)
    source.seek(0)
    target.write(source.read(_OLDEST_HEADER_BYTES).ljust(HEADER_BYTES + INFO_BYTES, b"\0"))
    target.write(laszip_vlr(form, own_sizes=True))
    records = [r for r in _kept_by_copc(header, header.vlrs, wkt) if not r.is_laszip]
    for record in records:
        _copy(source, target, record.start, record.end)
    if _own_wkt(header, wkt):
        target.write(_wkt_record(wkt))
        notes.append("CRS written as WKT, as COPC has it")
    gap = header.points_offset - (header.vlrs[-1].end if header.vlrs else header.header_size)
    own = gap if gap > _MARKED_BYTES else 0
    own += max(header.header_size - HEADER_BYTES, 0)
    if own:
        notes.append(f"{own} bytes between header, records and points left out: COPC has no place for them")
    begin = target.tell()
    _patch(target, 6, "<H", form.global_encoding)
    _patch(target, 24, "<BB", *form.version)
    count = len(records) + 2 + _own_wkt(header, wkt)
    _patch(
        target, 94, "<HIIBH", HEADER_BYTES, begin, count, form.point_format | _COMPRESSED, form.record_length
    )
    target.seek(begin)
    return notes


def write_copc_back(
    header: LasHeader,
    wkt: str | None,
    source: BinaryIO,
    target: BinaryIO,
    copc: CopcWriter,
    statistics: CloudStatistics,
) -> None:
    """EVLRs of a COPC file behind its hierarchy, which is the first, and what its header says of the points."""
    kept = _kept_by_copc(header, header.evlrs, wkt)
    for record in kept:
        _copy(source, target, record.start, record.end)
    patch_window(target, statistics)
    _patch(target, 227, "<QQI", 0, copc.hierarchy_start, 1 + len(kept))
    target.seek(0, os.SEEK_END)


def _kept_by_copc(
    header: LasHeader, records: Sequence[VariableRecord], wkt: str | None
) -> list[VariableRecord]:
    """Records of the source but those of an octree, of waveforms, and of a CRS that is written anew."""
    own = _own_wkt(header, wkt)
    return [
        r
        for r in _kept(records)
        if not (r.user_id == _WAVE_USER and r.record_id in _WAVE_RECORDS)
        and not (own and r.user_id == PROJECTION_USER and r.record_id in (_WKT, *_GEOTIFF))
    ]


def _own_wkt(header: LasHeader, wkt: str | None) -> bool:
    """Whether the CRS is known, and not by a record of WKT that counts."""
    has = any(r.user_id == PROJECTION_USER and r.record_id == _WKT for r in (*header.vlrs, *header.evlrs))
    return wkt is not None and not (has and header.prefers_wkt)


def _wkt_record(wkt: str | None) -> bytes:
    """The record of a CRS, in the WKT 1 that LAS asks for, or as it is where that has no words for it."""
    text = wkt or ""
    with suppress(CRSError):
        text = CRS.from_wkt(text).to_wkt("WKT1_GDAL", output_axis_rule=False) or text
    return packed_record(PROJECTION_USER, _WKT, "", text.encode() + b"\0")


def _copy(source: BinaryIO, target: BinaryIO, start: int, stop: int) -> None:
    """Bytes ``start`` to ``stop`` of the source, in bounded pieces."""
    source.seek(start)
    left = stop - start
    while left > 0:
        part = source.read(min(left, _COPY))
        if not part:
            raise OSError(f"the source ends at byte {stop - left}")
        target.write(part)
        left -= len(part)
