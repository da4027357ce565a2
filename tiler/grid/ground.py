"""Ground points of a window, from the merged labels of all buckets that it touches."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.gridding.above_ground import near_objects
from tiler.core.classes import GROUND, NOISE, UNCERTIFIED_BIT, WITHHELD_FLAG
from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.edits import OF_POINTS, ground_with
from tiler.core.lattice import Bounds, Cell
from tiler.core.points import PointBlock
from tiler.errors import StoreError
from tiler.store import TileStore


@dataclass(frozen=True)
class GroundSelection:
    """Rule for the points that are ground.

    Attributes
    ----------
    labels : str or None
        Name in the store of the labels that are the classes. None for the classes of the input.
    classes : tuple of int
    skip_flags : int
        Bits of `PointBlock.flags` that exclude a point. Withheld points are always excluded.
    erode : Fraction
        Plan distance in counts. A ground point this near to a point of an object that is at least ``erode_rise``
        vertical counts higher is left out, as image matching smears walls onto the ground next to them. 0 keeps all.
    edits : str or None
        Key in the store of the edits, which override the classification of ground.
    """

    labels: str | None
    classes: tuple[int, ...] = (GROUND,)
    skip_flags: int = WITHHELD_FLAG
    erode: Fraction = Fraction(0)
    erode_rise: int = 0
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)

    def is_ground(self) -> npt.NDArray[np.bool_]:
        """Return whether each class or label is ground: bool (256,)."""
        table = np.zeros(256, np.bool_)
        for value in self.classes:
            table[[value, value | UNCERTIFIED_BIT] if self.labels is not None else [value]] = (
                True
            )
        return table


Choose = Callable[[Cell, npt.NDArray[np.int32]], npt.NDArray[np.intp]]
"""Function from a bucket and some of its points, int32 (3, n), to indices of the chosen
points."""


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

    xyz: npt.NDArray[np.int32]
    read: int
    marked: int


def read_ground(
    store: TileStore, rule: GroundSelection, bounds: Bounds, choose: Choose | None = None
) -> Ground:
    """Read the ground points in ``bounds`` (absolute counts), bucket by bucket in the lattice's order.

    Parameters
    ----------
    store : TileStore
    rule : GroundSelection
    bounds : Bounds
    choose : callable, optional
        Function that chooses the ground points of a bucket to keep, so that the others need no memory.
    """
    edges = _objects_at_edges(store, rule, bounds) if rule.erode else {}
    parts, marks = [np.empty((3, 0), np.int32)], [np.empty(0, np.bool_)]
    read = 0
    for cell in store.buckets_within(bounds):
        block, classes, is_ground = read_classes(
            store, rule, cell, needs_input=bool(rule.erode)
        )
        chosen = is_ground & _used(block, rule, store, cell)
        chosen &= block.inside(bounds, store.meta.frame.origin)
        index = np.flatnonzero(chosen)
        if rule.erode and len(index):
            own_objects = block.xyz[:, _is_object(block, classes, is_ground, rule, store, cell)]
            index = index[
                ~_beside_objects(store, rule, cell, block.xyz[:, index], own_objects, edges)
            ]
        points = block.xyz.take(index, axis=1)
        read += points.shape[1]
        parts.append(points if choose is None else points[:, choose(cell, points)])
        marks.append((classes[index] >= UNCERTIFIED_BIT) & (rule.labels is not None))
    return Ground(np.concatenate(parts, axis=1), read, int(np.concatenate(marks).sum()))


def read_objects(
    store: TileStore, rule: GroundSelection, bounds: Bounds
) -> npt.NDArray[np.int32]:
    """Read the points in ``bounds`` (absolute counts) that are neither ground nor noise, int32 (3, n)."""
    parts = [np.empty((3, 0), np.int32)]
    for cell in store.buckets_within(bounds):
        block, classes, is_ground = read_classes(store, rule, cell, needs_input=True)
        chosen = _is_object(block, classes, is_ground, rule, store, cell)
        chosen &= block.inside(bounds, store.meta.frame.origin)
        parts.append(block.xyz[:, chosen])
    return np.concatenate(parts, axis=1)


def read_ground_and_objects(
    store: TileStore, rule: GroundSelection, bounds: Bounds
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return the points of `read_ground` and of `read_objects`. Each bucket is read once if nothing is eroded."""
    if rule.erode:
        return read_ground(store, rule, bounds).xyz, read_objects(store, rule, bounds)
    ground_parts, object_parts = [np.empty((3, 0), np.int32)], [np.empty((3, 0), np.int32)]
    for cell in store.buckets_within(bounds):
        block, classes, is_ground = read_classes(store, rule, cell, needs_input=True)
        used = block.inside(bounds, store.meta.frame.origin) & _used(block, rule, store, cell)
        ground_parts.append(block.xyz[:, used & is_ground])
        labels = None if rule.labels is None else classes
        object_parts.append(
            block.xyz[:, used & ~is_ground & ~_is_noise(block, labels, store, cell)]
        )
    return np.concatenate(ground_parts, axis=1), np.concatenate(object_parts, axis=1)


def read_classes(
    store: TileStore, rule: GroundSelection, cell: Cell, needs_input: bool = False
) -> tuple[PointBlock, npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
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
) -> dict[Cell, npt.NDArray[np.int32]]:
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
    ground: npt.NDArray[np.int32],
    own: npt.NDArray[np.int32],
    edges: Mapping[Cell, npt.NDArray[np.int32]],
) -> npt.NDArray[np.bool_]:
    """Return a mask of the ground points near objects of the bucket (``own``) or of a neighbour."""
    around = store.meta.bucket.bounds(cell).pad(math.ceil(rule.erode))
    neighbour_objects = [
        edges[other] for other in store.meta.bucket.among(around, edges) if other != cell
    ]
    objects = np.concatenate([own, *neighbour_objects], axis=1)
    return near_objects(ground, objects, rule.erode, rule.erode_rise, store.meta.frame.origin)


def _is_object(
    block: PointBlock,
    classes: npt.NDArray[np.uint8],
    is_ground: npt.NDArray[np.bool_],
    rule: GroundSelection,
    store: TileStore,
    cell: Cell,
) -> npt.NDArray[np.bool_]:
    """Return a mask of the points that are neither ground nor noise, from results of `read_classes`."""
    labels = None if rule.labels is None else classes
    return ~is_ground & _used(block, rule, store, cell) & ~_is_noise(block, labels, store, cell)


def _is_noise(
    block: PointBlock, labels: npt.NDArray[np.uint8] | None, store: TileStore, cell: Cell
) -> npt.NDArray[np.bool_]:
    """Return a mask of the points that are noise by the input, or by the filter if there are labels."""
    noise = np.isin(_required(block.classification, store, cell), NOISE)
    return (
        noise if labels is None else noise | np.isin(labels & ~np.uint8(UNCERTIFIED_BIT), NOISE)
    )


def surface_points(
    store: TileStore, rule: GroundSelection, cell: Cell
) -> tuple[PointBlock, npt.NDArray[np.bool_]]:
    """Read all points of a bucket. Return them with a mask of the surface points.

    Surface points are not withheld or skipped, and are not noise by the input or by the filter.
    """
    block = store.read_bucket(cell, ("xyz", "flags", "classification"))
    labels = None if rule.labels is None else store.read_labels(rule.labels, cell)
    chosen = _used(block, rule, store, cell) & ~_is_noise(block, labels, store, cell)
    return block, chosen


def _used(
    block: PointBlock, rule: GroundSelection, store: TileStore, cell: Cell
) -> npt.NDArray[np.bool_]:
    """Return a mask of the points that are not excluded by a flag."""
    flags = _required(block.flags, store, cell)
    mask: npt.NDArray[np.bool_] = (flags & (rule.skip_flags | WITHHELD_FLAG)) == 0
    return mask


def _required(
    column: npt.NDArray[np.uint8] | None, store: TileStore, cell: Cell
) -> npt.NDArray[np.uint8]:
    if column is None:
        raise StoreError(
            f"{store.url}: bucket {cell.name} lacks its classes or flags; start anew with --overwrite"
        )
    return column
