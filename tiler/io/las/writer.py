"""Points of a LAZ or LAS file, behind a header that somebody else writes; lazrs compresses."""

from __future__ import annotations

import os
from typing import Any, BinaryIO

import lazrs
import numpy as np

from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import Records
from tiler.io.las.records import LASZIP_RECORD, LASZIP_USER, packed_record


def laszip_vlr(header: LasHeader, own_sizes: bool = False) -> bytes:
    """The whole laszip record for points like those of ``header``, in equal chunks or in some of ``own_sizes``."""
    data = bytes(layout_of(header, own_sizes).record_data())
    return packed_record(LASZIP_USER, LASZIP_RECORD, "lazrs", data)


def layout_of(header: LasHeader, own_sizes: bool = False) -> Any:
    """How lazrs compresses points like those of ``header``, in equal chunks or in some of ``own_sizes``."""
    bare = lazrs.LazVlr.new_for_compression(header.point_format, 0).item_size()
    return lazrs.LazVlr.new_for_compression(header.point_format, header.record_length - bare, own_sizes)


class PointWriter:
    """Writes records, compressed, from the place where ``target`` stands; `close` adds the chunk table.

    Parameters
    ----------
    target : BinaryIO
        Seekable; its position after `close` is undefined.
    header : LasHeader
        Of a file with the same point format and record length.
    threads : int
        That compress chunks at a time; the bytes are the same. The first number above 1 holds for this process.
    """

    def __init__(self, target: BinaryIO, header: LasHeader, threads: int = 1) -> None:
        if threads > 1:
            os.environ.setdefault("RAYON_NUM_THREADS", str(threads))  # else as many as there are cores
        compressor: Any = lazrs.ParLasZipCompressor if threads > 1 else lazrs.LasZipCompressor
        self._compressor = compressor(target, layout_of(header))

    def write(self, records: Records) -> None:
        """Append records; raises OSError where the target does not take them."""
        try:
            self._compressor.compress_many(np.ascontiguousarray(records).view(np.uint8))
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error

    def close(self) -> None:
        """Write what is left and the chunk table; raises OSError."""
        try:
            self._compressor.done()
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error


class PlainWriter:
    """Writes records as they are, from the place where ``target`` stands."""

    def __init__(self, target: BinaryIO) -> None:
        self._target = target

    def write(self, records: Records) -> None:
        """Append records; raises OSError where the target does not take them."""
        self._target.write(np.ascontiguousarray(records).view(np.uint8).data)

    def close(self) -> None:
        """Nothing is left to write."""
