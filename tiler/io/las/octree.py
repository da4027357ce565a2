"""The octree of a COPC file: in which cube the points of each of its chunks lie (COPC 1.0)."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from laspy.copc import CopcInfoVlr, Entry, HierarchyPage

from tiler.io.cloud_reading import open_cloud
from tiler.io.las.headers import LasHeader
from tiler.io.las.laz import LazDamage

_INFO_BYTES, _ENTRY_BYTES = 160, 32
_DEEPEST = 30
_INFO, _HIERARCHY = 1, 1000
_BLOCK_BYTES = 1 << 14
"""Bytes of an object read at once to find the hierarchy; each of its pages is read with one request."""


@dataclass(frozen=True)
class Octree:
    """Where the points of each chunk lie, seen from above.

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

    def box(self, key: tuple[int, int, int]) -> tuple[float, float, float, float]:
        """Lowest x, y, highest x, y of a square."""
        level, column, row = key
        side = self.side / 2**level
        x, y = self.west + column * side, self.south + row * side
        return x, y, x + side, y + side

    def root(self, header: LasHeader, most: int) -> tuple[int, int]:
        """First record and number, ``most`` at most, of those of the uppermost node with points."""
        counts = [] if header.laz is None else header.laz.counts.tolist()
        _, chunk = min((key[0], number) for number, key in enumerate(self.keys) if counts[number])
        return sum(counts[:chunk]), min(counts[chunk], most)

    def near(
        self, header: LasHeader, boxes: Sequence[tuple[float, float, float, float]]
    ) -> list[tuple[int, int]]:
        """First record and number of those of nodes that come within a unit of some boxes; neighbours are one."""
        counts = [] if header.laz is None else header.laz.counts.tolist()
        found: list[tuple[int, int]] = []
        start = 0
        for key, count in zip(self.keys, counts, strict=True):
            west, south, east, north = self.box(key)
            if count and any(
                w <= east + 1 and e >= west - 1 and s <= north + 1 and n >= south - 1 for w, s, e, n in boxes
            ):
                first = found.pop()[0] if found and sum(found[-1]) == start else start
                found.append((first, start + count - first))
            start += count
        return found

    def spread(self, counts: Sequence[int], most_levels: int) -> dict[tuple[int, int, int], float]:
        """Squares of one level that hold points, and about how many; those above that level are shared out.

        Parameters
        ----------
        counts : sequence of int
            Points of each chunk.
        most_levels : int
            Of the squares; fewer where the tree is less deep.
        """
        level = min(max(key[0] for key in self.keys), most_levels)
        found: dict[tuple[int, int, int], float] = defaultdict(float)
        for (deep, column, row), count in zip(self.keys, counts, strict=True):
            if deep >= level and count:
                found[level, column >> deep - level, row >> deep - level] += count
        share = sum(counts) / max(sum(found.values()), 1)
        return {key: held * share for key, held in found.items()}


def read_octree(header: LasHeader) -> Octree:
    """The octree of a COPC file, held against its table of chunks.

    Raises
    ------
    LazDamage
        It is damaged, or does not name each chunk once; or there is none.
    """
    layout = header.laz
    info_record = next((v for v in header.vlrs if v.is_copc and v.record_id == _INFO), None)
    if info_record is None or info_record.length < _INFO_BYTES:
        raise LazDamage("it has no COPC info record")
    if layout is None or layout.rebuilt or not layout.sizes.size:
        raise LazDamage("it has no table of chunks")
    with open_cloud(header.path, _BLOCK_BYTES) as stream:
        stream.seek(info_record.payload)
        info = CopcInfoVlr()
        info.parse_record_data(stream.read(_INFO_BYTES))
        if not (np.isfinite(info.center).all() and math.isfinite(info.halfsize) and info.halfsize > 0):
            raise LazDamage(
                f"its octree has its centre at {info.center.tolist()} and half a side of {info.halfsize}"
            )
    entries = _entries(header.path, info, header.size, int(layout.counts.size))
    starts = header.points_offset + 8 + np.cumsum(layout.sizes) - layout.sizes
    chunk_at = {int(s): i for i, s in enumerate(starts.tolist()) if layout.counts[i]}
    found: dict[int, Entry] = {}
    for entry in entries:
        chunk = chunk_at.get(entry.offset)
        if chunk is None or chunk in found:
            raise LazDamage(f"its octree names byte {entry.offset}, where no chunk begins, or one twice")
        if (entry.point_count, entry.byte_size) != (layout.counts[chunk], layout.sizes[chunk]):
            raise LazDamage(
                f"its octree says {entry.point_count} points in {entry.byte_size} bytes at byte {entry.offset}, "
                f"its table of chunks {layout.counts[chunk]} in {layout.sizes[chunk]}"
            )
        found[chunk] = entry
    if len(found) != len(chunk_at):
        raise LazDamage(f"its octree names {len(found)} of {len(chunk_at)} chunks")
    keys = [(0, 0, 0)] * layout.counts.size  # chunks without points are in no node
    for chunk, entry in found.items():
        keys[chunk] = (entry.key.level, entry.key.x, entry.key.y)
    west, south = (float(c - info.halfsize) for c in info.center[:2])
    return Octree(west, south, 2 * float(info.halfsize), tuple(keys))


def _entries(path: Path, info: CopcInfoVlr, size: int, chunks: int) -> list[Entry]:
    """The nodes of all pages that hold points."""
    found: list[Entry] = []
    pages, seen = [(info.hierarchy_root_offset, info.hierarchy_root_size)], set[int]()
    left = _ENTRY_BYTES * (8 * chunks + 9)  # a node has eight children at most, with points or without
    while pages:
        offset, length = pages.pop()
        left -= length
        if length <= 0 or length % _ENTRY_BYTES or offset + length > size or offset in seen or left < 0:
            raise LazDamage(f"its octree has a page of {length} bytes at byte {offset} of {size}")
        seen.add(offset)
        with open_cloud(path, _BLOCK_BYTES, [(offset, offset + length)]) as stream:
            stream.seek(offset)
            raw = stream.read(length)
        if len(raw) < length:
            raise LazDamage(f"its octree ends at byte {offset + len(raw)}")
        for entry in HierarchyPage.from_bytes(raw).entries.values():
            key = entry.key
            if not (
                0 <= key.level <= _DEEPEST and all(0 <= v < 1 << key.level for v in (key.x, key.y, key.z))
            ):
                raise LazDamage(f"its octree has a node {key.level}-{key.x}-{key.y}-{key.z}")
            if entry.point_count == -1:
                pages.append((entry.offset, entry.byte_size))
            elif entry.point_count > 0:
                found.append(entry)
            elif entry.point_count < -1:
                raise LazDamage(f"its octree has a node of {entry.point_count} points")
    return found
