"""Points as columns of equal length, their ASPRS classes and flags, and points at the same position.

Classes and flags decide which points take part in a filter, and which classes it may write.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ptd.arrays import AnyArray, Bool, Indices, Int32, Int64, UInt8, UInt16
from tiler.core.lattice import Bounds, CoordFrame, Lattice
from tiler.core.selection import ONLY_GROUND

UNCLASSIFIED = 1
GROUND = 2
LOW_NOISE = 7
WATER = 9
BRIDGE = 17
HIGH_NOISE = 18

NOISE = (LOW_NOISE, HIGH_NOISE)

# The bits of `PointBlock.flags` are the same for every point format. The first four flags come
# from the source.
WITHHELD_FLAG = 1
SYNTHETIC_FLAG = 2
OVERLAP_FLAG = 4
KEY_POINT_FLAG = 8
STRAY_FLAG = 16
"""Flag that ingest (`tiler.ingest.strays`) sets on stray points."""
UNSELECTED_FLAG = 32
"""Flag that ingest sets on points that the settings of the run do not select
(`tiler.core.selection`)."""
REPEATED_FLAG = 64
"""Flag that ingest (`tiler.ingest.assemble`) sets on points at the position of another point,
which represents them. A run sees only that point, and they get its label."""

UNSEEN_FLAGS = WITHHELD_FLAG | STRAY_FLAG | UNSELECTED_FLAG | REPEATED_FLAG
"""Flags of points that a run ignores, independent of its other settings."""

LABELS = "labels"
"""Name in the store of the labels that a run ends with."""
UNCERTIFIED_BIT = 0x80
"""Bit of a label that data outside the filter's window could change."""
WATER_BIT = 0x40
"""Bit of the label of a point in a body of water."""

WITHOUT_OBJECT = (0, UNCLASSIFIED, GROUND)
"""Classes of a producer that do not name a kind of object. Class 0 is "never classified"."""

Counts = Mapping[str, int]
"""Number of points by class, which is a string as in JSON."""


def participates(
    classification: UInt8,
    flags: UInt8,
    keep_classes: Sequence[int] = (LOW_NOISE, WATER, BRIDGE, HIGH_NOISE),
    skip_flags: int = WITHHELD_FLAG,
) -> Bool:
    """Return the mask of the points that take part in filtering.

    Parameters
    ----------
    classification, flags : uint8, shape (n,)
    keep_classes : sequence of int
        Classes that never take part and are never overwritten.
    skip_flags : int
        Bits of ``flags`` that exclude a point. Withheld points are always excluded.
    """
    kept = np.zeros(256, dtype=np.bool_)
    kept[list(keep_classes)] = True
    taking: Bool = ~kept[classification] & ((flags & (skip_flags | WITHHELD_FLAG)) == 0)
    return taking


@cache
def written_classes(reclass: str) -> UInt8:
    """Return the table of the classes in a classified cloud.

    Parameters
    ----------
    reclass : str
        With `tiler.core.selection.ALL`, a point gets the class of its label. With `ONLY_GROUND`, ground in water
        becomes `WATER`, and a point with the label `UNCLASSIFIED` keeps the class of its producer. If that class is in
        `WITHOUT_OBJECT`, the point becomes `UNCLASSIFIED`, or `WATER` in water.

    Returns
    -------
    uint8, shape (256, 256)
        New class by label (first axis) and class of the producer (second axis). Labels are without `UNCERTIFIED_BIT`,
        but with `WATER_BIT` in water. The label 0 keeps the class.
    """
    given = np.arange(256, dtype=np.uint8)
    plain = np.isin(given, WITHOUT_OBJECT)
    table = np.tile(given, (256, 1))
    for label in (UNCLASSIFIED, GROUND, LOW_NOISE, BRIDGE):
        table[[label, label | WATER_BIT]] = label
    if reclass == ONLY_GROUND:
        table[UNCLASSIFIED] = np.where(plain, UNCLASSIFIED, given)
        table[UNCLASSIFIED | WATER_BIT] = np.where(plain, WATER, given)
        table[GROUND | WATER_BIT] = WATER
    table.flags.writeable = False
    return table


def sum_by_class(counts: Iterable[Counts]) -> dict[str, int]:
    """Return the sum of counts by class, in the order of the classes."""
    total: Counter[str] = Counter()
    for class_counts in counts:
        total.update(class_counts)
    return {code: total[code] for code in sorted(total, key=int)}


Index: TypeAlias = "Indices | Bool | slice"


@dataclass(frozen=True)
class PointBlock:
    """Columns of ``n`` points. A column is None if it was not read or the sources do not have it.

    Attributes
    ----------
    xyz : int32, shape (3, n)
        Local counts of the run's `CoordFrame`: x east, y north, z up.
    classification : uint8, shape (n,)
        ASPRS class in the source.
    flags : uint8, shape (n,)
        Bits with names that end in ``_FLAG``: withheld, synthetic, overlap, key point, stray, unselected, repeated.
    returns : uint8, shape (2, n)
        Return number and number of returns.
    rgb : uint16, shape (3, n)
        Red, green and blue in the source.
    origin : int64, shape (n,)
        Position of the point in the sources, ``source id << 40 | source row``. With it, a classified file has its
        points in the order of its input.
    labels : uint8, shape (n,)
        Labels of a pass of the filter.
    """

    xyz: Int32
    classification: UInt8 | None = None
    flags: UInt8 | None = None
    returns: UInt8 | None = None
    rgb: UInt16 | None = None
    origin: Int64 | None = None
    labels: UInt8 | None = None

    def __len__(self) -> int:
        return int(self.xyz.shape[1])

    def take(self, index: Index) -> PointBlock:
        """Return the points of ``index`` (indices, a mask or a slice), in that order."""
        if not isinstance(index, slice) and index.dtype == np.bool_ and index.all():
            return self
        taken: dict[str, AnyArray] = {}
        for field in fields(PointBlock):
            column = getattr(self, field.name)
            if column is not None:
                taken[field.name] = _take(column, index)
        return PointBlock(**taken)

    def inside(self, bounds: Bounds, origin: tuple[int, int]) -> Bool:
        """Return the mask of the points in ``bounds`` (absolute counts), given the frame's origin."""
        x, y, _ = self.xyz
        ox, oy = origin
        mask: Bool = x >= bounds.x0 - ox
        mask &= x < bounds.x1 - ox
        mask &= y >= bounds.y0 - oy
        mask &= y < bounds.y1 - oy
        return mask

    @staticmethod
    def concatenate(blocks: Sequence[PointBlock]) -> PointBlock:
        """Return all points of ``blocks`` (at least one) in order. A column that is None in one block is None."""
        joined: dict[str, AnyArray] = {}
        for field in fields(PointBlock):
            columns = [getattr(block, field.name) for block in blocks]
            if all(column is not None for column in columns):
                joined[field.name] = np.concatenate(columns, axis=-1)
        return PointBlock(**joined)


def _take(column: AnyArray, index: Index) -> AnyArray:
    """Return ``column[..., index]`` three times faster."""
    if isinstance(index, slice):
        return column[..., index]
    if index.dtype == np.bool_:
        return np.compress(index.astype(np.bool_, copy=False), column, axis=-1)
    return np.take(column, index, axis=-1)


SOURCE_SHIFT = 40
"""Bits of the row in an origin: 2**40 rows per source and 2**23 sources fit."""


def pack_origin(source: int, rows: Int64) -> Int64:
    """Return ``source id << 40 | row``, int64."""
    return (np.int64(source) << SOURCE_SHIFT) | rows


def unpack_origin(
    origin: Int64,
) -> tuple[Int64, Int64]:
    """Return source ids and rows, both int64."""
    return origin >> SOURCE_SHIFT, origin & ((1 << SOURCE_SHIFT) - 1)


Rows = Indices


def preference(block: PointBlock, participating: Bool) -> tuple[npt.NDArray[np.generic], ...]:
    """Return sort keys that put the point that represents its position first, major key first.

    A point that takes part in filtering comes first, then one that the run sees, then one whose
    class names something other than noise, in the order of the classes. Other attributes follow.
    So the choice depends on the files, by the last key, only if all attributes are equal.

    Parameters
    ----------
    block : PointBlock
    participating : bool, shape (n,)
        Mask of the points that take part in filtering.
    """
    keys: list[npt.NDArray[np.generic]] = [~participating]
    if block.flags is not None:
        keys.append((block.flags & UNSEEN_FLAGS) > 0)
    if block.classification is not None:
        unnamed = block.classification <= UNCLASSIFIED
        noise = np.isin(block.classification, NOISE)
        keys += [unnamed + 2 * noise.astype(np.uint8), block.classification]
    if block.flags is not None:
        keys.append(block.flags)
    for column in (block.returns, block.rgb, block.origin):
        keys += [] if column is None else list(np.atleast_2d(column))
    return tuple(keys)


def representatives(
    block: PointBlock, n_candidates: int, fine: Lattice, frame: CoordFrame
) -> tuple[Rows, Rows]:
    """Return the rows of the repeated points of a bucket, and the row of the point that represents each.

    Repeated points follow their representative in the order of the store, unless it is a
    candidate. All candidates come first, in the order of their fine cells.

    Parameters
    ----------
    block : PointBlock
        All points of a bucket in stored order, with their flags.
    n_candidates : int
        Number of candidates of the bucket.
    fine : Lattice
        Lattice of the cells with one candidate each.
    frame : CoordFrame
    """
    if block.flags is None:
        raise ValueError("block: flags is None; read the column")
    is_repeated = (block.flags & REPEATED_FLAG) > 0
    repeated = np.flatnonzero(is_repeated)
    if not len(repeated):
        return repeated, repeated
    rows = np.arange(len(block))
    rows[repeated] = 0
    chosen = np.maximum.accumulate(rows)[repeated]
    differs: Bool = (block.xyz[:, repeated] != block.xyz[:, chosen]).any(axis=0)
    if differs.any():
        candidates = np.arange(n_candidates)
        cells = _cell_numbers(
            block.xyz[:, np.concatenate((candidates, repeated[differs]))], fine, frame
        )
        chosen[differs] = np.searchsorted(cells[:n_candidates], cells[n_candidates:])
    return repeated, chosen


def _cell_numbers(xyz: Int32, fine: Lattice, frame: CoordFrame) -> Int64:
    """Return the number of each point's fine cell, counted row by row from the south-west."""
    column = fine.index(xyz[0].astype(np.int64) + frame.origin[0])
    row = fine.index(xyz[1].astype(np.int64) + frame.origin[1])
    column -= column.min()
    numbers: Int64 = (row - row.min()) * (column.max() + 1) + column
    return numbers
