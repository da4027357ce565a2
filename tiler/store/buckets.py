"""Buckets: each point of the run is stored once, in the rows of its bucket. Tile and halo are a window of buckets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tiler.core import repeats
from tiler.core.lattice import Bounds, Cell
from tiler.core.points import PointBlock
from tiler.core.repeats import Rows
from tiler.errors import StoreError
from tiler.store import arrays, index, layout, points
from tiler.store.index import Bucket, BucketIndex, BucketInfo
from tiler.store.meta import StoreMeta
from tiler.store.storage import Storage


class BucketStore(points.ColumnStore):
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
        previous = index.current_index(self._storage)
        after, moved = previous.allocated(counts, layout.ROW_POINTS)
        self._grow(after.rows)
        for folder, kind in (("labels", layout.LABELS), ("elected", layout.ELECTED)):
            for name in self._storage.names(folder):
                if name == "zarr.json":
                    continue
                arrays.lengthen_rows(self._storage, f"{folder}/{name}", kind, after.rows)
                self._delete_rows(f"{folder}/{name}", moved)
        after.publish(self._storage)
        for column in self._columns:
            self._delete_rows(layout.points_path(column.name), moved)
        self._index = after

    def _delete_rows(self, path: str, buckets: Sequence[Bucket]) -> None:
        for bucket in buckets:
            for row in range(bucket.row, bucket.row + bucket.rows):
                self._storage.delete(layout.chunk_key(path, (row, 0, 0)))

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
        published = index.current_index(self._storage).with_infos(infos, layout.ROW_POINTS)
        published.publish(self._storage)
        self._index = published

    def read_bucket(
        self, cell: Cell, columns: Sequence[str] = ("xyz",), candidates_only: bool = False
    ) -> PointBlock:
        """Return the points of a bucket in stored order. Raise StoreError if it is not published or is damaged."""
        bucket = self._bucket(cell)
        return self._read_points(
            points.parts_of(bucket, count_of(bucket, candidates_only)), columns
        )

    def representatives(self, cell: Cell, block: PointBlock) -> tuple[Rows, Rows]:
        """Return rows of repeated points of a bucket and the row of the point that represents each.

        ``block`` is what `read_bucket` returned for all points of the bucket, with their flags.
        """
        n_candidates = count_of(self._bucket(cell), True)
        return repeats.representatives(block, n_candidates, self.meta.fine, self.meta.frame)

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
        parts: list[points.Part] = []
        for bucket in self._overlapping(bounds):
            parts.extend(points.parts_of(bucket, count_of(bucket, candidates_only)))
        keep = points.inside(
            bounds, self.meta.frame.origin, lambda b: self.meta.bucket.bounds(b.cell)
        )
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
        self._index = index.current_index(self._storage)

    def _current(self) -> BucketIndex:
        if self._index is None:
            self._index = index.current_index(self._storage)
        return self._index

    def _bucket(self, cell: Cell) -> Bucket:
        bucket = self._current().find(cell)
        if bucket is None:
            raise StoreError(f"bucket {cell.name}: not in {self.url}; allocate first")
        return bucket


def count_of(bucket: Bucket, candidates_only: bool = False) -> int:
    """Return the number of points, or of candidates, in a bucket. Raise StoreError if it is not published."""
    if bucket.info is None:
        raise StoreError(
            f"bucket {bucket.cell.name}: not published yet; run `tiler ingest` first"
        )
    return bucket.info.n_candidates if candidates_only else bucket.info.n
