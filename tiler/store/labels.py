"""Results of passes: a label per point of a bucket, and elected points in the first positions of its rows.

Elected points are new points that a pass makes, such as one per cell, for later passes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Bounds, Cell
from tiler.core.points import PointBlock
from tiler.errors import StoreError
from tiler.store import layout, points
from tiler.store.arrays import StoredArray, find_or_make
from tiler.store.buckets import BucketStore, count_of
from tiler.store.index import Bucket
from tiler.store.layout import NOWHERE, ROW_POINTS, ArrayKind


class LabelStore(BucketStore):
    """Labels and elected points by bucket, under the name of their pass."""

    def write_labels(
        self,
        name: str,
        cell: Cell,
        labels: npt.NDArray[np.uint8],
        candidates_only: bool = False,
    ) -> None:
        """Write the labels of a bucket, uint8 (n,), in the stored order of its points.

        Raise StoreError if ``labels`` has another shape or dtype.
        """
        bucket = self._bucket(cell)
        n = count_of(bucket, candidates_only)
        if labels.shape != (n,) or labels.dtype != np.uint8:
            raise StoreError(
                f"labels {name} of bucket {cell.name}: need {n} uint8, got {labels.shape} {labels.dtype}"
            )
        points.write_rows(
            self._made(layout.labels_path(name), layout.LABELS), bucket, labels[np.newaxis]
        )

    def read_labels(
        self, name: str, cell: Cell, candidates_only: bool = False
    ) -> npt.NDArray[np.uint8]:
        """Return the labels of a bucket, uint8 (n,). Raise StoreError if they were not written."""
        bucket = self._bucket(cell)
        parts = points.parts_of(bucket, count_of(bucket, candidates_only))
        if not parts:
            return np.empty(0, dtype=np.uint8)
        labels: npt.NDArray[np.uint8] = points.read_rows(self._label_array(name), parts)[0]
        return labels

    def write_elected(self, name: str, cell: Cell, xyz: npt.NDArray[np.int32]) -> None:
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

    def write_elected_labels(
        self, name: str, cell: Cell, labels: npt.NDArray[np.uint8]
    ) -> None:
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
        held: list[npt.NDArray[np.int32]] = [np.empty((3, 0), np.int32)]
        labelled: list[npt.NDArray[np.uint8]] = [np.empty(0, np.uint8)]
        places, end = {} if places is None else places, 0
        buckets = [bucket for bucket in self._overlapping(bounds) if count_of(bucket)]
        for bucket, elected in _elected_rows(array, buckets):
            keep = PointBlock(elected).inside(bounds, self.meta.frame.origin)
            held.append(np.compress(keep, elected, axis=1))
            if given is not None and keep.size:
                parts = points.parts_of(bucket, keep.size)
                labelled.append(points.read_rows(given, parts)[0, keep])
            start, end = end, end + held[-1].shape[1]
            places[bucket.cell] = slice(start, end)
        xyz = np.concatenate(held, axis=1)
        return PointBlock(xyz, labels=None if given is None else np.concatenate(labelled))

    def _write_first(
        self, path: str, kind: ArrayKind, cell: Cell, values: npt.NDArray[np.generic]
    ) -> None:
        """Write values (width, m) of elected points. Raise StoreError if the bucket's rows have no room for them.

        The last row that is written has an unused position, unless it is the bucket's last row.
        """
        bucket = self._bucket(cell)
        m = values.shape[1]
        rows = len(_places(bucket))
        if m > rows * ROW_POINTS:
            raise StoreError(
                f"bucket {cell.name}: {m} elected points do not fit the rows of {count_of(bucket)} points; "
                "elect at most as many points as the rows hold"
            )
        room = min(rows, m // ROW_POINTS + 1) * ROW_POINTS
        full = np.full((values.shape[0], room), kind.fill, values.dtype)
        full[:, :m] = values
        points.write_rows(self._made(path, kind), bucket, full)

    def _made(self, path: str, kind: ArrayKind) -> StoredArray:
        """Return the array at a path, and make it if no task has written to it yet."""
        if path not in self._open:
            self._open[path] = find_or_make(self._storage, path, kind, self._current().rows)
        return self._open[path]


def _elected_rows(
    array: StoredArray, buckets: Sequence[Bucket]
) -> Iterator[tuple[Bucket, npt.NDArray[np.int32]]]:
    """Yield the elected points of each bucket: int32 (3, n). Its rows are read until one has an unused position."""
    for start in range(0, len(buckets), points.ROWS_PER_BATCH):
        batch = buckets[start : start + points.ROWS_PER_BATCH]
        first_rows = array.read_rows([bucket.row for bucket in batch])
        for bucket, first in zip(batch, first_rows, strict=True):
            rows = [first[0]]
            for part in _places(bucket)[1:]:
                if rows[-1][0, -1] == NOWHERE:
                    break
                rows.append(array.read_rows([part.row])[0][0])
            n = (len(rows) - 1) * ROW_POINTS + np.count_nonzero(rows[-1][0] != NOWHERE)
            yield bucket, np.concatenate(rows, axis=1)[:, :n]


def _places(bucket: Bucket) -> list[points.Part]:
    """Return the rows that hold a bucket's points, each at full length.

    The number of elected points is not known before they are read.
    """
    return [
        points.Part(bucket, part.row, ROW_POINTS)
        for part in points.parts_of(bucket, count_of(bucket))
    ]
