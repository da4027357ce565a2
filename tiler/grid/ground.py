"""Ground points of a window, from the merged labels of all buckets that it touches, and those chosen for the TIN.

If points are dense or noisy, one per cell is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ptd.arrays import Bool, Indices, Int32, Int64, UInt8
from ptd.gridding.above_ground import near_objects
from tiler.core.edits import OF_POINTS, TO_GROUND, EditedPoints, ground_with
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import NOISE, UNCERTIFIED_BIT, WITHHELD_FLAG, PointBlock
from tiler.errors import StoreError
from tiler.grid.records import GridBlock, GroundSelection
from tiler.store import TileStore

_NOISE_CLASSES = np.isin(np.arange(256), NOISE)
"""Table of the classes of the input that are noise."""
_NOISE_LABELS = np.isin(np.arange(256) & ~UNCERTIFIED_BIT, NOISE)
"""Table of the labels of the filter that are noise."""

Choose = Callable[[Int32], Indices]
"""Function from points, int32 (3, n), to indices of the chosen points."""


@dataclass(frozen=True)
class Ground:
    """Ground points of a window.

    Attributes
    ----------
    xyz : int32 (3, n)
        Local counts of the points.
    read : int
        Number of ground points in the window, of which only some may be chosen.
    marked : int
        Number of uncertified ground points (`UNCERTIFIED_BIT`).
    """

    xyz: Int32
    read: int
    marked: int


@dataclass(frozen=True)
class Classed:
    """Points of a bucket, with masks of those in some bounds that no flag excludes.

    Attributes
    ----------
    cell : Cell
    xyz : int32 (3, n)
        Local counts.
    classes : uint8 (n,)
        Labels of the filter, or classes of the input if there are none.
    is_ground : bool (n,)
        Mask of the ground points.
    is_object : bool (n,)
        Mask of the points that are neither ground nor noise, if it was asked for.
    """

    cell: Cell
    xyz: Int32
    classes: UInt8
    is_ground: Bool
    is_object: Bool


def classed(
    store: TileStore, rule: GroundSelection, bounds: Bounds, objects: bool = False
) -> Iterator[Classed]:
    """Yield the points of each bucket that overlaps ``bounds`` (absolute counts), in the lattice's order.

    Parameters
    ----------
    store : TileStore
    rule : GroundSelection
    bounds : Bounds
    objects : bool
        Whether masks of the objects are needed.
    """
    edges = _objects_at_edges(store, rule, bounds) if rule.erode else {}
    needs_objects = objects or bool(rule.erode)
    for cell in store.buckets_within(bounds):
        block, classes, is_ground = read_classes(store, rule, cell, needs_objects)
        inside = block.inside(bounds, store.meta.frame.origin)
        found = is_ground & _used(block, rule, store, cell) & inside
        is_object = np.zeros(len(block), np.bool_)
        if needs_objects:
            is_object = _is_object(block, classes, is_ground, rule, store, cell)
        if rule.erode:
            own, index = block.xyz[:, is_object], np.flatnonzero(found)
            beside = _beside_objects(store, rule, cell, block.xyz[:, index], own, edges)
            found[index[beside]] = False
        yield Classed(cell, block.xyz, classes, found, is_object & inside)


def read_ground(
    store: TileStore,
    rule: GroundSelection,
    bounds: Bounds,
    choose: Callable[[Cell, Int32], Indices] | None = None,
) -> Ground:
    """Read the ground points in ``bounds`` (absolute counts), bucket by bucket in the lattice's order.

    Parameters
    ----------
    store : TileStore
    rule : GroundSelection
    bounds : Bounds
    choose : callable, optional
        Function from a bucket and its ground points to indices of those to keep, so that the others need no memory.
    """
    parts, read, marked = [np.empty((3, 0), np.int32)], 0, 0
    for part in classed(store, rule, bounds):
        points = part.xyz.compress(part.is_ground, axis=1)
        read += points.shape[1]
        parts.append(points if choose is None else points[:, choose(part.cell, points)])
        if rule.labels is not None:
            is_marked = part.is_ground & (part.classes >= UNCERTIFIED_BIT)
            marked += int(np.count_nonzero(is_marked))
    return Ground(np.concatenate(parts, axis=1), read, marked)


def read_ground_and_objects(
    store: TileStore, rule: GroundSelection, bounds: Bounds
) -> tuple[Int32, Int32]:
    """Return the ground points in ``bounds``, and those that are neither ground nor noise, int32 (3, n)."""
    ground, others = [np.empty((3, 0), np.int32)], [np.empty((3, 0), np.int32)]
    for part in classed(store, rule, bounds, objects=True):
        ground.append(part.xyz.compress(part.is_ground, axis=1))
        others.append(part.xyz.compress(part.is_object, axis=1))
    return np.concatenate(ground, axis=1), np.concatenate(others, axis=1)


def read_classes(
    store: TileStore, rule: GroundSelection, cell: Cell, needs_input: bool = False
) -> tuple[PointBlock, UInt8, Bool]:
    """Read the points of a bucket with their flags. Return them with their classes and a mask of the ground points.

    The points include the classes of the input if ``needs_input`` is set, or if the ground
    depends on them.
    """
    edits = None
    if rule.edits is not None:
        edits = store.edits(rule.edits, store.meta.bucket.bounds(cell), OF_POINTS)
    needs_input |= rule.labels is None or edits is not None
    block = store.read_bucket(
        cell, ("xyz", "flags", *(("classification",) if needs_input else ()))
    )
    column = (
        block.classification if rule.labels is None else store.read_labels(rule.labels, cell)
    )
    classes = _required(column, store, cell)
    is_ground = rule.is_ground()[classes]
    if edits is not None:
        forced = edits.forced(block, classes, store.meta.frame.origin)
        is_ground = ground_with(is_ground, forced)
    return block, classes, is_ground


def _objects_at_edges(
    store: TileStore, rule: GroundSelection, bounds: Bounds
) -> dict[Cell, Int32]:
    """Return points of objects, by bucket, that are near enough to its edge to erode ground beyond it."""
    radius, origin = math.ceil(rule.erode), store.meta.frame.origin
    objects_by_cell = {}
    for cell in store.buckets_within(bounds.pad(radius)):
        block, classes, is_ground = read_classes(store, rule, cell, needs_input=True)
        edge = ~block.inside(store.meta.bucket.bounds(cell).pad(-radius), origin)
        objects_by_cell[cell] = block.xyz[
            :, edge & _is_object(block, classes, is_ground, rule, store, cell)
        ]
    return objects_by_cell


def _beside_objects(
    store: TileStore,
    rule: GroundSelection,
    cell: Cell,
    ground: Int32,
    own: Int32,
    edges: Mapping[Cell, Int32],
) -> Bool:
    """Return a mask of the ground points near objects of the bucket (``own``) or of a neighbour."""
    around = store.meta.bucket.bounds(cell).pad(math.ceil(rule.erode))
    neighbour_objects = [
        edges[other] for other in store.meta.bucket.among(around, edges) if other != cell
    ]
    objects = np.concatenate([own, *neighbour_objects], axis=1)
    return near_objects(ground, objects, rule.erode, rule.erode_rise, store.meta.frame.origin)


def _is_object(
    block: PointBlock,
    classes: UInt8,
    is_ground: Bool,
    rule: GroundSelection,
    store: TileStore,
    cell: Cell,
) -> Bool:
    """Return a mask of the points that are neither ground nor noise, from results of `read_classes`."""
    labels = None if rule.labels is None else classes
    return ~is_ground & _used(block, rule, store, cell) & ~_is_noise(block, labels, store, cell)


def _is_noise(block: PointBlock, labels: UInt8 | None, store: TileStore, cell: Cell) -> Bool:
    """Return a mask of the points that are noise by the input, or by the filter if there are labels."""
    noise: Bool = _NOISE_CLASSES[_required(block.classification, store, cell)]
    return noise if labels is None else noise | _NOISE_LABELS[labels]


def count_edited_points(
    store: TileStore, *, rule: GroundSelection, edits_key: str, cell: Cell
) -> dict[str, Any]:
    """Count the points of a bucket inside each edit.

    Each edit is counted as if there were no other edits.

    Returns
    -------
    dict
        ``edits``: for each edit that touches the bucket, its number, and five counts of points inside it. These are
        all points, ground before the edit, ground after it by the input's classes and by the lowest points, and points
        that the edit makes ground by the input's classes. The last three are 0 unless the edit adds ground.
    """
    edits = store.edits(edits_key, store.meta.bucket.bounds(cell), OF_POINTS)
    if edits is None:
        return {"edits": []}
    block, classes, is_ground = read_classes(store, rule, cell, needs_input=True)
    points = EditedPoints(block, classes, store.meta.frame.origin)
    counts = []
    for edit in edits.edits:
        rows = points.inside(edit.area)
        ground_before, after, given = int(is_ground[rows].sum()), [0, 0], 0
        if edit.action == TO_GROUND:
            becoming = [points.to_ground(rows, pixel) for pixel in (None, edits.cell)]
            after = [
                ground_before + int(np.count_nonzero(~is_ground[more])) for more in becoming
            ]
            given = len(becoming[0])
        counts.append([edit.number, len(rows), ground_before, *after, given])
    return {"edits": counts}


def surface_points(
    store: TileStore, rule: GroundSelection, cell: Cell
) -> tuple[PointBlock, Bool]:
    """Read all points of a bucket. Return them with a mask of the surface points.

    Surface points are not withheld or skipped, and are not noise by the input or by the filter.
    """
    block = store.read_bucket(cell, ("xyz", "flags", "classification"))
    labels = None if rule.labels is None else store.read_labels(rule.labels, cell)
    chosen = _used(block, rule, store, cell) & ~_is_noise(block, labels, store, cell)
    return block, chosen


def _used(block: PointBlock, rule: GroundSelection, store: TileStore, cell: Cell) -> Bool:
    """Return a mask of the points that are not excluded by a flag."""
    flags = _required(block.flags, store, cell)
    mask: Bool = (flags & (rule.skip_flags | WITHHELD_FLAG)) == 0
    return mask


def _required(column: UInt8 | None, store: TileStore, cell: Cell) -> UInt8:
    if column is None:
        raise StoreError(
            f"{store.url}: bucket {cell.name} lacks its classes or flags; start anew with --overwrite"
        )
    return column


def max_points_in_bucket(points: int, buckets: Lattice, thin: Lattice | None) -> int:
    """Return the largest number of points of a bucket that may be in the TIN: one per cell of ``thin``."""
    return points if thin is None else min(points, math.ceil(buckets.size / thin.size + 1) ** 2)


def surface_ground(store: TileStore, work: GridBlock, window: Bounds) -> tuple[Ground, Int32]:
    """Read the ground points of a window. Return them, and the coordinates of the points for the TIN."""
    if work.thin is None:
        ground = read_ground(store, work.rule, window)
        return ground, ground.xyz
    # Cells that the window cuts are read whole, so that the same point is chosen in them for
    # all windows.
    origin = store.meta.frame.origin
    choose: Choose = partial(central_points, origin=origin, lattice=work.thin)
    if work.percent is not None:
        choose = partial(ranked_points, origin=origin, lattice=work.thin, percent=work.percent)
    by_bucket = partial(_whole_cells, choose, work.thin, store.meta.bucket, origin)
    ground = read_ground(store, work.rule, work.thin.around(window), by_bucket)
    xyz = ground.xyz[:, choose(ground.xyz)]
    return ground, xyz[:, PointBlock(xyz).inside(window, origin)]


def _whole_cells(
    choose: Choose,
    thin: Lattice,
    buckets: Lattice,
    origin: tuple[int, int],
    cell: Cell,
    xyz: Int32,
) -> Indices:
    """Return the points that may be in the TIN: one per cell that is wholly in the bucket, and all of other cells."""
    whole = PointBlock(xyz).inside(thin.within(buckets.bounds(cell)), origin)
    inner = np.flatnonzero(whole)
    return np.append(inner[choose(xyz[:, inner])], np.flatnonzero(~whole))


def central_points(xyz: Int32, origin: tuple[int, int], lattice: Lattice) -> Indices:
    """Return the indices of the points nearest to the centre of each cell, ties in the order of (x, y, z).

    The nearest point does not lower the surface on average, as the lowest point would.

    Parameters
    ----------
    xyz : int32, shape (3, n)
        Local counts of points of whole cells, as the choice needs all points of a cell.
    origin : tuple of int
        Absolute counts of the local 0.
    lattice : Lattice
        Cells of at most 2**20 counts with a denominator of at most 2**9, so that squares fit int64.
    """
    x, y, ix, iy = _in_cells(xyz, origin, lattice)
    # Twice the offset from the centre, in 1 / q counts: an integer.
    dx = 2 * lattice.q * x - (2 * ix + 1) * lattice.p
    dy = 2 * lattice.q * y - (2 * iy + 1) * lattice.p
    order = np.lexsort((xyz[2], y, x, dx * dx + dy * dy, ix, iy))
    return order[_starts(ix[order], iy[order])]


def ranked_points(
    xyz: Int32, origin: tuple[int, int], lattice: Lattice, percent: int
) -> Indices:
    """Return the indices of the points at a percentile of the heights of each cell.

    Percentile 50 is the (lower) median, 0 the lowest point. A measured point, unlike a mean,
    lies on the surface wherever it is in its cell. Ties are in the order of (z, x, y).

    Parameters
    ----------
    xyz, origin, lattice
        Parameters of `central_points`, with cells of any size.
    percent : int
        Percentile. Of n sorted points, the one with index ``(n - 1) * percent // 100`` is chosen.
    """
    x, y, ix, iy = _in_cells(xyz, origin, lattice)
    order = _sorted_in_cells(x, y, xyz[2].astype(np.int64), ix, iy)
    starts = _starts(ix[order], iy[order])
    counts = np.diff(starts, append=len(order))
    chosen: Indices = order[starts + (counts - 1) * percent // 100]
    return chosen


def _sorted_in_cells(x: Int64, y: Int64, z: Int64, ix: Int64, iy: Int64) -> Indices:
    """Return the indices of points in the order of (iy, ix, z, x, y)."""
    if len(x) == 0:
        return np.zeros(0, np.int64)
    col, row, low = int(ix.min()), int(iy.min()), int(z.min())
    columns, heights = int(ix.max()) - col + 1, int(z.max()) - low + 1
    if (int(iy.max()) - row + 1) * columns * heights >= 1 << 63:
        return np.lexsort((y, x, z, ix, iy))
    # One sort by one number is several times as fast as five. Points with equal numbers are
    # sorted once more.
    keys = ((iy - row) * columns + (ix - col)) * heights + (z - low)
    order: Indices = np.argsort(keys)
    alike = np.diff(keys[order]) == 0
    tied = np.flatnonzero(np.append(alike, False) | np.append(False, alike))
    ties = order[tied]
    order[tied] = ties[np.lexsort((y[ties], x[ties], keys[ties]))]
    return order


def _in_cells(
    xyz: Int32, origin: tuple[int, int], lattice: Lattice
) -> tuple[Int64, Int64, Int64, Int64]:
    """Return the absolute x and y of points, and the column and row of their cells."""
    x, y = (xyz[axis].astype(np.int64) + origin[axis] for axis in (0, 1))
    return x, y, lattice.index(x), lattice.index(y)


def _starts(ix: Int64, iy: Int64) -> Indices:
    """Return the first index of each cell in points that are sorted by cells."""
    differs = (np.diff(ix) != 0) | (np.diff(iy) != 0)
    return np.flatnonzero(np.append(True, differs)[: len(ix)])
