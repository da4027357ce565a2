"""Variable length records (VLRs and EVLRs): finding them in a file, and packing new ones."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

_VLR = struct.Struct("<H16sHH32s")
_EVLR = struct.Struct("<H16sHQ32s")

PROJECTION_USER = "LASF_Projection"
LASZIP_USER = "laszip encoded"
LASZIP_RECORD = 22204
COPC_USER = "copc"

MAX_RECORDS = 10_000
"""Maximum number of records that are read: a large file could have more empty records than fit
into memory."""


@dataclass(frozen=True)
class Vlr:
    """Position of a VLR or EVLR in its file.

    Attributes
    ----------
    user_id : str
        User ID up to the first NUL.
    record_id : int
    start : int
        Byte offset of the record's own header.
    payload : int
        Byte offset of the content.
    length : int
        Length of the content in bytes.
    """

    user_id: str
    record_id: int
    start: int
    payload: int
    length: int

    @property
    def end(self) -> int:
        """Byte offset of the first byte after the record."""
        return self.payload + self.length

    @property
    def is_laszip(self) -> bool:
        """Whether the record describes the compression of the points."""
        return self.record_id == LASZIP_RECORD and self.user_id == LASZIP_USER

    @property
    def is_copc(self) -> bool:
        """Whether the record belongs to the octree of a COPC file."""
        return self.user_id == COPC_USER


def packed_record(
    user_id: str, record_id: int, description: str, payload: bytes, extended: bool = False
) -> bytes:
    """Return a complete VLR or EVLR as bytes."""
    form = _EVLR if extended else _VLR
    return (
        form.pack(0, user_id.encode(), record_id, len(payload), description.encode()) + payload
    )


def walk_records(
    stream: BinaryIO, start: int, count: int, end: int, extended: bool
) -> tuple[tuple[Vlr, ...], bool]:
    """Return the records from ``start`` that fit before ``end``, and whether all ``count`` records fit.

    Only the headers of the records are read, and at most `MAX_RECORDS` of them.
    """
    form = _EVLR if extended else _VLR
    records: list[Vlr] = []
    position = start
    for _ in range(min(count, MAX_RECORDS)):
        if position + form.size > end:
            return tuple(records), False
        stream.seek(position)
        _, user, record_id, length, _ = form.unpack(stream.read(form.size))
        payload = position + form.size
        if payload + length > end:
            return tuple(records), False
        name = user.split(b"\0")[0].decode("ascii", "replace")
        records.append(Vlr(name, record_id, position, payload, length))
        position = payload + length
    return tuple(records), count <= MAX_RECORDS
