"""Header, records, CRS, file positions and statistics around the points of a classified cloud.

laspy drops text after a NUL, reserved bytes, counts, dates and bytes between records. Here all
of them are copied as bytes, except the points. CRS records are replaced only
if those of the source do not suffice.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import BinaryIO

from pyproj import CRS
from pyproj.exceptions import CRSError

from tiler.core.crs import split, vertical_name
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, exact_unit
from tiler.export.output_files import CloudCopy, PointStatistics
from tiler.inputs.sources import SourceInfo
from tiler.io.las.field_sums import COORDINATE_FIELDS, FieldSums
from tiler.io.las.headers import HEADER_SIZES, LasHeader
from tiler.io.las.layout import PROJECTION_USER, Vlr, packed_record
from tiler.io.las.point_formats import changes_of_format, upgraded_header
from tiler.io.las.writers import (
    HEADER_BYTES,
    INFO_BYTES,
    CopcWriter,
    copy_bytes,
    laszip_vlr,
)

_WKT_BIT = 0x10
"""Bit of the global encoding that makes the WKT record the source of the CRS."""
_WKT, _KEYS, _NUMBERS, _TEXTS = 2112, 34735, 34736, 34737
_MODEL, _PROJECTED, _LINEAR_UNIT, _VERTICAL, _VERTICAL_UNIT = 1024, 3072, 3076, 4096, 4099
_IS_PROJECTED = 1
_UNITS = {METRE: 9001, FOOT: 9002, US_SURVEY_FOOT: 9003}
_CODES = range(1024, 32767)
"""EPSG codes that a key can hold (OGC 19-008r4)."""

_COMPRESSED = 0x80
"""Bit of the point format in the header of a LAZ file."""
_OLDEST_HEADER_BYTES = 227
_MARKED_BYTES = 2
"""Length of the mark between records and points of LAS 1.0."""
_WAVE_USER, _WAVE_RECORDS = "LASF_Spec", (*range(100, 355), 65535)


def write_front(
    header: LasHeader,
    source: BinaryIO,
    target: BinaryIO,
    laszip: bytes | None,
    crs: NewCrs | None,
) -> list[str]:
    """Write the header, the VLRs and all bytes before the points, and return notes for the user.

    ``laszip`` is the laszip record of a LAZ file, or None for LAS.
    """
    form = "LAS" if laszip is None else "LAZ"
    notes = []
    if any(vlr.is_copc for vlr in header.vlrs):
        notes.append(f"COPC written as plain {form}, without its octree")
    copy_bytes(source, target, 0, header.header_size)
    written = 0
    missing = laszip
    for vlr in _kept(header.vlrs, crs):
        if vlr.is_laszip:
            if missing is None:
                continue
            target.write(missing)
            missing = None
        else:
            copy_bytes(source, target, vlr.start, vlr.end)
        written += 1
    if missing is not None:
        target.write(missing)
        written += 1
    if crs is not None:
        target.write(crs.record)
        written += 1
        if crs.note:
            notes.append(crs.note)
    copy_bytes(source, target, _end_of_records(header), header.points_offset)
    points = target.tell()
    _patch(target, 94, "<HII", header.header_size, points, written)
    form_byte = header.point_format
    if laszip is not None:
        form_byte |= _COMPRESSED
    _patch(target, 104, "<B", form_byte)
    if crs is not None and crs.is_wkt and header.version >= (1, 4):
        _patch(target, 6, "<H", header.global_encoding | _WKT_BIT)
    _patch_counts(header, target)
    target.seek(points)
    return notes


def _end_of_records(header: LasHeader) -> int:
    """Return the position after the last VLR, or after the header if there is no VLR."""
    return header.vlrs[-1].end if header.vlrs else header.header_size


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
    _patch(target, 107, "<6I", *[0] * 6)
    _patch(target, 247, "<16Q", statistics.points, *statistics.by_return)
    patch_bounds(target, statistics)


def patch_bounds(target: BinaryIO, statistics: CloudStatistics) -> None:
    """Write the bounds of the written points into a header of any version."""
    fields = statistics.to_json()["fields"]
    ends = [0.0] * 6
    if fields:
        ends = []
        for axis in "XYZ":
            ends += [fields[axis]["maximum"], fields[axis]["minimum"]]
    _patch(target, 179, "<6d", *ends)
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
            copy_bytes(source, target, record.start, record.end)
        _patch(target, 235, "<QI", begin if kept else 0, len(kept))
        if header.waveform_start:
            _patch(target, 227, "<Q", waveform)
    elif header.version[1] == 3 and header.points_offset < header.waveform_start < header.size:
        begin = target.tell()
        copy_bytes(source, target, header.waveform_start, header.size)
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
        copy_bytes(source, target, record.start, record.end)
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
        copy_bytes(source, target, record.start, record.end)
    patch_counts_and_bounds(target, statistics)
    _patch(target, 227, "<QQI", 0, copc.hierarchy_start, 1 + len(kept))
    target.seek(0, os.SEEK_END)


def _kept_by_copc(records: Sequence[Vlr], crs: NewCrs | None) -> list[Vlr]:
    """Return the records of the source without the octree, waveforms, and a CRS that is replaced."""
    return [
        record
        for record in _kept(records, crs)
        if record.user_id != _WAVE_USER or record.record_id not in _WAVE_RECORDS
    ]


def _kept(records: Sequence[Vlr], crs: NewCrs | None) -> list[Vlr]:
    """Return the records of the source without the octree and without a CRS that is replaced."""
    return [r for r in records if not (r.is_copc or (crs is not None and _is_crs(r)))]


@dataclass(frozen=True)
class NewCrs:
    """CRS that replaces the CRS records of the source.

    Attributes
    ----------
    record : bytes
        Whole VLR.
    is_wkt : bool
        True for WKT, False for GeoTIFF keys.
    note : str
        Note for the user, or empty.
    """

    record: bytes
    is_wkt: bool
    note: str = ""


def new_crs(header: LasHeader, cloud: CloudCopy, run_wkt: str | None) -> NewCrs | None:
    """Return the CRS to write into a classified cloud, or None if the records of the source stay.

    LAS 1.4 and COPC get WKT. Earlier versions of LAS get GeoTIFF keys if the CRS parts have
    EPSG codes, else WKT.

    Parameters
    ----------
    header : LasHeader
        Header of the source.
    cloud : CloudCopy
    run_wkt : str or None
        CRS of the run.
    """
    records = (*header.vlrs, *header.evlrs)
    if cloud.copc and run_wkt is not None:
        has = any(r.user_id == PROJECTION_USER and r.record_id == _WKT for r in records)
        if cloud.wkt is not None or not (has and header.prefers_wkt):
            return NewCrs(_wkt_record(run_wkt), True, "CRS written as WKT, which COPC requires")
    if cloud.wkt is None or cloud.copc:
        return None
    note = ""
    if any(map(_is_crs, records)):
        note = "CRS of the run written in place of CRS records that cannot be read or have no vertical CRS"
    if header.version >= (1, 4):
        return NewCrs(_wkt_record(cloud.wkt), True, note)
    keys = geotiff_keys(CRS.from_wkt(cloud.wkt))
    if keys is not None:
        return NewCrs(packed_record(PROJECTION_USER, _KEYS, "", keys), False, note)
    told = "CRS written as WKT, although the LAS version is before 1.4: GeoTIFF keys have no code for this CRS"
    return NewCrs(_wkt_record(cloud.wkt), True, told)


def crs_of_run(run_wkt: str | None) -> NewCrs | None:
    """Return the CRS to write into a cloud that is not the copy of a source, or None if the run has none."""
    return None if run_wkt is None else NewCrs(_wkt_record(run_wkt), True)


def crs_to_write(info: SourceInfo, run_wkt: str | None, given: str | None) -> str | None:
    """Return the CRS that a classified cloud gets, or None if the CRS records of its source stay.

    ``given`` is the text of ``--crs``, which may add a vertical CRS to that of the source.
    """
    if not info.has_crs:
        return run_wkt
    if given is None or not _gives_heights(given) or vertical_name(run_wkt) is None:
        return None
    return run_wkt if vertical_name(info.georeference.wkt) is None else None


@lru_cache(maxsize=4)
def _gives_heights(crs: str) -> bool:
    """Return whether a text of ``--crs`` names a CRS with heights."""
    return crs.strip().lower() != "none" and split(CRS.from_user_input(crs))[1] is not None


def _is_crs(record: Vlr) -> bool:
    return record.user_id == PROJECTION_USER and record.record_id in (
        _WKT,
        _KEYS,
        _NUMBERS,
        _TEXTS,
    )


def geotiff_keys(crs: CRS) -> bytes | None:
    """Return GeoTIFF keys with the EPSG codes of a projected CRS, or None if it lacks such codes.

    A vertical CRS is included. laspy omits units and the vertical CRS, and rasterio writes keys
    only into images.
    """
    horizontal, vertical = split(crs)
    if horizontal is None or not horizontal.is_projected:
        return None
    keys = [(_MODEL, _IS_PROJECTED), *_named(horizontal, _PROJECTED, _LINEAR_UNIT)]
    if vertical is not None and vertical.is_vertical:
        keys += _named(vertical, _VERTICAL, _VERTICAL_UNIT)
    elif vertical is not None:
        keys.append((_VERTICAL, 0))
    if not all(code in _CODES or key == _MODEL for key, code in keys):
        return None
    entries = [struct.pack("<4H", key, 0, 1, code) for key, code in keys]
    return struct.pack("<4H", 1, 1, 0, len(keys)) + b"".join(entries)


def _named(crs: CRS, code_key: int, unit_key: int) -> list[tuple[int, int]]:
    """Return keys with the EPSG codes of a CRS and of its unit. A code is 0 if there is none."""
    unit = exact_unit(crs.axis_info[-1].unit_conversion_factor)
    return [(code_key, crs.to_epsg(min_confidence=100) or 0), (unit_key, _UNITS.get(unit, 0))]


def _wkt_record(wkt: str) -> bytes:
    """Return the record of a CRS in WKT 1, as LAS requires, or in the given WKT if WKT 1 cannot express the CRS."""
    text = wkt
    with suppress(CRSError):
        text = CRS.from_wkt(wkt).to_wkt("WKT1_GDAL", output_axis_rule=False) or wkt
    return packed_record(PROJECTION_USER, _WKT, "", text.encode() + b"\0")


class CloudStatistics(FieldSums):
    """Statistics of the fields of a classified cloud."""

    def to_json(self) -> PointStatistics:
        """Return the statistics as plain values."""
        header = self.header
        scales = dict(
            zip(COORDINATE_FIELDS, zip(header.scales, header.offsets, strict=True), strict=True)
        )
        fields = {}
        if not self.points:
            return {"fields": {}, "gps": self.times or None}
        for name, (low, high, total, squares) in self.fields.items():
            scale, offset = scales.get(name, (1.0, 0.0))
            variance = (squares * self.points - total * total) / self.points**2
            fields[name] = {
                "minimum": low * scale + offset,
                "maximum": high * scale + offset,
                "average": total / self.points * scale + offset,
                "variance": variance * scale * scale,
                "stddev": math.sqrt(variance) * scale,
            }
        return {"fields": fields, "gps": self.times or None}
