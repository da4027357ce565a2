"""Writers of the points of a LAZ or LAS file after the header, which the caller writes. lazrs compresses points."""

from __future__ import annotations

import os
from typing import Any, BinaryIO

import lazrs
import numpy as np

from tiler.io.las.headers import LasHeader
from tiler.io.las.reader import Records
from tiler.io.las.records import LASZIP_RECORD, LASZIP_USER, packed_record


def laszip_vlr(header: LasHeader, own_sizes: bool = False) -> bytes:
    """Return the laszip record for points like those of ``header``, in chunks of equal or different sizes."""
    data = bytes(layout_of(header, own_sizes).record_data())
    return packed_record(LASZIP_USER, LASZIP_RECORD, "lazrs", data)


def layout_of(header: LasHeader, own_sizes: bool = False) -> Any:
    """Return lazrs' settings for points like those of ``header``, in chunks of equal or different sizes."""
    bare = lazrs.LazVlr.new_for_compression(header.point_format, 0).item_size()
    return lazrs.LazVlr.new_for_compression(
        header.point_format, header.record_length - bare, own_sizes
    )


class PointWriter:
    """Writer of compressed records from the current position of ``target``. `close` adds the chunk table.

    Parameters
    ----------
    target : BinaryIO
        Seekable file, whose position after `close` is undefined.
    header : LasHeader
        Header of a file with the same point format and record length.
    threads : int
        Number of threads that compress chunks, which does not change the bytes. The first number above 1 in a process
        applies to all its writers.
    """

    def __init__(self, target: BinaryIO, header: LasHeader, threads: int = 1) -> None:
        self._compressor: Any
        if threads > 1:
            # The default of this variable is the number of cores.
            os.environ.setdefault("RAYON_NUM_THREADS", str(threads))
            self._compressor = lazrs.ParLasZipCompressor(target, layout_of(header))
        else:
            self._compressor = lazrs.LasZipCompressor(target, layout_of(header))

    def write(self, records: Records) -> None:
        """Append records. Raise OSError if they cannot be written."""
        try:
            self._compressor.compress_many(np.ascontiguousarray(records).view(np.uint8))
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error

    def close(self) -> None:
        """Write the remaining points and the chunk table. Raise OSError if they cannot be written."""
        try:
            self._compressor.done()
        except lazrs.LazrsError as error:
            raise OSError(str(error)) from error


class PlainWriter:
    """Writer of records without compression from the current position of ``target``."""

    def __init__(self, target: BinaryIO) -> None:
        self._target = target

    def write(self, records: Records) -> None:
        """Append records. Raise OSError if they cannot be written."""
        self._target.write(np.ascontiguousarray(records).view(np.uint8).data)

    def close(self) -> None:
        """Do nothing, since all records are written."""
