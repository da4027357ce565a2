"""Points in columns of rows, and the index that tells which rows and how many points each bucket has.

A bucket owns whole rows, so each chunk has exactly one writer.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import compress

import numpy as np

from ptd.arrays import AnyArray, Bool, Int64
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import PointBlock
from tiler.core.records import digest_of_bytes
from tiler.errors import ConfigError, CorruptStoreError, StoreError
from tiler.store import arrays, layout
from tiler.store.arrays import StoredArray, StorePart
from tiler.store.layout import ROW_POINTS, Column
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

    def __init__(self, table: Int64) -> None:
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
        digest = digest_of_bytes(data)
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
    if digest_of_bytes(data) != digest:
        raise CorruptStoreError(
            f"{storage.url}: its bucket index is damaged; run again to rebuild it", ("index",)
        )
    return BucketIndex(np.load(io.BytesIO(data), allow_pickle=False))


def _bucket(line: list[int]) -> Bucket:
    info = None
    if line[_N] != UNPUBLISHED:
        info = BucketInfo(line[_N], line[_CANDIDATES])
    return Bucket(Cell(line[_IX], line[_IY]), line[_ROW], line[_ROWS], info)


Mask = Bool | None
Keep = Callable[[PointBlock, "Part"], Mask]

ROWS_PER_BATCH = 8
"""Number of rows whose chunks are read together."""

_LABELS = "labels"


@dataclass(frozen=True)
class Part:
    """First ``n`` points of a row of a bucket."""

    bucket: Bucket
    row: int
    n: int


def parts_of(bucket: Bucket, n: int) -> list[Part]:
    """Return the rows that hold the first ``n`` points of a bucket."""
    starts = range(0, n, ROW_POINTS)
    return [
        Part(bucket, bucket.row + i, min(ROW_POINTS, n - start))
        for i, start in enumerate(starts)
    ]


class ColumnStore(StorePart):
    """Points of a store, column by column."""

    @property
    def _columns(self) -> tuple[Column, ...]:
        return layout.columns(self.meta.has_rgb)

    def _column(self, column: Column) -> StoredArray:
        return self._opened(layout.points_path(column.name), column.kind)

    def _grow(self, n_rows: int) -> None:
        """Make the columns, or lengthen them to ``n_rows`` rows (*coordinator*)."""
        for column in self._columns:
            arrays.lengthen_rows(
                self._storage, layout.points_path(column.name), column.kind, n_rows
            )
        self._open.clear()

    def _write_points(self, bucket: Bucket, block: PointBlock) -> None:
        """Write all points of a bucket in whole chunks. Raise StoreError if a column is missing."""
        for column in self._columns:
            write_rows(self._column(column), bucket, self._joined(column, block, bucket))

    def _joined(self, column: Column, block: PointBlock, bucket: Bucket) -> AnyArray:
        values = np.empty((column.width, len(block)), dtype=column.kind.dtype)
        for field, part in column.fields.items():
            source = getattr(block, field)
            if source is None or source.dtype != values.dtype or source.shape[-1] != len(block):
                raise StoreError(
                    f"bucket {bucket.cell.name}: needs a column {field} of {len(block)} {values.dtype}"
                )
            values[part] = source
        return values

    def _read_points(
        self,
        parts: Sequence[Part],
        fields: Sequence[str],
        keep: Keep | None = None,
        labels: StoredArray | None = None,
        kept: list[int] | None = None,
    ) -> PointBlock:
        """Return the points of ``parts`` that ``keep`` selects, in order.

        Parameters
        ----------
        parts : sequence of Part
        fields : sequence of str
            Fields of `PointBlock` to read. xyz is always read, and rgb stays None if the store has no colours.
        keep : callable, optional
            Function that gets the xyz of a part, and the part, and returns the mask of the points to keep. A mask of
            None keeps all points.
        labels : StoredArray, optional
            Labels of a pass, which are read as well.
        kept : list of int, optional
            List that receives the number of points kept of each part.
        """
        columns = self._needed(fields)
        opened = {c.name: self._column(c) for c in columns}
        if labels is not None:
            opened[_LABELS] = labels
        gathered: Gathered = {name: [] for name in opened}
        for start in range(0, len(parts), ROWS_PER_BATCH):
            _gather(opened, parts[start : start + ROWS_PER_BATCH], keep, gathered)
        if kept is not None:
            kept.extend(piece.shape[1] for piece in gathered["xyz"])
        values_by_field: dict[str, AnyArray] = {}
        for column in columns:
            values = _side_by_side(gathered, column.name, column.kind)
            for field, part in column.fields.items():
                if field in fields or field == "xyz":
                    values_by_field[field] = (
                        values[part.start] if part.stop - part.start == 1 else values[part]
                    )
        if labels is not None:
            values_by_field["labels"] = _side_by_side(gathered, _LABELS, layout.LABELS)[0]
        return PointBlock(**values_by_field)

    def _needed(self, fields: Sequence[str]) -> list[Column]:
        known = {field for c in layout.COLUMNS for field in c.fields}
        for field in fields:
            if field not in known:
                raise ConfigError(
                    f"no column {field!r}: the store has {', '.join(sorted(known))}"
                )
        return [
            c for c in self._columns if c.name == "xyz" or any(f in c.fields for f in fields)
        ]


Gathered = dict[str, list[AnyArray]]
"""Values of each column, as one array per part."""


def _side_by_side(gathered: Gathered, name: str, kind: layout.ArrayKind) -> AnyArray:
    """Return the values of a column in one array.

    The column is removed from ``gathered``, so that at most one column is in memory twice.
    """
    pieces = gathered.pop(name)
    if len(pieces) == 1:  # It is a copy already (`_masked`).
        return pieces[0]
    return np.concatenate([np.empty((kind.chunks[1], 0), kind.dtype), *pieces], axis=1)


def _gather(
    opened: Mapping[str, StoredArray],
    parts: Sequence[Part],
    keep: Keep | None,
    gathered: Gathered,
) -> None:
    """Add the points that ``keep`` selects to ``gathered``, column by column.

    xyz is read first. Other columns are read only for parts with selected points.
    """
    masks: list[Mask] = [None] * len(parts)
    for name, array in opened.items():
        chunks = array.read_rows([part.row for part in parts])
        values = [chunk[0, :, : part.n] for chunk, part in zip(chunks, parts, strict=True)]
        if name == "xyz" and keep is not None:
            masks = [
                keep(PointBlock(xyz), part) for xyz, part in zip(values, parts, strict=True)
            ]
        for kept, mask in zip(values, masks, strict=True):
            gathered[name].append(_masked(kept, mask))
        if name == "xyz":
            has_points = [mask is None or bool(mask.any()) for mask in masks]
            parts = list(compress(parts, has_points))
            masks = list(compress(masks, has_points))


def _masked(values: AnyArray, mask: Mask) -> AnyArray:
    """Return the values (width, n) that a mask selects. They are always a copy, so that their chunk can be freed."""
    if mask is None:
        return values.copy()
    # `np.compress` is three times faster than `values[:, mask]`.
    kept: AnyArray = np.compress(mask, values, axis=1)
    return kept


def inside(
    bounds: Bounds, origin: tuple[int, int], cell_bounds: Callable[[Bucket], Bounds]
) -> Keep:
    """Return a `Keep` for the points of ``bounds``.

    The points of a bucket that lies inside the bounds are not compared one by one.
    """

    def keep(block: PointBlock, part: Part) -> Mask:
        a = cell_bounds(part.bucket)
        if a.x0 >= bounds.x0 and a.y0 >= bounds.y0 and a.x1 <= bounds.x1 and a.y1 <= bounds.y1:
            return None
        return block.inside(bounds, origin)

    return keep


def write_rows(array: StoredArray, bucket: Bucket, values: AnyArray) -> None:
    """Write ``values`` (width, n) to the rows of a bucket. The last row is padded with zeros."""
    for part in parts_of(bucket, values.shape[1]):
        start = (part.row - bucket.row) * ROW_POINTS
        row = np.zeros((1, values.shape[0], ROW_POINTS), dtype=values.dtype)
        row[0, :, : part.n] = values[:, start : start + part.n]
        array.write_row(part.row, row)


def read_rows(array: StoredArray, parts: Sequence[Part]) -> AnyArray:
    """Return the values (width, n) of ``parts``, concatenated in order."""
    chunks = array.read_rows([part.row for part in parts])
    return np.concatenate(
        [chunk[0, :, : part.n] for chunk, part in zip(chunks, parts, strict=True)], axis=1
    )
