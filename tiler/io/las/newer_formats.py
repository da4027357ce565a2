"""Records of point formats 0 to 5, 9 and 10 as those of formats 6 to 8, the only ones that COPC has (LAS 1.4 R15)."""

from __future__ import annotations

from dataclasses import replace

import laspy
import numpy as np

from tiler.core.classes import OVERLAP_FLAG
from tiler.io.las.columns import class_and_flags, is_legacy
from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import Records, record_dtype

SCAN_STEP_DEGREES = 0.006
"""Of the scan angles of formats 6 and later; older ones have whole degrees."""

_NEWER = {0: 6, 1: 6, 2: 7, 3: 7, 4: 6, 5: 7, 6: 6, 7: 7, 8: 8, 9: 6, 10: 8}
_TIMELESS = (0, 2)
_WAVES = (4, 5, 9, 10)
_WKT_BIT, _KEPT_BITS = 0x10, 0x09
"""Of the global encoding: the CRS is WKT; the kind of GPS time, and returns made up (waveforms have the others)."""


def newer_format(point_format: int) -> int:
    """The format, 6, 7 or 8, that holds what points of another one have but waveforms."""
    return _NEWER[point_format]


def newer_bytes(point_format: int, record_length: int) -> int:
    """Bytes of a record that has as many extra bytes as one of these."""
    return _bare_bytes(_NEWER[point_format]) + record_length - _bare_bytes(point_format)


def newer_header(header: LasHeader) -> LasHeader:
    """The header that says how points of a file look as format 6, 7 or 8; its records are those of the file."""
    return replace(
        header,
        version=(1, 4),
        point_format=_NEWER[header.point_format],
        record_length=newer_bytes(header.point_format, header.record_length),
        global_encoding=header.global_encoding & _KEPT_BITS | _WKT_BIT,
    )


def _bare_bytes(point_format: int) -> int:
    return int(laspy.PointFormat(point_format).dtype().itemsize)


def as_newer(records: Records, point_format: int) -> Records:
    """Records of ``point_format`` as those of format 6, 7 or 8; the same object where nothing has to change.

    Class 12 of formats 0 to 5, overlap, is kept and also becomes the flag for it. Angles are rounded to steps of
    0.006 degrees, from which whole degrees come back.
    """
    form = _NEWER[point_format]
    if form == point_format:
        return records
    extra = records.dtype["extra"].itemsize if "extra" in (records.dtype.names or ()) else 0
    dtype = record_dtype(form, _bare_bytes(form) + extra)
    found = np.zeros(len(records), dtype=dtype)
    for name in set(dtype.names or ()) & set(records.dtype.names or ()) - {"bit_fields"}:
        found[name] = records[name]
    if not is_legacy(point_format):
        found["bit_fields"] = records["bit_fields"]
        return found
    bits = records["bit_fields"]
    found["bit_fields"] = (bits & 7) | (((bits >> 3) & 7) << 4)
    classification, flags = class_and_flags(records, point_format)
    found["classification"] = classification
    raw = records["raw_classification"]
    overlap = (flags & OVERLAP_FLAG != 0).astype(np.uint8)
    # bits 0 to 2 synthetic, key point, withheld; 3 overlap; 6 scan direction, 7 edge of the flight line
    found["classification_flags"] = (raw >> 5) | (overlap << 3) | (bits & 0xC0)
    found["scan_angle"] = np.rint(records["scan_angle_rank"] / SCAN_STEP_DEGREES)
    return found


def changes_of_format(header: LasHeader) -> list[str]:
    """What is not as it was in points that become format 6, 7 or 8: a line each, none where all is kept."""
    old, new = header.point_format, _NEWER[header.point_format]
    found = [] if old == new else [f"points of format {old} written as format {new}, as COPC has it"]
    if old in _TIMELESS:
        found.append("COPC has a GPS time for each point: 0, as the input has none")
    if old in _WAVES:
        found.append("waveforms left out: COPC has none")
    return found
