"""Parts of a cloud: a sample of places, and windows cut out at full density as plain LAS files."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tiler.io.cloud_reading import open_cloud
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.las.reader import EVERYTHING, PointReader, Records, rows_at_once

_STEP = 1_000_000
_PLACE_POINTS = 1000
_PLACE_STEP = 250

Box = tuple[float, float, float, float]
"""Lowest x, y, highest x, y in units of the CRS, half-open."""


def sample_places(path: Path, places: int, salvage: bool = False) -> list[tuple[float, float]]:
    """Where points lie: x, y of a few points at even distances in the file.

    Parameters
    ----------
    path : Path
    places : int
        In the file, of four points each.
    salvage : bool
        As `tiler.io.las.headers.read_header` takes it.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    header = read_header(path, salvage)
    chunk = header.laz.chunk_size if header.laz is not None else None
    starts = {header.point_count * i // places for i in range(places)}
    if chunk:  # decoding begins with a chunk
        starts = {start // chunk * chunk for start in starts}
    found: list[tuple[float, float]] = []
    with PointReader(header) as reader:
        for start in sorted(starts):
            records = reader.read(start, min(_PLACE_POINTS, header.point_count - start))
            x, y = (_coordinate(records, header, axis)[::_PLACE_STEP].tolist() for axis in (0, 1))
            found += zip(x, y, strict=True)
    return found


def cut_windows(
    path: Path, windows: Sequence[Box], targets: Sequence[str], salvage: bool = False
) -> list[int]:
    """Write the points of each window into a file of its own; the points in each.

    The files are LAS as the source is but for compression, with its VLRs and without its EVLRs. A window without
    points gets no file.

    Parameters
    ----------
    path : Path
    windows : sequence of (x0, y0, x1, y1)
    targets : sequence of str
        A file for each window.
    salvage : bool
        As `tiler.io.las.headers.read_header` takes it.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    header = read_header(path, salvage)
    parts: list[list[Records]] = [[] for _ in windows]
    with PointReader(header, EVERYTHING) as reader:
        step = rows_at_once(header.record_length, _STEP)
        for start in range(0, header.point_count, step):
            records = reader.read(start, min(step, header.point_count - start))
            x, y = (_coordinate(records, header, axis) for axis in (0, 1))
            for (x0, y0, x1, y1), part in zip(windows, parts, strict=True):
                inside = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
                if inside.any():
                    part.append(records[inside])
    for part, target in zip(parts, targets, strict=True):
        if part:
            _write(header, np.concatenate(part), Path(target))
    return [sum(r.size for r in part) for part in parts]


def _coordinate(records: Records, header: LasHeader, axis: int) -> npt.NDArray[np.float64]:
    values: npt.NDArray[np.float64] = records["XYZ"[axis]] * header.scales[axis] + header.offsets[axis]
    return values


def _write(header: LasHeader, records: Records, target: Path) -> None:
    """Bytes 94 to 375 of a LAS header that speak of its points, LAS 1.4 R15 table 3; returns are not counted."""
    with open_cloud(header.path) as source:
        front = bytearray(source.read(header.points_offset))
    bounds = []
    for axis in range(3):
        values = _coordinate(records, header, axis)
        bounds += [float(values.max()), float(values.min())]
    struct.pack_into("<B", front, 104, header.point_format)
    struct.pack_into("<I5I", front, 107, 0 if header.version[1] >= 4 else records.size, *[0] * 5)
    struct.pack_into("<6d", front, 179, *bounds)
    if header.version[1] >= 3:
        struct.pack_into("<Q", front, 227, 0)
    if header.version[1] >= 4:
        struct.pack_into("<QIQ15Q", front, 235, 0, 0, records.size, *[0] * 15)
    with open(target, "wb") as stream:
        stream.write(front)
        records.tofile(stream)
