"""Points and results of passes by bucket: each point of the run is stored once, in the rows of its bucket.

Tile and halo are a window of buckets. A pass gives each point a label, and may elect points: new points, such as one
per cell, for later passes, in the first positions of the bucket's rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

from ptd.arrays import Int32, Int64, UInt8
from tiler.core.lattice import Bounds, Cell
from tiler.core.points import PointBlock, Rows, representatives
from tiler.errors import StoreError
from tiler.store import arrays, layout
from tiler.store.arrays import Chunk, StoredArray, find_or_make
from tiler.store.layout import ELECTED_PIECES, NOWHERE, ArrayKind, StoreMeta
from tiler.store.points import (
    ROWS_PER_BATCH,
    Bucket,
    BucketIndex,
    BucketInfo,
    ColumnStore,
    Part,
    current_index,
    inside,
    parts_of,
    read_rows,
    write_rows,
)
from tiler.store.storage import Storage


class BucketStore(ColumnStore):
    """Points of a store by bucket, and the index of the buckets."""

    def __init__(self, storage: Storage, meta: StoreMeta) -> None:
        super().__init__(storage, meta)
        self._index: BucketIndex | None = None

    def allocate(self, counts: Mapping[Cell, int]) -> None:
        """Allocate rows for buckets (*coordinator*, while no task runs).

        A bucket with enough rows keeps its rows and its points. A bucket that needs more rows
        than it has loses its points and has to be written again. Buckets that are not in
        ``counts`` do not change.

        Parameters
        ----------
        counts : mapping of Cell to int
            Upper bound of the number of points in each bucket.
        """
        previous = current_index(self._storage)
        after, moved = previous.allocated(counts, layout.ROW_POINTS)
        self._grow(after.rows)
        for folder, kind in (("labels", layout.LABELS), ("elected", layout.ELECTED)):
            for name in self._storage.names(folder):
                if name == "zarr.json":
                    continue
                arrays.lengthen_rows(self._storage, f"{folder}/{name}", kind, after.rows)
                self._delete_rows(f"{folder}/{name}", moved, kind.pieces)
        after.publish(self._storage)
        for column in self._columns:
            self._delete_rows(layout.points_path(column.name), moved)
        self._index = after

    def _delete_rows(self, path: str, buckets: Sequence[Bucket], pieces: int = 1) -> None:
        for bucket in buckets:
            rows = range(bucket.row, bucket.row + bucket.rows)
            for row, piece in product(rows, range(pieces)):
                self._storage.delete(layout.chunk_key(path, (row, 0, piece)))

    def write_bucket(self, cell: Cell, block: PointBlock, n_candidates: int) -> BucketInfo:
        """Write all points of a bucket, candidates first, and return the info for `publish_index`.

        Raises
        ------
        StoreError
            The bucket was not allocated or has no room for the points, or a point lies outside the bucket.
        """
        bucket = self._bucket(cell)
        if len(block) > bucket.rows * layout.ROW_POINTS or not 0 <= n_candidates <= len(block):
            raise StoreError(
                f"bucket {cell.name}: {len(block)} points, {n_candidates} of them candidates, "
                f"do not fit {bucket.rows} rows; allocate first"
            )
        if (
            len(block)
            and not block.inside(self.meta.bucket.bounds(cell), self.meta.frame.origin).all()
        ):
            raise StoreError(f"bucket {cell.name}: a point lies outside the bucket")
        self._write_points(bucket, block)
        return BucketInfo(len(block), n_candidates)

    def publish_index(self, infos: Mapping[Cell, BucketInfo]) -> None:
        """Make exactly these buckets readable (*coordinator*, once all of them were written)."""
        published = current_index(self._storage).with_infos(infos, layout.ROW_POINTS)
        published.publish(self._storage)
        self._index = published

    def read_bucket(
        self, cell: Cell, columns: Sequence[str] = ("xyz",), candidates_only: bool = False
    ) -> PointBlock:
        """Return the points of a bucket in stored order. Raise StoreError if it is not published or is damaged."""
        bucket = self._bucket(cell)
        return self._read_points(parts_of(bucket, _count_of(bucket, candidates_only)), columns)

    def read_origin(self, cell: Cell) -> Int64:
        """Return the origin of the points of a bucket in stored order, int64 (n,), without reading their positions."""
        bucket = self._bucket(cell)
        parts = parts_of(bucket, _count_of(bucket))
        if not parts:
            return np.empty(0, dtype=np.int64)
        (column,) = (c for c in self._columns if c.name == "origin")
        origin: Int64 = read_rows(self._column(column), parts)[0]
        return origin

    def representatives(self, cell: Cell, block: PointBlock) -> tuple[Rows, Rows]:
        """Return rows of repeated points of a bucket and the row of the point that represents each.

        ``block`` is what `read_bucket` returned for all points of the bucket, with their flags.
        """
        n_candidates = _count_of(self._bucket(cell), True)
        return representatives(block, n_candidates, self.meta.fine, self.meta.frame)

    def buckets(self) -> dict[Cell, BucketInfo]:
        """Return the published buckets, row by row from the south-west."""
        self.refresh()
        return {b.cell: b.info for b in self._current().published() if b.info is not None}

    def buckets_within(self, bounds: Bounds) -> dict[Cell, BucketInfo]:
        """Return the published buckets that overlap ``bounds``.

        The cost does not grow with the number of other buckets.
        """
        self.refresh()
        return {b.cell: b.info for b in self._overlapping(bounds) if b.info is not None}

    def window(
        self,
        bounds: Bounds,
        columns: Sequence[str] = ("xyz",),
        candidates_only: bool = False,
        labels: str | None = None,
        places: dict[Cell, slice] | None = None,
    ) -> PointBlock:
        """Return all points of ``bounds``, each once, with the labels named ``labels`` if given.

        Buckets come row by row from the south-west, and their points in stored order,
        independent of the bounds. Only the buckets that overlap the bounds are read. The peak
        memory is the result, a second copy of one column, and eight rows. ``places`` receives
        the slice of each bucket's points in the result.
        """
        parts: list[Part] = []
        for bucket in self._overlapping(bounds):
            parts.extend(parts_of(bucket, _count_of(bucket, candidates_only)))
        keep = inside(bounds, self.meta.frame.origin, lambda b: self.meta.bucket.bounds(b.cell))
        kept: list[int] = []
        given = None if labels is None else self._label_array(labels)
        block = self._read_points(parts, columns, keep, given, kept)
        if places is not None:
            end = 0
            for part, n in zip(parts, kept, strict=True):
                previous_slice = places.get(part.bucket.cell, slice(end, end))
                end += n
                places[part.bucket.cell] = slice(previous_slice.start, end)
        return block

    def _label_array(self, name: str) -> arrays.StoredArray:
        return self._opened(layout.labels_path(name), layout.LABELS)

    def _overlapping(self, bounds: Bounds) -> list[Bucket]:
        """Return the published buckets that overlap ``bounds``, row by row from the south-west."""
        return self._current().overlapping(self.meta.bucket, bounds)

    def owner_of(self, row: int) -> Cell | None:
        """Return the cell of the bucket that owns a row of the columns, or None if no bucket owns it."""
        self.refresh()
        return self._current().owner(row)

    def refresh(self) -> None:
        """Read the index again, since another process may have published a newer one."""
        self._index = current_index(self._storage)

    def _current(self) -> BucketIndex:
        if self._index is None:
            self._index = current_index(self._storage)
        return self._index

    def _bucket(self, cell: Cell) -> Bucket:
        bucket = self._current().find(cell)
        if bucket is None:
            raise StoreError(f"bucket {cell.name}: not in {self.url}; allocate first")
        return bucket


def _count_of(bucket: Bucket, candidates_only: bool = False) -> int:
    """Return the number of points, or of candidates, in a bucket. Raise StoreError if it is not published."""
    if bucket.info is None:
        raise StoreError(
            f"bucket {bucket.cell.name}: not published yet; run `tiler ingest` first"
        )
    return bucket.info.n_candidates if candidates_only else bucket.info.n


class LabelStore(BucketStore):
    """Labels and elected points by bucket, under the name of their pass."""

    def write_labels(
        self,
        name: str,
        cell: Cell,
        labels: UInt8,
        candidates_only: bool = False,
    ) -> None:
        """Write the labels of a bucket, uint8 (n,), in the stored order of its points.

        Raise StoreError if ``labels`` has another shape or dtype.
        """
        bucket = self._bucket(cell)
        n = _count_of(bucket, candidates_only)
        if labels.shape != (n,) or labels.dtype != np.uint8:
            raise StoreError(
                f"labels {name} of bucket {cell.name}: need {n} uint8, got {labels.shape} {labels.dtype}"
            )
        write_rows(
            self._made(layout.labels_path(name), layout.LABELS), bucket, labels[np.newaxis]
        )

    def read_labels(self, name: str, cell: Cell, candidates_only: bool = False) -> UInt8:
        """Return the labels of a bucket, uint8 (n,). Raise StoreError if they were not written."""
        bucket = self._bucket(cell)
        parts = parts_of(bucket, _count_of(bucket, candidates_only))
        if not parts:
            return np.empty(0, dtype=np.uint8)
        labels: UInt8 = read_rows(self._label_array(name), parts)[0]
        return labels

    def write_elected(self, name: str, cell: Cell, xyz: Int32) -> None:
        """Write the points that a pass elected in a bucket, int32 (3, m).

        Raise StoreError if a point lies outside the bucket or the bucket has no room for the
        points.
        """
        if xyz.dtype != np.int32 or xyz.ndim != 2 or xyz.shape[0] != 3:
            raise StoreError(
                f"elected points of bucket {cell.name}: need int32 (3, m), got {xyz.dtype} {xyz.shape}"
            )
        if (
            not PointBlock(xyz)
            .inside(self.meta.bucket.bounds(cell), self.meta.frame.origin)
            .all()
        ):
            raise StoreError(f"bucket {cell.name}: an elected point lies outside the bucket")
        self._write_first(layout.elected_path(name), layout.ELECTED, cell, xyz)

    def write_elected_labels(self, name: str, cell: Cell, labels: UInt8) -> None:
        """Write the labels of the elected points of a bucket, uint8 (m,) in their stored order."""
        self._write_first(layout.labels_path(name), layout.LABELS, cell, labels[np.newaxis])

    def elected(
        self,
        name: str,
        bounds: Bounds,
        labels: str | None = None,
        places: dict[Cell, slice] | None = None,
    ) -> PointBlock:
        """Return the points of ``bounds`` that a pass elected, with the labels named ``labels`` if given.

        Buckets come row by row from the south-west, and their points in stored order. ``places`` receives the slice of
        each bucket's points in the result.
        """
        array = self._opened(layout.elected_path(name), layout.ELECTED)
        given = None if labels is None else self._label_array(labels)
        held: list[Int32] = [np.empty((3, 0), np.int32)]
        labelled: list[UInt8] = [np.empty(0, np.uint8)]
        places, end = {} if places is None else places, 0
        buckets = [bucket for bucket in self._overlapping(bounds) if _count_of(bucket)]
        for bucket, elected in _elected_rows(array, buckets):
            keep = PointBlock(elected).inside(bounds, self.meta.frame.origin)
            held.append(np.compress(keep, elected, axis=1))
            if given is not None and keep.size:
                parts = parts_of(bucket, keep.size)
                labelled.append(read_rows(given, parts)[0, keep])
            start, end = end, end + held[-1].shape[1]
            places[bucket.cell] = slice(start, end)
        xyz = np.concatenate(held, axis=1)
        return PointBlock(xyz, labels=None if given is None else np.concatenate(labelled))

    def _write_first(
        self, path: str, kind: ArrayKind, cell: Cell, values: npt.NDArray[np.generic]
    ) -> None:
        """Write values (width, m) of elected points. Raise StoreError if the bucket's rows have no room for them.

        The last chunk that is written has an unused position, unless it is the bucket's last chunk.
        """
        bucket = self._bucket(cell)
        m, width = values.shape[1], kind.chunks[-1]
        chunks = _chunks(bucket, kind)
        if m > len(chunks) * width:
            raise StoreError(
                f"bucket {cell.name}: {m} elected points do not fit the rows of {_count_of(bucket)} points; "
                "elect at most as many points as the rows hold"
            )
        array = self._made(path, kind)
        for i, chunk in enumerate(chunks[: m // width + 1]):
            part = np.full(kind.chunks, kind.fill, values.dtype)
            given = values[:, i * width : (i + 1) * width]
            part[0, :, : given.shape[1]] = given
            array.write(chunk, part)

    def _made(self, path: str, kind: ArrayKind) -> StoredArray:
        """Return the array at a path, and make it if no task has written to it yet."""
        if path not in self._open:
            self._open[path] = find_or_make(self._storage, path, kind, self._current().rows)
        return self._open[path]


def _elected_rows(
    array: StoredArray, buckets: Sequence[Bucket]
) -> Iterator[tuple[Bucket, Int32]]:
    """Yield the elected points of each bucket: int32 (3, n). Its chunks are read until one has an unused position."""
    width = array.kind.chunks[-1]
    for start in range(0, len(buckets), ELECTED_PIECES * ROWS_PER_BATCH):
        batch = buckets[start : start + ELECTED_PIECES * ROWS_PER_BATCH]
        first_chunks = array.read_rows([bucket.row for bucket in batch])
        for bucket, first in zip(batch, first_chunks, strict=True):
            parts = [first[0]]
            for chunk in _chunks(bucket, array.kind)[1:]:
                if parts[-1][0, -1] == NOWHERE:
                    break
                parts.append(array.read([chunk])[0][0])
            n = (len(parts) - 1) * width + np.count_nonzero(parts[-1][0] != NOWHERE)
            yield bucket, np.concatenate(parts, axis=1)[:, :n]


def _chunks(bucket: Bucket, kind: ArrayKind) -> list[Chunk]:
    """Return the chunks that may hold elected points of a bucket, or their labels, in order.

    The number of elected points is not known before they are read.
    """
    rows = [part.row for part in parts_of(bucket, _count_of(bucket))]
    return [(row, 0, piece) for row, piece in product(rows, range(kind.pieces))]
