"""Stray points: a few points far from all others, or outside the bounds in the header of their file.

A stray is not filtered and does not extend rasters. It keeps its class in the classified cloud.
All files are judged together and as a whole, so distances do not depend on tiles or on how a
cloud is cut into files. Larger groups of points are not strays, however far away they lie, unless
every file has only a few points of the group in each bucket.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from ptd.arrays import Bool
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell, Lattice
from tiler.core.points import PointBlock, unpack_origin
from tiler.inputs.extent import FAR, can_be_strays


@dataclass(frozen=True)
class Strays:
    """Stray points of a source.

    Attributes
    ----------
    alone : frozenset of Cell
        Buckets in which every point is a stray.
    extent : Bounds or None
        Bounds outside which every point of the source is a stray.
    """

    alone: frozenset[Cell] = frozenset()
    extent: Bounds | None = None

    def rule(self, lattice: Lattice, cell: Cell) -> Bounds | None:
        """Return the bounds outside which the source's points in a bucket are strays.

        None if the bucket cannot have strays.
        """
        if cell in self.alone:
            return Bounds(0, 0, 0, 0)
        if self.extent is None:
            return None
        bounds = lattice.bounds(cell)
        return None if bounds.union(self.extent) == self.extent else self.extent


def far_buckets(buckets: Mapping[Cell, int], lattice: Lattice) -> frozenset[Cell]:
    """Return the buckets in which every point is a stray, as only a few points lie there and all others are far away.

    Parameters
    ----------
    buckets : mapping of Cell to int
        Number of points in each bucket of all files.
    lattice : Lattice
        Lattice of the buckets.
    """
    total = sum(buckets.values())
    far: set[Cell] = set()
    parts = _parts(buckets, lattice)
    largest = max(parts, key=lambda part: sum(buckets[c] for c in part), default=[])
    for part in parts:
        if part is not largest and can_be_strays(sum(buckets[c] for c in part), total):
            far.update(part)
    return frozenset(far)


def _parts(buckets: Mapping[Cell, int], lattice: Lattice) -> list[list[Cell]]:
    """Group buckets into parts that are separated by empty cells of the size `FAR`.

    If points are so sparse that a bucket is wider than `FAR`, the cells are as wide as a
    bucket.
    """
    far = Lattice(max(Fraction(int(FAR * COUNTS_PER_UNIT)), lattice.size))
    wide: dict[tuple[int, int], list[Cell]] = {}
    for cell in sorted(buckets):
        bounds = lattice.bounds(cell)
        wide.setdefault((far.index_of(bounds.x0), far.index_of(bounds.y0)), []).append(cell)
    parts: list[list[Cell]] = []
    left = set(wide)
    for seed in wide:
        if seed not in left:
            continue
        left.discard(seed)
        reached = [seed]
        part = []
        while reached:
            x, y = reached.pop()
            part += wide[x, y]
            near = set(product((x - 1, x, x + 1), (y - 1, y, y + 1))) & left
            left -= near
            reached += near
        parts.append(part)
    return parts


def stray_mask(block: PointBlock, rules: Mapping[int, Bounds], origin: tuple[int, int]) -> Bool:
    """Return a mask of the strays in a bucket.

    ``rules`` contains the bounds of each source with strays (see `Strays.rule`).
    """
    mask = np.zeros(len(block), dtype=np.bool_)
    if not rules or block.origin is None:
        return mask
    sources = unpack_origin(block.origin)[0]
    for source, bounds in rules.items():
        mask |= (sources == source) & ~block.inside(bounds, origin)
    return mask


def places(block: PointBlock, strays: Bool, origin: tuple[int, int]) -> list[list[Any]]:
    """Return source, row, x, y, z of each stray, with coordinates in units of the CRS."""
    if block.origin is None or not strays.any():
        return []
    sources, rows = unpack_origin(block.origin[strays])
    x, y, z = block.xyz[:, strays].astype(np.int64) + np.array([[origin[0]], [origin[1]], [0]])
    columns = (sources, rows, x / COUNTS_PER_UNIT, y / COUNTS_PER_UNIT, z / COUNTS_PER_UNIT)
    return [list(line) for line in zip(*(c.tolist() for c in columns), strict=True)]
