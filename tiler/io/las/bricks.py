"""Spreads points over the nodes of an octree: upper levels hold few and evenly spread points, leaves the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from tempfile import TemporaryFile
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

from tiler.io.las.reader import Records

Key = tuple[int, int, int, int]
"""Of a node: its level, 0 for the root, and its place along x, y and z."""
Places = npt.NDArray[np.int32]
"""Of points within the cube of the octree, shape (3, n), from 0 to 2**DEPTH - 1."""

DEPTH = 28
CELLS_OF_NODE = 7
"""A node has 2**7 cells along each axis; where it has nodes below, one point of each cell is its own."""
DEEPEST = DEPTH - CELLS_OF_NODE
"""Level of nodes that are not divided, however many points they have: as many at one place."""
LEAF_POINTS = 32_768
"""Most points of a node that has none below; others may have more, one of each cell."""
FEWEST_POINTS = 256
"""Of a node below another one: fewer stay with those above."""

_BITS = 21
"""Of a place within a brick, along each axis: three of them fit into 64 bits."""
_AXES = (0, 1, 2)


def bricks(
    pieces: Iterable[Records],
    count: int,
    most: int,
    places: Callable[[Records], Places],
    folder: str,
    key: Key = (0, 0, 0, 0),
) -> Iterator[tuple[Key, Records]]:
    """The points of a cloud in cubes of the octree that hold ``most`` points, each cube before its next neighbours.

    Parameters
    ----------
    pieces : iterable of Records
        Of ``most`` records at most.
    count : int
        Of all of them.
    most : int
    places : callable
        Gives the places of records.
    folder : str
        For temporary files, which have no name.
    key : Key
        Of the node whose points these are.

    Yields
    ------
    key : Key
        A parent's bricks follow one another.
    records : Records
        In an order that depends on nothing but the order of the pieces.
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
        for number, wanted in enumerate(parts):
            if wanted:
                x, y, z = (2 * c + (number >> bit & 1) for c, bit in zip(corner, (2, 1, 0), strict=True))
                held = sum(n for _, n in wanted)
                below = (level + 1, x, y, z)
                yield from bricks(_read(spool, wanted, dtype), held, most, places, folder, below)


def _read(spool: BinaryIO, parts: Iterable[tuple[int, int]], dtype: np.dtype[np.void]) -> Iterator[Records]:
    for at, count in parts:
        spool.seek(at)
        raw = spool.read(count * dtype.itemsize)
        if len(raw) < count * dtype.itemsize:
            raise OSError("a temporary file lost its end")
        yield np.frombuffer(raw, dtype=dtype)


class Levels:
    """Chooses the level of each point, brick by brick; a cell larger than a brick is known by those before."""

    def __init__(self) -> None:
        self._taken: set[Key] = set()

    def of_brick(self, key: Key, places: Places) -> npt.NDArray[np.int8]:
        """The level of each point of a brick, int8 of shape (n,): of its own node, or of one above or below."""
        code = curve(places, key[0])
        order = np.argsort(code, kind="stable")
        found = np.empty(order.size, dtype=np.int8)
        found[order] = self._of_sorted(key, code[order])
        return found

    def _of_sorted(self, key: Key, code: npt.NDArray[np.int64]) -> npt.NDArray[np.int8]:
        """Levels of points along the curve that goes through cube after cube: any cell of any level is a run."""
        deepest = min(key[0] + _BITS - CELLS_OF_NODE, DEEPEST)
        found = np.full(code.size, deepest, dtype=np.int8)
        rest = np.arange(code.size)
        for level in range(deepest):
            below = level - key[0]
            if below >= 0:
                rest = _settle(found, rest, code, below, level, LEAF_POINTS)
            if not rest.size:
                break
            starts, counts = runs(_cut(code[rest], max(below + CELLS_OF_NODE, 0)))
            picked = starts + counts // 2  # neither always the lowest of its cell nor the highest
            if below + CELLS_OF_NODE <= 0 and not self._take(key, level):
                continue
            found[rest[picked]] = level
            rest = np.delete(rest, picked)
            if below >= -1:
                rest = _settle(found, rest, code, below + 1, level, FEWEST_POINTS - 1)
        return found

    def _take(self, key: Key, level: int) -> bool:
        """Whether a cell that holds the whole brick, and others, has no point yet; from now on it has."""
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
    """Give a level to the points of cubes that hold ``most``, ``below`` levels below the brick; those left over."""
    if not rest.size:
        return rest
    _, counts = runs(_cut(code[rest], below))
    few = np.repeat(counts <= most, counts)
    found[rest[few]] = level
    return rest[~few]


def curve(places: Places, level: int) -> npt.NDArray[np.int64]:
    """Number of the place along a Z-order curve within a brick of a level."""
    found = np.zeros(places.shape[1], dtype=np.int64)
    for axis in _AXES:
        v = (places[axis].astype(np.int64) << level >> DEPTH - _BITS) & (1 << _BITS) - 1
        for step, mask in (
            (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):  # fmt: skip
            v = (v | v << step) & mask
        found |= v << (2 - axis)
    return found


def _cut(code: npt.NDArray[np.int64], levels: int) -> npt.NDArray[np.int64]:
    """Number of the cube ``levels`` below the brick."""
    return code >> 3 * (_BITS - levels)


def runs(numbers: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """First index and length of each run of equal numbers; at least one."""
    starts = np.flatnonzero(np.concatenate(([True], numbers[1:] != numbers[:-1])))
    return starts, np.diff(np.append(starts, numbers.size))
