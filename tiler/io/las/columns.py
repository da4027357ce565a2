"""Fields of LAS records as the columns of a `PointBlock`, the same for every point format.

LAS 1.4 R15, tables 8 to 17: formats 0 to 5 keep class (5 bits) and flags in one byte, 6 to 10 in two.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.classes import KEY_POINT_FLAG, OVERLAP_FLAG, SYNTHETIC_FLAG, WITHHELD_FLAG
from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import Records

OVERLAP_CLASS = 12
"""Overlap points of formats 0 to 5, which have no flag for them."""

LEGACY_CLASS_MASK = 0x1F

RGB_FORMATS = (2, 3, 5, 7, 8, 10)


def is_legacy(point_format: int) -> bool:
    """Whether a point format is one of 0 to 5, which have five bits of class."""
    return point_format < 6


def coordinate(records: Records, header: LasHeader, axis: int) -> npt.NDArray[np.float64]:
    """Coordinates along an axis (0 x, 1 y, 2 z) in units of the CRS, float64 of shape (n,)."""
    found: npt.NDArray[np.float64] = records["XYZ"[axis]] * header.scales[axis] + header.offsets[axis]
    return found


def class_and_flags(
    records: Records, point_format: int
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Class and flags (bits of `tiler.core.classes`), uint8 of shape (n,) each."""
    if is_legacy(point_format):
        raw = records["raw_classification"].astype(np.uint8)
        classification = raw & np.uint8(LEGACY_CLASS_MASK)
        # bit 5 synthetic, 6 key point, 7 withheld
        flags = _bit(raw, 5, SYNTHETIC_FLAG) | _bit(raw, 6, KEY_POINT_FLAG) | _bit(raw, 7, WITHHELD_FLAG)
        flags |= (classification == OVERLAP_CLASS).astype(np.uint8) * np.uint8(OVERLAP_FLAG)
        return classification, flags
    raw = records["classification_flags"].astype(np.uint8)
    flags = _bit(raw, 0, SYNTHETIC_FLAG) | _bit(raw, 1, KEY_POINT_FLAG)
    flags |= _bit(raw, 2, WITHHELD_FLAG) | _bit(raw, 3, OVERLAP_FLAG)
    return records["classification"].astype(np.uint8), flags


def returns(records: Records, point_format: int) -> npt.NDArray[np.uint8]:
    """Return number and number of returns, uint8, shape (2, n)."""
    raw = records["bit_fields"].astype(np.uint8)
    if is_legacy(point_format):
        return np.stack((raw & 7, (raw >> 3) & 7))
    return np.stack((raw & 15, raw >> 4))


def colours(records: Records, point_format: int) -> npt.NDArray[np.uint16] | None:
    """Red, green, blue, uint16, shape (3, n); None where the format has none."""
    if point_format not in RGB_FORMATS:
        return None
    return np.stack([records[name] for name in ("red", "green", "blue")]).astype(np.uint16)


def write_classes(
    records: Records, point_format: int, classes: npt.NDArray[np.uint8], chosen: npt.NDArray[np.bool_]
) -> None:
    """Set the class of the chosen records in place; flags stay."""
    if is_legacy(point_format):
        raw = records["raw_classification"]
        raw[chosen] = (raw[chosen] & ~np.uint8(LEGACY_CLASS_MASK)) | classes[chosen]
    else:
        records["classification"][chosen] = classes[chosen]


def _bit(raw: npt.NDArray[np.uint8], bit: int, flag: int) -> npt.NDArray[np.uint8]:
    return ((raw >> np.uint8(bit)) & np.uint8(1)) * np.uint8(flag)
