"""LAZ files whose chunks have sizes of their own."""

from __future__ import annotations

from pathlib import Path

import lazrs
import numpy as np

from tiler.io.las.headers import read_header


def variable_chunks(
    path: Path, sizes: list[int], records: np.ndarray, point_format: int
) -> None:
    """Write the points of a LAZ file again in chunks of their own sizes, as COPC has them."""
    header = read_header(path)
    vlr = lazrs.LazVlr.new_for_compression(point_format, 0, True)
    data = bytearray(path.read_bytes()[: header.points_offset])
    old = next(v for v in header.vlrs if v.is_laszip)
    assert len(vlr.record_data()) == old.length
    data[old.payload : old.end] = vlr.record_data()
    path.write_bytes(data)
    with open(path, "r+b") as stream:
        stream.seek(header.points_offset)
        compressor = lazrs.LasZipCompressor(stream, vlr)
        ends = np.cumsum(sizes)
        compressor.compress_chunks(
            [
                np.frombuffer(records[e - s : e].tobytes(), np.uint8)
                for s, e in zip(sizes, ends, strict=True)
            ]
        )
        compressor.done()
