"""Bucket index: the rows of the columns that belong to each bucket, and the number of points in them."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from tiler.core.digests import digest_of_bytes
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.errors import CorruptStoreError, StoreError
from tiler.store import layout
from tiler.store.storage import Storage

_IX, _IY, _ROW, _ROWS, _N, _CANDIDATES = range(6)
UNPUBLISHED = -1


@dataclass(frozen=True)
class BucketInfo:
    """Number of points in a bucket: ``n`` in total. The first ``n_candidates`` points are candidates."""

    n: int
    n_candidates: int


@dataclass(frozen=True)
class Bucket:
    """Bucket and its rows ``row`` to ``row + rows - 1``. ``info`` is None until the bucket is published."""

    cell: Cell
    row: int
    rows: int
    info: BucketInfo | None


class BucketIndex:
    """Immutable table of buckets, sorted by (iy, ix). A change makes a new table.

    Parameters
    ----------
    table : int64, shape (k, 6)
        Columns ix, iy, first row, number of rows, points and candidates. The last two are -1 if the bucket is not
        published.
    """

    def __init__(self, table: npt.NDArray[np.int64]) -> None:
        self._table = table[np.lexsort((table[:, _IX], table[:, _IY]))]
        self._iy = np.ascontiguousarray(self._table[:, _IY])
        self._place: dict[tuple[int, int], int] | None = None

    @classmethod
    def empty(cls) -> BucketIndex:
        """Return the index of a new store."""
        return cls(np.empty((0, 6), dtype=np.int64))

    @property
    def rows(self) -> int:
        """Number of rows that the columns need."""
        return int((self._table[:, _ROW] + self._table[:, _ROWS]).max(initial=0))

    def find(self, cell: Cell) -> Bucket | None:
        """Return the bucket of a cell, or None if it has no rows."""
        if self._place is None:
            cells = zip(self._table[:, _IX].tolist(), self._table[:, _IY].tolist(), strict=True)
            self._place = {key: i for i, key in enumerate(cells)}
        i = self._place.get((cell.ix, cell.iy))
        if i is None:
            return None
        return _bucket(self._table[i].tolist())

    def owner(self, row: int) -> Cell | None:
        """Return the cell whose bucket owns a row, or None if no bucket owns it."""
        first = self._table[:, _ROW]
        owners = self._table[(first <= row) & (row < first + self._table[:, _ROWS])]
        if not len(owners):
            return None
        return Cell(int(owners[0, _IX]), int(owners[0, _IY]))

    def published(self) -> Iterator[Bucket]:
        """Yield all published buckets, row by row from the south-west."""
        for line in self._table[self._table[:, _N] >= 0].tolist():
            yield _bucket(line)

    def overlapping(self, lattice: Lattice, bounds: Bounds) -> list[Bucket]:
        """Return the published buckets whose cells overlap ``bounds``, row by row from the south-west."""
        if bounds.empty:
            return []
        south = np.searchsorted(self._iy, lattice.index_of(bounds.y0))
        north = np.searchsorted(self._iy, lattice.index_of(bounds.y1 - 1), side="right")
        table = self._table[south:north]
        ix = table[:, _IX]
        hit = (ix >= lattice.index_of(bounds.x0)) & (ix <= lattice.index_of(bounds.x1 - 1))
        hit &= table[:, _N] >= 0
        return [_bucket(line) for line in table[hit].tolist()]

    def allocated(
        self, counts: Mapping[Cell, int], row_points: int
    ) -> tuple[BucketIndex, list[Bucket]]:
        """Return an index with rows for ``counts``, and the old entries of the buckets that got new rows.

        A bucket with enough rows keeps its rows and its info. A new bucket, or one that needs
        more rows than it has, gets rows at the end and is unpublished. Neighbouring buckets get
        neighbouring rows.
        """
        row = self.rows
        lines = {(line[_IX], line[_IY]): line for line in self._table.tolist()}
        moved = []
        for cell in sorted(counts, key=lambda c: (c.iy, c.ix)):
            needed = -(-counts[cell] // row_points)
            old = lines.get((cell.ix, cell.iy))
            if old is not None and old[_ROWS] >= needed:
                continue
            if old is not None and old[_ROWS] > 0:
                moved.append(_bucket(old))
            lines[cell.ix, cell.iy] = [cell.ix, cell.iy, row, needed, UNPUBLISHED, UNPUBLISHED]
            row += needed
        return BucketIndex(np.array(list(lines.values()), dtype=np.int64).reshape(-1, 6)), moved

    def with_infos(self, infos: Mapping[Cell, BucketInfo], row_points: int) -> BucketIndex:
        """Return an index in which exactly the buckets of ``infos`` are published.

        Raise StoreError if the points of a bucket do not fit its rows.
        """
        table = self._table.copy()
        table[:, _N:] = UNPUBLISHED
        row_of_cell = {(line[_IX], line[_IY]): i for i, line in enumerate(table.tolist())}
        for cell, info in infos.items():
            i = row_of_cell.get((cell.ix, cell.iy))
            if (
                i is None
                or not 0 <= info.n_candidates <= info.n <= table[i, _ROWS] * row_points
            ):
                raise StoreError(
                    f"bucket {cell.name}: {info.n} points do not fit its rows; allocate first"
                )
            table[i, _N:] = info.n, info.n_candidates
        return BucketIndex(table)

    def publish(self, storage: Storage) -> str:
        """Write the index, make it the current one, and return its digest."""
        stream = io.BytesIO()
        np.save(stream, self._table, allow_pickle=False)
        data = stream.getvalue()
        digest = _digest(data)
        previous_digest = storage.get_json(layout.INDEX_POINTER)
        storage.put(layout.index_key(digest), data)
        storage.put_json(layout.INDEX_POINTER, digest)
        if previous_digest is not None and previous_digest != digest:
            storage.delete(layout.index_key(previous_digest))
        return digest


def current_index(storage: Storage) -> BucketIndex:
    """Return the index that was published last. The process keeps it in memory until it changes."""
    for _ in range(5):
        try:
            digest = storage.get_json(layout.INDEX_POINTER)
        except StoreError as error:
            raise CorruptStoreError(str(error), ("index",)) from error
        if digest is None:
            return BucketIndex.empty()
        index = _loaded(storage, digest)
        if index is not None:
            return index
        _loaded.cache_clear()  # The index was replaced between the two reads.
    raise CorruptStoreError(
        f"{storage.url}: its bucket index is missing; run again to rebuild it", ("index",)
    )


def remove_older(storage: Storage) -> BucketIndex:
    """Remove every index but the current one, and return the current one."""
    current = current_index(storage)
    kept = {layout.INDEX_POINTER}
    pointer = storage.get_json(layout.INDEX_POINTER)
    if pointer is not None:
        kept.add(layout.index_key(pointer))
    for name in storage.names("index"):
        if f"index/{name}" not in kept:
            storage.delete(f"index/{name}")
    return current


@lru_cache(maxsize=4)
def _loaded(storage: Storage, digest: str) -> BucketIndex | None:
    data = storage.get(layout.index_key(digest))
    if data is None:
        return None
    if _digest(data) != digest:
        raise CorruptStoreError(
            f"{storage.url}: its bucket index is damaged; run again to rebuild it", ("index",)
        )
    return BucketIndex(np.load(io.BytesIO(data), allow_pickle=False))


def _digest(data: bytes) -> str:
    return digest_of_bytes(data)


def _bucket(line: list[int]) -> Bucket:
    info = None
    if line[_N] != UNPUBLISHED:
        info = BucketInfo(line[_N], line[_CANDIDATES])
    return Bucket(Cell(line[_IX], line[_IY]), line[_ROW], line[_ROWS], info)
