"""Division of points among octree nodes: upper levels get few, evenly distributed points, leaves get the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from tempfile import TemporaryFile
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from tiler.io.las.reader import Records

Key = tuple[int, int, int, int]
"""Key of a node: its level, 0 for the root, and its position along x, y and z."""
Places = npt.NDArray[np.int32]
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

    def of_brick(self, key: Key, places: Places) -> npt.NDArray[np.int8]:
        """Return the level of the node to which each point of a brick belongs, int8, shape (n,)."""
        code = curve(places, key[0])
        order = np.argsort(code, kind="stable")
        levels = np.empty(order.size, dtype=np.int8)
        levels[order] = self._of_sorted(key, code[order])
        return levels

    def _of_sorted(self, key: Key, code: npt.NDArray[np.int64]) -> npt.NDArray[np.int8]:
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
    found: npt.NDArray[np.int8],
    rest: npt.NDArray[np.int64],
    code: npt.NDArray[np.int64],
    below: int,
    level: int,
    most: int,
) -> npt.NDArray[np.int64]:
    """Give ``level`` to all points of small cubes, and return the indices of the other points.

    The cubes are ``below`` levels below the brick. A small cube has at most ``most`` points.
    """
    if not rest.size:
        return rest
    _, counts = runs(_cut(code[rest], below))
    few = np.repeat(counts <= most, counts)
    found[rest[few]] = level
    return rest[~few]


def curve(places: Places, level: int) -> npt.NDArray[np.int64]:
    """Return the index of each position on the Z-order curve of its brick, which has the level ``level``."""
    numbers = np.zeros(places.shape[1], dtype=np.int64)
    for axis in _AXES:
        v = (places[axis].astype(np.int64) << level >> DEPTH - _BITS) & (1 << _BITS) - 1
        for step, mask in _SPREADING:
            v = (v | v << step) & mask
        numbers |= v << (2 - axis)
    return numbers


def _cut(code: npt.NDArray[np.int64], levels: int) -> npt.NDArray[np.int64]:
    """Return the number of the cube of each point, ``levels`` below the brick."""
    return code >> 3 * (_BITS - levels)


def runs(numbers: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return first index and length of each run of equal numbers. There must be at least one number."""
    starts = np.flatnonzero(np.concatenate(([True], numbers[1:] != numbers[:-1])))
    return starts, np.diff(np.append(starts, numbers.size))
