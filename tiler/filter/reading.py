"""Tile that a task filters in one pass, and the reading of its points from the store."""

from __future__ import annotations

import dataclasses
import math
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from ptd.arrays import Bool
from ptd.passes import Pass, Points
from tiler.core.lattice import Bounds, Cell
from tiler.core.points import REPEATED_FLAG, UNCERTIFIED_BIT, PointBlock, Rows, participates
from tiler.core.records import NOT_IN_DIGEST
from tiler.store import BucketInfo, TileStore


@dataclass(frozen=True)
class FilterTile:
    """Tile of a pass.

    Attributes
    ----------
    method : str
    parameters : mapping
        Parameters of the method, as JSON.
    number : int
        Number of the pass, from 0.
    state : mapping
        State after the earlier passes.
    cells : tuple of Cell
        Buckets of the core.
    halo, max_halo : int
        First and largest halo in counts.
    keep_classes, skip_flags : tuple of int, int
        Points with one of these classes or flags keep their class and take no part in filtering, see
        `tiler.core.points.participates`.
    labels_in : str or None
        Name in the store of the labels that this pass reads; None if it reads none.
    labels_out : str
        Name in the store of the labels that this pass writes.
    elected_in : str or None
        Name in the store of the elected points that this pass reads (see `ptd.passes.Pass.elected`).
    elected_labels_in : str or None
        Name in the store of the labels of these elected points.
    elected_out : str or None
        Name in the store of the points that this pass elects.
    labels_elected : bool
        Whether this pass labels the elected points that it reads, instead of points of the cloud.
    candidates_only : bool
        Whether this pass labels only candidates, because later passes do not read other labels.
    input_candidates_only : bool
        Whether ``labels_in`` has labels only of candidates.
    held_bytes : int
        Limit of the bytes of buckets that are kept in memory because they are also read as margins of other buckets.
    """

    method: str
    parameters: Mapping[str, Any]
    number: int
    state: Mapping[str, Any]
    cells: tuple[Cell, ...]
    halo: int
    max_halo: int
    keep_classes: tuple[int, ...]
    skip_flags: int
    labels_in: str | None
    labels_out: str
    elected_in: str | None
    elected_labels_in: str | None
    elected_out: str | None
    labels_elected: bool
    candidates_only: bool
    input_candidates_only: bool
    held_bytes: int = field(metadata=NOT_IN_DIGEST)


@dataclasses.dataclass(frozen=True)
class Bucket:
    """Points of a bucket that take part in filtering.

    Attributes
    ----------
    points : Points
    mask : bool [n]
        Mask of these points among all points that are read for the bucket.
    uncertified : bool
        Whether a label of these points is uncertified. False for a bucket that was taken
        from the window, because `window` reports its uncertified labels.
    repeats : (intp [m], intp [m]), optional
        Rows of the points that get the label of another point at the same position, and of these other points, among
        all points that are read. None without such points.
    edge : Points, optional
        Points within `Pass.label_margin_m` of a side of the bucket, which its neighbours read. None without a margin,
        and if the margin holds the whole bucket.
    """

    points: Points
    mask: Bool
    uncertified: bool
    repeats: tuple[Rows, Rows] | None = None
    edge: Points | None = None

    @property
    def size_bytes(self) -> int:
        """Bytes of the columns of the bucket."""
        parts, names = [self.points, self.edge], [f.name for f in dataclasses.fields(Points)]
        columns = [getattr(part, name, None) for part in parts for name in names]
        arrays = (self.mask, *(self.repeats or ()), *(c for c in columns if c is not None))
        return sum(int(array.nbytes) for array in arrays)


class TileReader:
    """Reader of the points of a tile.

    Buckets that are also margins of other buckets stay in memory, up to ``work.held_bytes``.

    Parameters
    ----------
    store : TileStore
    step : Pass
    work : FilterTile
        Arguments of the task.
    """

    def __init__(self, store: TileStore, step: Pass, work: FilterTile) -> None:
        self._store, self._step, self._work = store, step, work
        self._columns = ("xyz", *(name for name in step.columns if name != "labels"))
        self._labels = work.labels_in if "labels" in step.columns else None
        self._elected_labels = work.elected_labels_in if "labels" in step.columns else None
        self._margin = math.ceil(
            store.meta.frame.counts(Fraction(repr(float(step.label_margin_m))))
        )
        self._near: dict[Cell, BucketInfo] | None = None
        self._held: OrderedDict[Cell, Bucket] = OrderedDict()
        self._held_bytes = 0
        self._window: tuple[Points, dict[Cell, slice]] | None = None

    def window(self, bounds: Bounds, cell_m: float) -> tuple[Points, bool]:
        """Read the points of a window for a pass. Return the points, and whether one has an uncertified label.

        - A pass on elected points gets elected points.
        - A pass that needs every point gets all points that take part in filtering.
        - Any other pass gets the candidates of the store if they suffice: if each cell of the method, with a side of
          ``cell_m``, consists of whole fine cells of the store. Otherwise it gets all points that take part.
        """
        slices_by_cell: dict[Cell, slice] = {}
        self._window = None  # This frees memory for the new window.
        if self._step.elected:
            block = self._elected(bounds, slices_by_cell)
        else:
            fine, frame = self._store.meta.fine.size, self._store.meta.frame
            nested = (
                cell_m > 0
                and (frame.counts(Fraction(repr(float(cell_m)))) / fine).denominator == 1
            )
            if nested and not self._step.every_point:
                block = self._store.window(
                    bounds, self._columns, True, self._labels, slices_by_cell
                )
            else:
                columns = (*self._columns, "classification", "flags")
                block = self._store.window(bounds, columns, labels=self._labels)
                taking = self._participating(block)
                block = block if taking.all() else block.take(taking)
        points = self._as_points(block)
        # If the pass labels what it has read, `bucket` takes it from the window instead of reading it again.
        labels_window = self._work.candidates_only or self._work.labels_elected
        if slices_by_cell and labels_window and not self._margin:
            self._window = points, slices_by_cell
        return points, _any_uncertified(block)

    def bucket(self, cell: Cell) -> Bucket:
        """Return the points of a bucket that the pass labels, or reads as the margin of another bucket."""
        if self._window is not None:
            points, slices_by_cell = self._window
            points = points.take(slices_by_cell.get(cell, slice(0, 0)))
            # `window` has already returned whether a label is uncertified.
            return Bucket(points, np.ones(len(points), np.bool_), False)
        if cell in self._held:
            self._held.move_to_end(cell)
            return self._held[cell]
        bucket = self._read(cell)
        if self._margin:  # Neighbouring buckets need these points later.
            self._held[cell] = bucket
            self._held_bytes += bucket.size_bytes
            while self._held_bytes > self._work.held_bytes and len(self._held) > 1:
                self._held_bytes -= self._held.popitem(last=False)[1].size_bytes
        return bucket

    def points_around(self, cell: Cell) -> tuple[list[Points], bool]:
        """Return the points within `Pass.label_margin_m` around a bucket.

        Return also whether a label in their buckets is uncertified.
        """
        if not self._margin:
            return [], False
        lattice = self._store.meta.bucket
        if self._near is None:  # The index is read only once for all buckets.
            self._near = self._store.buckets_within(
                lattice.hull(self._work.cells).pad(self._margin)
            )
        bounds = lattice.bounds(cell).pad(self._margin)
        parts = []
        uncertified = False
        for other in lattice.among(bounds, self._near):
            if other == cell:
                continue
            bucket = self.bucket(other)
            edge = bucket.points if bucket.edge is None else bucket.edge
            near = PointBlock(edge.xyz).inside(bounds, self._store.meta.frame.origin)
            if near.any():
                parts.append(edge.take(near))
                uncertified |= bucket.uncertified
        return parts, uncertified

    def _read(self, cell: Cell) -> Bucket:
        if self._work.labels_elected:
            block = self._elected(self._store.meta.bucket.bounds(cell), {})
            return Bucket(
                self._as_points(block), np.ones(len(block), np.bool_), _any_uncertified(block)
            )
        candidates_only = self._work.candidates_only
        columns = self._columns
        # All candidates take part, so their classes and flags are not needed.
        if not candidates_only:
            columns = (*columns, "classification", "flags")
        block = self._store.read_bucket(cell, columns, candidates_only)
        # If only candidates have labels, a bucket with all its points is read without labels.
        if self._labels is not None and (
            candidates_only or not self._work.input_candidates_only
        ):
            labels = self._store.read_labels(self._labels, cell, candidates_only)
            block = dataclasses.replace(block, labels=labels)
        if candidates_only:
            mask, repeats = np.ones(len(block), np.bool_), None
        else:
            mask, repeats = self._participating(block), self._repeats(cell, block)
        if not mask.all():
            block = block.take(mask)
        points, edge = self._as_points(block), None
        if self._margin:
            inner = self._store.meta.bucket.bounds(cell).pad(-self._margin)
            if not inner.empty:
                edge = points.take(~block.inside(inner, self._store.meta.frame.origin))
        return Bucket(points, mask, _any_uncertified(block), repeats, edge)

    def _repeats(self, cell: Cell, block: PointBlock) -> tuple[Rows, Rows] | None:
        """Return `Bucket.repeats` of a bucket: its repeated points that would take part otherwise."""
        if block.flags is None or not (block.flags & REPEATED_FLAG).any():
            return None
        repeated, chosen = self._store.representatives(cell, block)
        flags = block.flags & ~np.uint8(REPEATED_FLAG)
        taking = self._participating(dataclasses.replace(block, flags=flags))[repeated]
        return repeated[taking], chosen[taking]

    def _elected(self, bounds: Bounds, places: dict[Cell, slice]) -> PointBlock:
        if self._work.elected_in is None:
            raise ValueError("no earlier pass elected points")
        return self._store.elected(self._work.elected_in, bounds, self._elected_labels, places)

    def _as_points(self, block: PointBlock) -> Points:
        labels = None if block.labels is None else block.labels & ~np.uint8(UNCERTIFIED_BIT)
        if labels is None and "labels" in self._step.columns:
            labels = np.zeros(len(block), np.uint8)  # The points have no labels yet.
        return Points(block.xyz, labels, block.rgb, block.returns)

    def _participating(self, block: PointBlock) -> Bool:
        if block.classification is None or block.flags is None:
            raise ValueError("points were read without their classes and flags")
        keep, skip = self._work.keep_classes, self._work.skip_flags
        return participates(block.classification, block.flags, keep, skip)


def _any_uncertified(block: PointBlock) -> bool:
    return block.labels is not None and bool((block.labels >= UNCERTIFIED_BIT).any())
