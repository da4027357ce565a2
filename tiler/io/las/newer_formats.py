"""Conversion of records of point formats 0 to 5, 9 and 10 to formats 6 to 8, the only formats of COPC (LAS 1.4)."""

from __future__ import annotations

from dataclasses import replace

import laspy
import numpy as np

from tiler.core.classes import OVERLAP_FLAG
from tiler.io.las.columns import SCAN_STEP_DEGREES, class_and_flags, is_legacy
from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import Records, record_dtype

_NEWER = {0: 6, 1: 6, 2: 7, 3: 7, 4: 6, 5: 7, 6: 6, 7: 7, 8: 8, 9: 6, 10: 8}
_WITHOUT_TIME = (0, 2)
_WITH_WAVEFORMS = (4, 5, 9, 10)

STANDARD_OFFSET = 1000
"""Offset in millions of seconds that "adjusted standard GPS time" of LAS 1.1 to 1.4
subtracts."""

# The next two constants are bits of the global encoding.
_WKT_BIT = 0x10
_KEPT_BITS = 0x09
"""Bits for the kind of GPS time and for synthetic return numbers. The other bits are about CRS
and waveforms."""


def newer_format(point_format: int) -> int:
    """Return the format 6, 7 or 8 that has all fields of ``point_format`` except waveforms."""
    return _NEWER[point_format]


def newer_bytes(point_format: int, record_length: int) -> int:
    """Return the length of a converted record, which keeps its extra bytes."""
    return _bare_bytes(_NEWER[point_format]) + record_length - _bare_bytes(point_format)


def upgraded_header(header: LasHeader) -> LasHeader:
    """Return the header for the converted points of a file, with the variable length records of the file."""
    return replace(
        header,
        version=(1, 4),
        point_format=_NEWER[header.point_format],
        record_length=newer_bytes(header.point_format, header.record_length),
        global_encoding=header.global_encoding & _KEPT_BITS | _WKT_BIT,
    )


def _bare_bytes(point_format: int) -> int:
    return int(laspy.PointFormat(point_format).dtype().itemsize)


def upgrade_records(records: Records, point_format: int) -> Records:
    """Convert records to format 6, 7 or 8. Records that have this format already are returned unchanged.

    Class 12 (overlap) of formats 0 to 5 is kept and sets the overlap flag as well. Angles are
    rounded to steps of 0.006 degrees, which does not lose whole degrees.
    """
    form = _NEWER[point_format]
    if form == point_format:
        return records
    extra = records.dtype["extra"].itemsize if "extra" in (records.dtype.names or ()) else 0
    dtype = record_dtype(form, _bare_bytes(form) + extra)
    upgraded = np.zeros(len(records), dtype=dtype)
    for name in set(dtype.names or ()) & set(records.dtype.names or ()) - {"bit_fields"}:
        upgraded[name] = records[name]
    if not is_legacy(point_format):
        upgraded["bit_fields"] = records["bit_fields"]
        return upgraded
    bits = records["bit_fields"]
    upgraded["bit_fields"] = (bits & 7) | (((bits >> 3) & 7) << 4)
    classification, flags = class_and_flags(records, point_format)
    upgraded["classification"] = classification
    raw = records["raw_classification"]
    overlap = (flags & OVERLAP_FLAG != 0).astype(np.uint8)
    # Bits 0 to 2 are synthetic, key point and withheld, 3 overlap, 6 scan direction, 7 edge of
    # the flight line.
    upgraded["classification_flags"] = (raw >> 5) | (overlap << 3) | (bits & 0xC0)
    upgraded["scan_angle"] = np.rint(records["scan_angle_rank"] / SCAN_STEP_DEGREES)
    return upgraded


def as_standard_times(records: Records, header: LasHeader) -> Records:
    """Convert GPS times from the time offset of LAS 1.5 to the times of LAS 1.4."""
    if header.time_offset is None:
        return records
    converted = records.copy()
    converted["gps_time"] += (header.time_offset - STANDARD_OFFSET) * 1e6
    return converted


def changes_of_format(header: LasHeader) -> list[str]:
    """Return notes about changes and losses by the conversion of a file's points. The list may be empty."""
    old = header.point_format
    new = _NEWER[old]
    notes = []
    if old != new:
        notes.append(f"points of format {old} written as format {new}, as COPC has it")
    if header.gps_times is not None:
        notes.append("range of GPS times in the header left out: COPC is LAS 1.4")
    if header.time_offset is not None:
        notes.append(
            f"GPS times written with an offset of {STANDARD_OFFSET} million seconds, as COPC has them, instead of "
            f"{header.time_offset}"
        )
    if old in _WITHOUT_TIME:
        notes.append("GPS time of each point is 0: COPC needs a time, the input has none")
    if old in _WITH_WAVEFORMS:
        notes.append("waveforms left out: COPC has none")
    return notes
