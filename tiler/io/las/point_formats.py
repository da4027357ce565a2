"""Fields of LAS records: as columns of a `PointBlock`, which do not depend on the point format, and in formats 6 to 8.

In formats 0 to 5, class (5 bits) and flags are in one byte, in formats 6 to 10 in two (LAS 1.4 R15, tables 8 to 17).
COPC has only formats 6 to 8, to which records of the others are converted.
"""

from __future__ import annotations

from dataclasses import replace

import laspy
import numpy as np

from ptd.arrays import Bool, Float32, Float64, UInt8, UInt16
from ptd.matched.evidence import Evidence
from tiler.core.points import KEY_POINT_FLAG, OVERLAP_FLAG, SYNTHETIC_FLAG, WITHHELD_FLAG
from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import Records, record_dtype

_OVERLAP_CLASS = 12
"""Class of overlap points in formats 0 to 5, which do not have a flag for overlap."""

_LEGACY_CLASS_MASK = 0x1F

_SCAN_STEP_DEGREES = 0.006
"""Step of the scan angles of formats 6 to 10. Older formats have whole degrees."""

RGB_FORMATS = (2, 3, 5, 7, 8, 10)


def is_legacy(point_format: int) -> bool:
    """Return whether a point format is one of 0 to 5, which have five bits for the class."""
    return point_format < 6


def coordinate(records: Records, header: LasHeader, axis: int) -> Float64:
    """Return coordinates along an axis (0 x, 1 y, 2 z) in units of the CRS, float64 of shape (n,)."""
    coordinates: Float64 = records["XYZ"[axis]] * header.scales[axis] + header.offsets[axis]
    return coordinates


def class_and_flags(records: Records, point_format: int) -> tuple[UInt8, UInt8]:
    """Return class and flags (bits of `tiler.core.points`), uint8 of shape (n,) each."""
    if is_legacy(point_format):
        raw = records["raw_classification"].astype(np.uint8)
        classification = raw & np.uint8(_LEGACY_CLASS_MASK)
        # Bit 5 is synthetic, bit 6 is key point, and bit 7 is withheld.
        flags = (
            _bit(raw, 5, SYNTHETIC_FLAG)
            | _bit(raw, 6, KEY_POINT_FLAG)
            | _bit(raw, 7, WITHHELD_FLAG)
        )
        flags |= (classification == _OVERLAP_CLASS).astype(np.uint8) * np.uint8(OVERLAP_FLAG)
        return classification, flags
    raw = records["classification_flags"].astype(np.uint8)
    flags = _bit(raw, 0, SYNTHETIC_FLAG) | _bit(raw, 1, KEY_POINT_FLAG)
    flags |= _bit(raw, 2, WITHHELD_FLAG) | _bit(raw, 3, OVERLAP_FLAG)
    return records["classification"].astype(np.uint8), flags


def returns(records: Records, point_format: int) -> UInt8:
    """Return the return number and the number of returns, uint8, shape (2, n)."""
    raw = records["bit_fields"].astype(np.uint8)
    if is_legacy(point_format):
        return np.stack((raw & 7, (raw >> 3) & 7))
    return np.stack((raw & 15, raw >> 4))


def scan_angles(records: Records, point_format: int) -> Float32:
    """Return scan angles in degrees, negative to the left of the flight, float32 of shape (n,)."""
    if is_legacy(point_format):
        return records["scan_angle_rank"].astype(np.float32)
    return records["scan_angle"] * np.float32(_SCAN_STEP_DEGREES)


def colours(records: Records, point_format: int) -> UInt16 | None:
    """Return red, green, blue, uint16, shape (3, n), or None if the format has no colours."""
    if point_format not in RGB_FORMATS:
        return None
    return np.stack([records[name] for name in ("red", "green", "blue")]).astype(np.uint16)


def evidence(records: Records, point_format: int) -> Evidence:
    """Return evidence of the source of the cloud (laser scanning or image matching) from the fields of records."""
    names = records.dtype.names or ()
    angle = "scan_angle_rank" if is_legacy(point_format) else "scan_angle"
    rgb = colours(records, point_format)
    # Scan direction and edge of flight line are the two highest bits in every format.
    flags = records[
        "bit_fields" if is_legacy(point_format) else "classification_flags"
    ] & np.uint8(0xC0)
    return Evidence.of(
        returns=returns(records, point_format).T,
        gps_time=records["gps_time"] if "gps_time" in names else None,
        scan_angle=records[angle],
        source_id=records["point_source_id"],
        flags=(flags,),
        intensity=records["intensity"],
        # A format without colours means that the cloud has no colours.
        rgb=np.zeros((records.size, 3)) if rgb is None else rgb.T,
    )


def write_classes(
    records: Records,
    point_format: int,
    classes: UInt8,
    chosen: Bool,
) -> None:
    """Set the class of the chosen records in place. Flags do not change."""
    if is_legacy(point_format):
        raw = records["raw_classification"]
        raw[chosen] = (raw[chosen] & ~np.uint8(_LEGACY_CLASS_MASK)) | classes[chosen]
    else:
        records["classification"][chosen] = classes[chosen]


def _bit(raw: UInt8, bit: int, flag: int) -> UInt8:
    return ((raw >> np.uint8(bit)) & np.uint8(1)) * np.uint8(flag)


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
    upgraded["scan_angle"] = np.rint(records["scan_angle_rank"] / _SCAN_STEP_DEGREES)
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
