"""Conversion of the fields of LAS records to columns of a `PointBlock`, which do not depend on the point format.

In formats 0 to 5, class (5 bits) and flags are in one byte, in formats 6 to 10 in two (LAS 1.4
R15, tables 8 to 17).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.matched.evidence import Evidence
from tiler.core.classes import KEY_POINT_FLAG, OVERLAP_FLAG, SYNTHETIC_FLAG, WITHHELD_FLAG
from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import Records

OVERLAP_CLASS = 12
"""Class of overlap points in formats 0 to 5, which do not have a flag for overlap."""

LEGACY_CLASS_MASK = 0x1F

SCAN_STEP_DEGREES = 0.006
"""Step of the scan angles of formats 6 to 10. Older formats have whole degrees."""

RGB_FORMATS = (2, 3, 5, 7, 8, 10)


def is_legacy(point_format: int) -> bool:
    """Return whether a point format is one of 0 to 5, which have five bits for the class."""
    return point_format < 6


def coordinate(records: Records, header: LasHeader, axis: int) -> npt.NDArray[np.float64]:
    """Return coordinates along an axis (0 x, 1 y, 2 z) in units of the CRS, float64 of shape (n,)."""
    coordinates: npt.NDArray[np.float64] = (
        records["XYZ"[axis]] * header.scales[axis] + header.offsets[axis]
    )
    return coordinates


def class_and_flags(
    records: Records, point_format: int
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Return class and flags (bits of `tiler.core.classes`), uint8 of shape (n,) each."""
    if is_legacy(point_format):
        raw = records["raw_classification"].astype(np.uint8)
        classification = raw & np.uint8(LEGACY_CLASS_MASK)
        # Bit 5 is synthetic, bit 6 is key point, and bit 7 is withheld.
        flags = (
            _bit(raw, 5, SYNTHETIC_FLAG)
            | _bit(raw, 6, KEY_POINT_FLAG)
            | _bit(raw, 7, WITHHELD_FLAG)
        )
        flags |= (classification == OVERLAP_CLASS).astype(np.uint8) * np.uint8(OVERLAP_FLAG)
        return classification, flags
    raw = records["classification_flags"].astype(np.uint8)
    flags = _bit(raw, 0, SYNTHETIC_FLAG) | _bit(raw, 1, KEY_POINT_FLAG)
    flags |= _bit(raw, 2, WITHHELD_FLAG) | _bit(raw, 3, OVERLAP_FLAG)
    return records["classification"].astype(np.uint8), flags


def returns(records: Records, point_format: int) -> npt.NDArray[np.uint8]:
    """Return the return number and the number of returns, uint8, shape (2, n)."""
    raw = records["bit_fields"].astype(np.uint8)
    if is_legacy(point_format):
        return np.stack((raw & 7, (raw >> 3) & 7))
    return np.stack((raw & 15, raw >> 4))


def scan_angles(records: Records, point_format: int) -> npt.NDArray[np.float32]:
    """Return scan angles in degrees, negative to the left of the flight, float32 of shape (n,)."""
    if is_legacy(point_format):
        return records["scan_angle_rank"].astype(np.float32)
    return records["scan_angle"] * np.float32(SCAN_STEP_DEGREES)


def colours(records: Records, point_format: int) -> npt.NDArray[np.uint16] | None:
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
    classes: npt.NDArray[np.uint8],
    chosen: npt.NDArray[np.bool_],
) -> None:
    """Set the class of the chosen records in place. Flags do not change."""
    if is_legacy(point_format):
        raw = records["raw_classification"]
        raw[chosen] = (raw[chosen] & ~np.uint8(LEGACY_CLASS_MASK)) | classes[chosen]
    else:
        records["classification"][chosen] = classes[chosen]


def _bit(raw: npt.NDArray[np.uint8], bit: int, flag: int) -> npt.NDArray[np.uint8]:
    return ((raw >> np.uint8(bit)) & np.uint8(1)) * np.uint8(flag)
