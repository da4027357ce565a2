"""Parts of a cloud: a sample of positions, and windows at full density, written as LAS files."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tiler.io.cloud_formats import open_cloud
from tiler.io.las.headers import LasHeader, read_header
from tiler.io.las.octree import Box, Octree
from tiler.io.las.point_formats import coordinate
from tiler.io.las.reader import COORDINATES, EVERYTHING, PointReader, Records, rows_at_once

_STEP = 1_000_000
_PLACE_POINTS = 1000
_PLACE_STEP = 250
_OF_PLACE = _PLACE_POINTS // _PLACE_STEP
_BLOCK_BYTES = 1 << 16
"""Bytes per request to a URL, to read the header and the records before the points."""


def sample_places(
    path: Path, places: int, salvage: bool = False, octree: Octree | None = None
) -> list[tuple[float, float]]:
    """Return x and y of a few points, at even distances in the file or from the root of an octree.

    Parameters
    ----------
    path : Path
    places : int
        Number of positions in the file, with four points each.
    salvage : bool
        See `tiler.io.las.headers.read_header`.
    octree : Octree, optional
        Octree of the file, from whose root the points are read if given.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    header = read_header(path, salvage)
    if octree is not None:
        root = octree.root(header, rows_at_once(header.record_length, _STEP))
        with PointReader(header, COORDINATES, _BLOCK_BYTES, [root]) as reader:
            records = reader.read(*root)[:: max(root[1] // (places * _OF_PLACE), 1)]
        return _plan_view(records, header)
    starts = {header.point_count * i // places for i in range(places)}
    if header.laz is not None and header.laz.chunk_size:
        # Decoding begins at the start of a chunk.
        chunk = header.laz.chunk_size
        starts = {start // chunk * chunk for start in starts}
    positions: list[tuple[float, float]] = []
    with PointReader(header) as reader:
        for start in sorted(starts):
            records = reader.read(start, min(_PLACE_POINTS, header.point_count - start))
            positions += _plan_view(records[::_PLACE_STEP], header)
    return positions


def _plan_view(records: Records, header: LasHeader) -> list[tuple[float, float]]:
    x = coordinate(records, header, 0).tolist()
    y = coordinate(records, header, 1).tolist()
    return list(zip(x, y, strict=True))


def cut_windows(
    path: Path,
    windows: Sequence[Box],
    targets: Sequence[str],
    salvage: bool = False,
    octree: Octree | None = None,
) -> list[int]:
    """Write the points of each window to a separate file.

    The files are like the source, but not compressed and without EVLRs. A window without points
    gets no file.

    Parameters
    ----------
    path : Path
    windows : sequence of (x0, y0, x1, y1)
        Windows in units of the CRS, half-open.
    targets : sequence of str
        Path of the file of each window.
    salvage : bool
        See `tiler.io.las.headers.read_header`.
    octree : Octree, optional
        Octree of the file. If given, only the nodes near the windows are read.

    Returns
    -------
    list of int
        Number of points in each window.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    header = read_header(path, salvage)
    parts: list[list[Records]] = [[] for _ in windows]
    ranges = None if octree is None else octree.near(header, windows)
    with PointReader(header, EVERYTHING, ranges=ranges) as reader:
        for records in reader.pieces():
            x = coordinate(records, header, 0)
            y = coordinate(records, header, 1)
            for (x0, y0, x1, y1), part in zip(windows, parts, strict=True):
                inside = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
                if inside.any():
                    part.append(records[inside])
    for part, target in zip(parts, targets, strict=True):
        if part:
            _write(header, np.concatenate(part), Path(target))
    return [sum(r.size for r in part) for part in parts]


def _write(header: LasHeader, records: Records, target: Path) -> None:
    """Write records after the header of their source, with changed fields about points (LAS 1.4 R15, table 3).

    The numbers of points by return are 0.
    """
    with open_cloud(header.path, _BLOCK_BYTES) as source:
        front = bytearray(source.read(header.points_offset))
    bounds = []
    for axis in range(3):
        values = coordinate(records, header, axis)
        bounds += [float(values.max()), float(values.min())]
    struct.pack_into("<B", front, 104, header.point_format)
    struct.pack_into(
        "<I5I", front, 107, 0 if header.version[1] >= 4 else records.size, *[0] * 5
    )
    struct.pack_into("<6d", front, 179, *bounds)
    if header.version[1] >= 3:
        struct.pack_into("<Q", front, 227, 0)
    if header.version[1] >= 4:
        struct.pack_into("<QIQ15Q", front, 235, 0, 0, records.size, *[0] * 15)
    with open(target, "wb") as stream:
        stream.write(front)
        records.tofile(stream)
