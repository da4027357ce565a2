"""Polygons of a shapefile (ESRI Shapefile Technical Description, 1998)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tiler.errors import InputError

_CODE, _HEADER, _NULL = 9994, 100, 0
_POLYGONS = (5, 15, 25)
"""Plain, with z, with a measure: all begin with the same x and y."""
_PARTS_AT, _BOX = 44, 32

Ring = npt.NDArray[np.float64]


def read_shapes(path: Path) -> tuple[list[list[Ring]], str | None]:
    """Rings of each polygon (float64 (n, 2)) and the text of the ``.prj`` file beside it; raises InputError."""
    try:
        content = path.read_bytes()
        projection = next((p for p in (path.with_suffix(s) for s in (".prj", ".PRJ")) if p.is_file()), None)
        crs = None if projection is None else projection.read_text("utf-8", "replace").strip() or None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); name a readable file") from error
    try:
        code, (kind,) = struct.unpack_from(">i", content)[0], struct.unpack_from("<i", content, 32)
        if code != _CODE:
            raise InputError(f"{path}: is no shapefile")
        if kind not in (*_POLYGONS, _NULL):
            raise InputError(f"{path}: holds no polygons (shape type {kind}); name a layer of polygons")
        return _records(path, content), crs
    except (struct.error, ValueError) as error:
        raise InputError(f"{path}: is damaged ({error}); get the file again") from error


def _records(path: Path, content: bytes) -> list[list[Ring]]:
    found, start = [], _HEADER
    while start < len(content):
        number, words = struct.unpack_from(">2i", content, start)
        record = memoryview(content)[start + 8 : start + 8 + 2 * words]
        if words < 2 or len(record) < 2 * words:
            raise ValueError(f"record {number} is cut off")
        (kind,) = struct.unpack_from("<i", record)
        if kind in _POLYGONS:
            found.append(_rings(record))
        elif kind != _NULL:
            raise InputError(f"{path}: record {number} is no polygon (shape type {kind})")
        start += 8 + 2 * words
    return found


def _rings(record: memoryview) -> list[Ring]:
    parts, points = struct.unpack_from("<2i", record, 4 + _BOX)
    if parts < 0 or points < 0:
        raise ValueError(f"{parts} rings, {points} points")
    firsts = np.frombuffer(record, "<i4", parts, _PARTS_AT).astype(np.int64)
    xy = np.frombuffer(record, "<f8", 2 * points, _PARTS_AT + 4 * parts).astype(np.float64).reshape(-1, 2)
    ends = np.append(firsts[1:], points)
    if (firsts < 0).any() or (ends < firsts).any() or (ends > points).any():
        raise ValueError("its rings begin nowhere")
    return [xy[first:end] for first, end in zip(firsts, ends, strict=True)]
