"""Files of LAS 1.5, made from files of LAS 1.4 by the fields that the newer header has more."""

from __future__ import annotations

import struct
from pathlib import Path

TIME_OFFSET_BIT = 0x40
MORE_BYTES = 18
"""Last and first GPS time (8 bytes each), and the time offset (2)."""


def as_las15(
    path: Path, first: float = 0.0, last: float = 0.0, offset: int | None = None
) -> None:
    """Turn a LAS 1.4 file without compression into one of LAS 1.5, in place.

    Parameters
    ----------
    path : Path
    first, last : float
        Range of the GPS times in the header; 0 and 0: not given.
    offset : int, optional
        Millions of seconds that the GPS times of the points are said to lack.
    """
    raw = bytearray(path.read_bytes())
    (encoding,) = struct.unpack_from("<H", raw, 6)
    if offset is not None:
        struct.pack_into("<H", raw, 6, encoding | TIME_OFFSET_BIT | 1)
    struct.pack_into("<B", raw, 25, 5)
    header_size, points = struct.unpack_from("<HI", raw, 94)
    struct.pack_into("<HI", raw, 94, header_size + MORE_BYTES, points + MORE_BYTES)
    (evlrs,) = struct.unpack_from("<Q", raw, 235)
    if evlrs:
        struct.pack_into("<Q", raw, 235, evlrs + MORE_BYTES)
    raw[header_size:header_size] = struct.pack("<ddH", last, first, offset or 0)
    path.write_bytes(raw)
