"""Octrees of COPC 1.0: the cubes of a file's chunks, and the division of points among the nodes of a new file.

Upper levels get few, evenly distributed points, leaves get the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

import numpy as np
from laspy.copc import CopcInfoVlr, Entry, HierarchyPage

from ptd.arrays import Float64, Int8, Int32, Int64
from tiler.io.cloud_reading import open_location
from tiler.io.las.headers import LasHeader
from tiler.io.las.layout import CorruptLazError
from tiler.io.las.reader import Records

_INFO_BYTES = 160
_ENTRY_BYTES = 32
_DEEPEST_KEY = 30
_INFO = 1
"""Record ID of the record with the cube of the root."""
_BLOCK_BYTES = 1 << 14
"""Bytes per request to a URL until the hierarchy is found. Each page is then read with one
request."""


Box = tuple[float, float, float, float]
"""Lowest x, y, highest x, y in units of the CRS."""


@dataclass(frozen=True)
class Octree:
    """Squares of the chunks in plan view.

    Attributes
    ----------
    west, south, side : float
        Lower left corner and side of the root's square, in units of the CRS.
    keys : tuple of (int, int, int)
        Level, column and row of each chunk's square, in the order of the file. Level 0 is the root.
    """

    west: float
    south: float
    side: float
    keys: tuple[tuple[int, int, int], ...]

    def box(self, key: tuple[int, int, int]) -> Box:
        """Return the square of a chunk."""
        level, column, row = key
        side = self.side / 2**level
        x, y = self.west + column * side, self.south + row * side
        return x, y, x + side, y + side

    def root(self, header: LasHeader, most: int) -> tuple[int, int]:
        """Return the range (first record, number) of the uppermost node with points, at most ``most`` records."""
        counts = _points_of_chunks(header)
        _, chunk = min(
            (key[0], number) for number, key in enumerate(self.keys) if counts[number]
        )
        return sum(counts[:chunk]), min(counts[chunk], most)

    def near(self, header: LasHeader, boxes: Sequence[Box]) -> list[tuple[int, int]]:
        """Return ranges (first record, number) of the nodes within one unit of a box. Adjacent ranges are joined."""
        ranges: list[tuple[int, int]] = []
        start = 0
        for key, count in zip(self.keys, _points_of_chunks(header), strict=True):
            square = self.box(key)
            if count and any(_are_near(square, box) for box in boxes):
                first = start
                if ranges and sum(ranges[-1]) == start:
                    first, _ = ranges.pop()
                ranges.append((first, start + count - first))
            start += count
        return ranges

    def spread(
        self, counts: Sequence[int], sample: Float64, level: int
    ) -> dict[tuple[int, int, int], float]:
        """Return the squares of a level that contain points, with an estimate of the number of points in each.

        The points of a node above that level are divided among its squares in proportion to the
        sample.

        Parameters
        ----------
        counts : sequence of int
            Number of points in each chunk.
        sample : float64, shape (2, n)
            x and y of points from the whole file, in units of the CRS.
        level : int
            Level of the squares.
        """
        x0, y0, x1, y1 = self.box((0, 0, 0))
        seen = np.histogram2d(
            sample[0], sample[1], bins=1 << level, range=((x0, x1), (y0, y1))
        )[0]
        held = np.zeros_like(seen)
        for (deep, column, row), count in zip(self.keys, counts, strict=True):
            above = max(level - deep, 0)
            below = max(deep - level, 0)
            column = (column >> below) << above
            row = (row >> below) << above
            window = np.s_[column : column + (1 << above), row : row + (1 << above)]
            if seen[window].any():
                held[window] += count * seen[window] / seen[window].sum()
            # There is no sample point that shows the position of these few points in the node.
            else:
                held[column + (1 << above) // 2, row + (1 << above) // 2] += count
        return {(level, int(c), int(r)): float(held[c, r]) for c, r in np.argwhere(held)}


def read_octree(header: LasHeader) -> Octree:
    """Read the octree of a COPC file, and check it against the chunk table.

    Raises
    ------
    CorruptLazError
        There is no octree, it is damaged, or it does not contain each chunk once.
    """
    layout = header.laz
    info_record = next((v for v in header.vlrs if v.is_copc and v.record_id == _INFO), None)
    if info_record is None or info_record.length < _INFO_BYTES:
        raise CorruptLazError("it has no COPC info record")
    if layout is None or layout.rebuilt or not layout.sizes.size:
        raise CorruptLazError("it has no table of chunks")
    with open_location(header.path, _BLOCK_BYTES) as stream:
        stream.seek(info_record.payload)
        info = CopcInfoVlr()
        info.parse_record_data(stream.read(_INFO_BYTES))
        if not (
            np.isfinite(info.center).all()
            and math.isfinite(info.halfsize)
            and info.halfsize > 0
        ):
            raise CorruptLazError(
                f"its octree has its centre at {info.center.tolist()} and half a side of {info.halfsize}"
            )
    entries = _entries(header.path, info, header.size, int(layout.counts.size))
    starts = header.points_offset + 8 + np.cumsum(layout.sizes) - layout.sizes
    chunk_at = {int(s): i for i, s in enumerate(starts.tolist()) if layout.counts[i]}
    entry_by_chunk: dict[int, Entry] = {}
    for entry in entries:
        chunk = chunk_at.get(entry.offset)
        if chunk is None or chunk in entry_by_chunk:
            raise CorruptLazError(
                f"its octree has a node at byte {entry.offset}, where no chunk begins or which has another node"
            )
        if (entry.point_count, entry.byte_size) != (layout.counts[chunk], layout.sizes[chunk]):
            raise CorruptLazError(
                f"its octree says {entry.point_count} points in {entry.byte_size} bytes at byte {entry.offset}, "
                f"its table of chunks {layout.counts[chunk]} in {layout.sizes[chunk]}"
            )
        entry_by_chunk[chunk] = entry
    if len(entry_by_chunk) != len(chunk_at):
        raise CorruptLazError(
            f"its octree names {len(entry_by_chunk)} of {len(chunk_at)} chunks"
        )
    # Chunks without points are in no node and keep this key.
    keys = [(0, 0, 0)] * layout.counts.size
    for chunk, entry in entry_by_chunk.items():
        keys[chunk] = (entry.key.level, entry.key.x, entry.key.y)
    west, south = (float(c - info.halfsize) for c in info.center[:2])
    return Octree(west, south, 2 * float(info.halfsize), tuple(keys))


def _entries(path: Path, info: CopcInfoVlr, size: int, chunks: int) -> list[Entry]:
    """Return the nodes with points, from all pages of the hierarchy."""
    entries: list[Entry] = []
    pages = [(info.hierarchy_root_offset, info.hierarchy_root_size)]
    seen = set[int]()
    # A node has at most eight children, with points or without.
    left = _ENTRY_BYTES * (8 * chunks + 9)
    while pages:
        offset, length = pages.pop()
        left -= length
        if (
            length <= 0
            or length % _ENTRY_BYTES
            or offset + length > size
            or offset in seen
            or left < 0
        ):
            raise CorruptLazError(
                f"its octree has a page of {length} bytes at byte {offset} of {size}"
            )
        seen.add(offset)
        with open_location(path, _BLOCK_BYTES, [(offset, offset + length)]) as stream:
            stream.seek(offset)
            raw = stream.read(length)
        if len(raw) < length:
            raise CorruptLazError(f"its octree ends at byte {offset + len(raw)}")
        for entry in HierarchyPage.from_bytes(raw).entries.values():
            key = entry.key
            place = (key.x, key.y, key.z)
            if not (
                0 <= key.level <= _DEEPEST_KEY and all(0 <= at < 1 << key.level for at in place)
            ):
                raise CorruptLazError(
                    f"its octree has a node {key.level}-{key.x}-{key.y}-{key.z}"
                )
            if entry.point_count == -1:
                pages.append((entry.offset, entry.byte_size))
            elif entry.point_count > 0:
                entries.append(entry)
            elif entry.point_count < -1:
                raise CorruptLazError(f"its octree has a node of {entry.point_count} points")
    return entries


def _points_of_chunks(header: LasHeader) -> list[int]:
    if header.laz is None:
        return []
    counts: list[int] = header.laz.counts.tolist()
    return counts


def _are_near(one: Box, other: Box) -> bool:
    """Return whether two boxes are at most one unit apart."""
    west, south, east, north = one
    w, s, e, n = other
    return w <= east + 1 and e >= west - 1 and s <= north + 1 and n >= south - 1


Key = tuple[int, int, int, int]
"""Key of a node: its level, 0 for the root, and its position along x, y and z."""
Places = Int32
"""Positions of points in the cube of the octree, shape (3, n), from 0 to 2**DEPTH - 1."""

DEPTH = 28
CELLS_OF_NODE = 7
"""Number of levels between a node and its cells: a node has 2**7 cells along each axis.

A node with children has one point per cell."""
DEEPEST = DEPTH - CELLS_OF_NODE
"""Deepest level. Nodes of this level are not divided, however many points they have."""
LEAF_POINTS = 32_768
"""Maximum number of points of a leaf. A node with children may have more, one per cell."""
MIN_POINTS = 256
"""Minimum number of points of a node below the root. Fewer points stay in the node above."""

_BITS = 21
"""Bits of a position in a brick along each axis. The bits of three axes fit into 64 bits."""
_AXES = (0, 1, 2)
_SPREADING = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""Shifts and masks that put two zero bits between the bits of a number, for a Z-order curve."""


def octree_batches(
    pieces: Iterable[Records],
    count: int,
    most: int,
    places: Callable[[Records], Places],
    folder: str,
    key: Key = (0, 0, 0, 0),
) -> Iterator[tuple[Key, Records]]:
    """Divide the points of a cloud into bricks: cubes of the octree with at most ``most`` points each.

    Parameters
    ----------
    pieces : iterable of Records
        Pieces of the cloud, of at most ``most`` records each.
    count : int
        Number of records in all pieces.
    most : int
        Maximum number of points of a brick. Only a brick of the level `DEEPEST` may have more.
    places : callable
        Function that computes the positions of records.
    folder : str
        Folder for temporary files, which have no name.
    key : Key
        Key of the node with the points.

    Yields
    ------
    key : Key
        Key of the brick. The bricks in one parent follow one another.
    records : Records
        Points of the brick, in an order that depends only on the order of the pieces.
    """
    level, *corner = key
    if count <= most or level == DEEPEST:
        yield key, np.concatenate(list(pieces))
        return
    shift = DEPTH - level - 1
    parts: list[list[tuple[int, int]]] = [[] for _ in range(8)]
    with TemporaryFile(dir=folder) as spool:
        for records in pieces:
            half = (places(records) >> shift) & 1
            child = half[0] * 4 + half[1] * 2 + half[2]
            at = spool.tell()
            records[np.argsort(child, kind="stable")].tofile(spool)
            for number, held in enumerate(np.bincount(child, minlength=8).tolist()):
                if held:
                    parts[number].append((at, held))
                    at += held * records.dtype.itemsize
            dtype = records.dtype
        x, y, z = corner
        for number, child_parts in enumerate(parts):
            if child_parts:
                held = sum(n for _, n in child_parts)
                below = (
                    level + 1,
                    2 * x + (number >> 2 & 1),
                    2 * y + (number >> 1 & 1),
                    2 * z + (number & 1),
                )
                yield from octree_batches(
                    _read(spool, child_parts, dtype), held, most, places, folder, below
                )


def _read(
    spool: BinaryIO, parts: Iterable[tuple[int, int]], dtype: np.dtype[np.void]
) -> Iterator[Records]:
    for at, count in parts:
        spool.seek(at)
        raw = spool.read(count * dtype.itemsize)
        if len(raw) < count * dtype.itemsize:
            raise OSError("a temporary file is incomplete")
        yield np.frombuffer(raw, dtype=dtype)


class Levels:
    """Choice of a level for each point, brick by brick. The object records taken cells of a brick's size or more."""

    def __init__(self) -> None:
        self._taken: set[Key] = set()

    def of_brick(self, key: Key, places: Places) -> Int8:
        """Return the level of the node to which each point of a brick belongs, int8, shape (n,)."""
        code = curve(places, key[0])
        order = np.argsort(code, kind="stable")
        levels = np.empty(order.size, dtype=np.int8)
        levels[order] = self._of_sorted(key, code[order])
        return levels

    def _of_sorted(self, key: Key, code: Int64) -> Int8:
        """Return the levels of points that are sorted along the curve. The points of each cell are adjacent there."""
        deepest = min(key[0] + _BITS - CELLS_OF_NODE, DEEPEST)
        levels = np.full(code.size, deepest, dtype=np.int8)
        rest = np.arange(code.size)
        for level in range(deepest):
            below = level - key[0]
            if below >= 0:
                rest = _settle(levels, rest, code, below, level, LEAF_POINTS)
            if not rest.size:
                break
            starts, counts = runs(_cut(code[rest], max(below + CELLS_OF_NODE, 0)))
            # The middle point along the curve is seldom the lowest or highest of its cell.
            picked = starts + counts // 2
            if below + CELLS_OF_NODE <= 0 and not self._take(key, level):
                continue
            levels[rest[picked]] = level
            rest = np.delete(rest, picked)
            if below >= -1:
                rest = _settle(levels, rest, code, below + 1, level, MIN_POINTS - 1)
        return levels

    def _take(self, key: Key, level: int) -> bool:
        """Mark the cell of ``level`` around a brick as taken. Return False if it was taken already."""
        up = key[0] - level - CELLS_OF_NODE
        cell = (level, key[1] >> up, key[2] >> up, key[3] >> up)
        free = cell not in self._taken
        self._taken.add(cell)
        return free


def _settle(
    found: Int8,
    rest: Int64,
    code: Int64,
    below: int,
    level: int,
    most: int,
) -> Int64:
    """Give ``level`` to all points of small cubes, and return the indices of the other points.

    The cubes are ``below`` levels below the brick. A small cube has at most ``most`` points.
    """
    if not rest.size:
        return rest
    _, counts = runs(_cut(code[rest], below))
    few = np.repeat(counts <= most, counts)
    found[rest[few]] = level
    return rest[~few]


def curve(places: Places, level: int) -> Int64:
    """Return the index of each position on the Z-order curve of its brick, which has the level ``level``."""
    numbers = np.zeros(places.shape[1], dtype=np.int64)
    for axis in _AXES:
        v = (places[axis].astype(np.int64) << level >> DEPTH - _BITS) & (1 << _BITS) - 1
        for step, mask in _SPREADING:
            v = (v | v << step) & mask
        numbers |= v << (2 - axis)
    return numbers


def _cut(code: Int64, levels: int) -> Int64:
    """Return the number of the cube of each point, ``levels`` below the brick."""
    return code >> 3 * (_BITS - levels)


def runs(numbers: Int64) -> tuple[Int64, Int64]:
    """Return first index and length of each run of equal numbers. There must be at least one number."""
    starts = np.flatnonzero(np.concatenate(([True], numbers[1:] != numbers[:-1])))
    return starts, np.diff(np.append(starts, numbers.size))
