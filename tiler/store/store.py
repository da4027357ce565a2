"""The tile store: points once, each in its bucket; halos, labels, rasters and what is done."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from tiler.core.area import Area
from tiler.core.breaklines import Breaklines
from tiler.core.edits import Edits
from tiler.core.lattice import Bounds, Cell
from tiler.core.points import PointBlock
from tiler.core.raster import NODATA, Block
from tiler.core.water import Waters
from tiler.errors import StoreError
from tiler.store import arrays, commits, elected, index, layout, lock, points, rasters, records, rows, spool
from tiler.store.index import Bucket, BucketIndex, BucketInfo
from tiler.store.meta import StoreMeta
from tiler.store.storage import Storage, Usage

Kept = TypeVar("Kept")


class TileStore:
    """A store that is open; made by `create_store` or `open_store`.

    All calls block and may come from several processes at once, as long as each bucket, block, piece and
    commit has one writer. Methods marked *coordinator* are for the one process that holds the `lock`.

    Attributes
    ----------
    url : str
    meta : StoreMeta
    settled : mapping
        What the first run decided for all later ones.
    """

    def __init__(self, storage: Storage, meta: StoreMeta, settled: Mapping[str, Any] | None = None) -> None:
        self.url = storage.url
        self.meta = meta
        self.settled = dict(settled or {})
        self._storage = storage
        self._points = points.PointColumns(storage, meta.has_rgb)
        self._index: BucketIndex | None = None
        self._labels: dict[str, rows.RowArray] = {}
        self._elected: dict[str, rows.RowArray] = {}
        self._rasters: dict[str, arrays.ZarrArray] = {}
        self._states: dict[str, Any] = {}

    # --- commits and state

    def commit(self, stage: str, key: str, digest: str, record: Mapping[str, Any]) -> None:
        """Say, after its data are written, that a task is done."""
        commits.commit(self._storage, stage, key, digest, record)

    def committed(self, stage: str) -> commits.Commits:
        """Key -> (digest, record) of every finished task of a stage; damaged commits count as none."""
        return commits.committed(self._storage, stage)

    def compact(self, stage: str, fewest: int = 1) -> None:
        """Pack the commits of a finished stage into one object if there are so many apart (*coordinator*)."""
        commits.compact(self._storage, stage, fewest)

    def uncommit(self, stage: str, *keys: str) -> None:
        """Take back that some tasks are done (*coordinator*)."""
        commits.uncommit(self._storage, stage, keys)

    def clear(self, stage: str) -> None:
        """Take back everything that a stage has done (*coordinator*)."""
        commits.clear(self._storage, stage)

    def put_state(self, name: str, value: Any) -> None:
        """Keep a JSON-able value under a name (*coordinator*)."""
        commits.put_state(self._storage, name, value)

    def put_area(self, area: Area) -> None:
        """Keep an area under its key."""
        self.put_state(f"area-{area.key}", area.to_json())

    def area(self, key: str | None) -> Area | None:
        """The area kept under a key; None without a key. StoreError where it is gone."""
        return None if key is None else self._kept(f"area-{key}", Area.from_json)

    def put_edits(self, edits: Edits) -> None:
        """Keep corrections under their key."""
        self.put_state(f"edits-{edits.key}", edits.to_json())

    def edits(self, key: str, bounds: Bounds, actions: Iterable[str]) -> Edits | None:
        """Those of the corrections kept under a key that are of some actions and touch the bounds; None for none."""
        found = self._kept(f"edits-{key}", Edits.from_json).near(bounds, actions)
        return found if found.edits else None

    def put_breaklines(self, lines: Breaklines) -> None:
        """Keep breaklines under their key."""
        self.put_state(f"breaklines-{lines.key}", lines.to_json())

    def breaklines(self, key: str) -> Breaklines:
        """The breaklines kept under a key."""
        return self._kept(f"breaklines-{key}", Breaklines.from_json)

    def put_waters(self, waters: Waters) -> None:
        """Keep bodies of water under their key."""
        self.put_state(f"waters-{waters.key}", waters.to_json())

    def waters(self, key: str | None, bounds: Bounds) -> Waters | None:
        """Those of the bodies kept under a key that touch the bounds; None for none."""
        found = Waters(()) if key is None else self.all_waters(key).near(bounds)
        return found if found.bodies else None

    def all_waters(self, key: str) -> Waters:
        """The bodies of water kept under a key."""
        return self._kept(f"waters-{key}", Waters.from_json)

    def _kept(self, name: str, read: Callable[[Any], Kept]) -> Kept:
        """What was put as a state, read once; StoreError where it is gone."""
        if name not in self._states:
            found = self.get_state(name)
            if found is None:
                raise StoreError(f"{name}: not in {self.url}; run again")
            self._states[name] = read(found)
        kept: Kept = self._states[name]
        return kept

    def get_state(self, name: str) -> Any:
        """The value kept under a name; None where there is none."""
        return commits.get_state(self._storage, name)

    # --- spool

    def write_piece(self, piece: str, block: PointBlock, index: Sequence[tuple[int, int, int]]) -> None:
        """Write the points of a source piece, sorted by bucket; ``index`` has (ix, iy, count) of each run."""
        spool.write_piece(self._storage, piece, block, index, self.meta.has_rgb)

    def piece_index(self, piece: str) -> spool.Index:
        """The index that a piece was written with."""
        return spool.piece_index(self._storage, piece, self.meta.has_rgb)

    def read_fragment(self, piece: str, start: int, stop: int) -> PointBlock:
        """Points ``start`` to ``stop - 1`` of a piece, all columns."""
        return spool.read_fragment(self._storage, piece, start, stop, self.meta.has_rgb)

    def pieces(self) -> set[str]:
        """Names of the pieces in the spool; some that were written in part may be among them."""
        return set(self._storage.names("spool"))

    def keep_records(self, piece: str, identity: str | None, record_bytes: int) -> records.RecordKeeper:
        """Begin to keep the records of a source piece."""
        return records.RecordKeeper(self._storage, piece, identity, record_bytes)

    def records(
        self, pieces: Sequence[records.KeptPiece], count: int, dtype: np.dtype[np.void]
    ) -> records.KeptRecords | None:
        """The ``count`` records of a source that consists of some pieces; None where they are not kept."""
        return records.find_records(self._storage, pieces, count, dtype)

    def drop_records(self) -> None:
        """Remove all records that were kept (*coordinator*)."""
        self._storage.delete_folder("records")

    def drop_spool(self) -> None:
        """Remove the spool (*coordinator*)."""
        self._storage.delete_folder("spool")

    def tidy(self) -> None:
        """Remove the spool once its points are in buckets, older indices and scratch; pack commits (*coordinator*).

        Scratch is what the store's writes leave when they are killed, so no task may run.
        """
        if index.remove_older(self._storage).rows:
            self.drop_spool()
        self.drop_records()
        for stage in self._storage.names("commits"):
            commits.compact(self._storage, stage)
        self._storage.remove_scratch()

    # --- buckets

    def allocate(self, counts: Mapping[Cell, int]) -> None:
        """Give rows to buckets (*coordinator*, while no task runs).

        Parameters
        ----------
        counts : mapping of Cell to int
            Upper bound of the points of each bucket. A bucket whose rows suffice keeps them and its points; one
            that outgrew them loses its points and has to be written again. Others stay as they are.
        """
        before = index.current_index(self._storage)
        after, moved = before.allocated(counts, layout.ROW_POINTS)
        self._points.grow(after.rows)
        for folder, kind in (("labels", layout.LABELS), ("elected", layout.ELECTED)):
            for name in self._storage.names(folder):
                if name != "zarr.json":
                    path = f"{folder}/{name}"
                    rows.lengthen_rows(self._storage, path, kind, after.rows)
                    for bucket in moved:
                        points.delete_rows(self._storage, path, bucket)
        after.publish(self._storage)
        for bucket in moved:
            self._points.delete_rows(bucket)
        self._labels.clear()
        self._elected.clear()
        self._index = after

    def write_bucket(self, cell: Cell, block: PointBlock, n_candidates: int) -> BucketInfo:
        """Write all points of a bucket, the candidates first; the record of it goes to `publish_index`.

        Raises
        ------
        StoreError
            The bucket was not allocated or has no room for the points, or a point lies outside it.
        """
        bucket = self._bucket(cell)
        if len(block) > bucket.rows * layout.ROW_POINTS or not 0 <= n_candidates <= len(block):
            raise StoreError(
                f"bucket {cell.name}: {len(block)} points, {n_candidates} of them candidates, "
                f"do not fit {bucket.rows} rows; allocate first"
            )
        if len(block) and not block.inside(self.meta.bucket.bounds(cell), self.meta.frame.origin).all():
            raise StoreError(f"bucket {cell.name}: a point lies outside the bucket")
        self._points.write(bucket, block)
        return BucketInfo(len(block), n_candidates)

    def publish_index(self, infos: Mapping[Cell, BucketInfo]) -> None:
        """Make exactly these buckets readable (*coordinator*, once all of them are written)."""
        published = index.current_index(self._storage).with_infos(infos, layout.ROW_POINTS)
        published.publish(self._storage)
        self._index = published

    def read_bucket(
        self, cell: Cell, columns: Sequence[str] = ("xyz",), candidates_only: bool = False
    ) -> PointBlock:
        """The points of a bucket in stored order; StoreError where it is not published or damaged."""
        bucket = self._bucket(cell)
        n = _count(bucket, candidates_only)
        return self._points.read(points.parts_of(bucket, n), columns)

    def buckets(self) -> dict[Cell, BucketInfo]:
        """The published buckets, row by row from the south-west."""
        self.refresh()
        return {b.cell: b.info for b in self._current().published() if b.info is not None}

    def buckets_within(self, bounds: Bounds) -> dict[Cell, BucketInfo]:
        """Those of the published `buckets` that hold a count of ``bounds``; costs no more however many others are."""
        self.refresh()
        near = self._current().overlapping(self.meta.bucket, bounds)
        return {b.cell: b.info for b in near if b.info is not None}

    def window(
        self,
        bounds: Bounds,
        columns: Sequence[str] = ("xyz",),
        candidates_only: bool = False,
        labels: str | None = None,
        places: dict[Cell, slice] | None = None,
    ) -> PointBlock:
        """All points of ``bounds``, each once, with the labels of that name if one is given: the halo view.

        Buckets come row by row from the south-west, their points in stored order, whatever the bounds. Reads
        the buckets that overlap and no others; needs the memory of the result, of one of its columns once
        more, and of eight rows. ``places`` receives where in the result the points of each bucket are.
        """
        parts = [
            part
            for bucket in self._current().overlapping(self.meta.bucket, bounds)
            for part in points.parts_of(bucket, _count(bucket, candidates_only))
        ]
        keep = points.inside(bounds, self.meta.frame.origin, lambda b: self.meta.bucket.bounds(b.cell))
        kept: list[int] = []
        given = None if labels is None else self._label_array(labels)
        block = self._points.read(parts, columns, keep, given, kept)
        if places is not None:
            end = 0
            for part, n in zip(parts, kept, strict=True):
                before = places.get(part.bucket.cell, slice(end, end))
                end += n
                places[part.bucket.cell] = slice(before.start, end)
        return block

    def _label_array(self, name: str) -> rows.RowArray:
        if name not in self._labels:
            self._labels[name] = rows.open_rows(self._storage, layout.labels_path(name), layout.LABELS)
        return self._labels[name]

    def owner_of(self, row: int) -> Cell | None:
        """The cell of the bucket that owns a row of the columns; None where it is nobody's."""
        self.refresh()
        return self._current().owner(row)

    def forget(self, folder: str) -> None:
        """Remove every object below a folder that is damaged as a whole (*coordinator*)."""
        self._storage.delete_folder(folder)
        self._points = points.PointColumns(self._storage, self.meta.has_rgb)
        self._index = None
        self._labels.clear()
        self._elected.clear()
        self._rasters.clear()

    def refresh(self) -> None:
        """Look for an index that another process published since this object first read it."""
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

    # --- labels

    def write_labels(
        self, name: str, cell: Cell, labels: npt.NDArray[np.uint8], candidates_only: bool = False
    ) -> None:
        """Write the labels of a bucket, uint8 (n,) in its stored order; StoreError where n differs."""
        bucket = self._bucket(cell)
        n = _count(bucket, candidates_only)
        if labels.shape != (n,) or labels.dtype != np.uint8:
            raise StoreError(
                f"labels {name} of bucket {cell.name}: need {n} uint8, got {labels.shape} {labels.dtype}"
            )
        points.write_rows(self._made_labels(name), bucket, labels[np.newaxis])

    def _made_labels(self, name: str) -> rows.RowArray:
        if name not in self._labels:
            path = layout.labels_path(name)
            self._labels[name] = rows.made_rows(self._storage, path, layout.LABELS, self._current().rows)
        return self._labels[name]

    def read_labels(self, name: str, cell: Cell, candidates_only: bool = False) -> npt.NDArray[np.uint8]:
        """The labels of a bucket, uint8 (n,); StoreError where they were not written."""
        bucket = self._bucket(cell)
        parts = points.parts_of(bucket, _count(bucket, candidates_only))
        if not parts:
            return np.empty(0, dtype=np.uint8)
        labels: npt.NDArray[np.uint8] = points.read_rows(self._label_array(name), parts)[0]
        return labels

    # --- elected points

    def write_elected(self, name: str, cell: Cell, xyz: npt.NDArray[np.int32]) -> None:
        """Write the points that a pass elected in a bucket, int32 (3, m); StoreError where one lies outside it."""
        bucket = self._bucket(cell)
        if xyz.dtype != np.int32 or xyz.ndim != 2 or xyz.shape[0] != 3:
            raise StoreError(
                f"elected points of bucket {cell.name}: need int32 (3, m), got {xyz.dtype} {xyz.shape}"
            )
        if not PointBlock(xyz).inside(self.meta.bucket.bounds(cell), self.meta.frame.origin).all():
            raise StoreError(f"bucket {cell.name}: an elected point lies outside the bucket")
        if name not in self._elected:
            path, n_rows = layout.elected_path(name), self._current().rows
            self._elected[name] = rows.made_rows(self._storage, path, layout.ELECTED, n_rows)
        elected.write(self._elected[name], bucket, _count(bucket, False), xyz)

    def write_elected_labels(self, name: str, cell: Cell, labels: npt.NDArray[np.uint8]) -> None:
        """Write the labels of the elected points of a bucket, uint8 (m,) in their stored order."""
        bucket = self._bucket(cell)
        n, array = _count(bucket, False), self._made_labels(name)
        elected.write(array, bucket, n, labels[np.newaxis])

    def elected(self, name: str, bounds: Bounds, labels: str | None = None) -> PointBlock:
        """The points of ``bounds`` that a pass elected, with their labels of that name if one is given.

        Buckets come row by row from the south-west; those of a bucket in stored order.
        """
        if name not in self._elected:
            path = layout.elected_path(name)
            self._elected[name] = rows.open_rows(self._storage, path, layout.ELECTED)
        parts = [
            part
            for bucket in self._current().overlapping(self.meta.bucket, bounds)
            for part in elected.places(bucket, _count(bucket, False))
        ]
        given = None if labels is None else self._label_array(labels)
        return elected.read(self._elected[name], given, parts, bounds, self.meta.frame.origin)

    # --- rasters

    def create_raster(self, name: str, height: int, width: int, fill: float = NODATA) -> None:
        """Make a float32 raster; one of the same shape and fill keeps its blocks (*coordinator*)."""
        self._rasters.pop(name, None)
        rasters.create_raster(self._storage, name, height, width, fill)

    def write_block(self, name: str, block: Block, values: npt.NDArray[np.float32]) -> None:
        """Write a block of 512 x 512 pixels (less at the south and east edge)."""
        rasters.write_block(self._storage, self._raster(name), block, values)

    def read_block(self, name: str, block: Block) -> npt.NDArray[np.float32]:
        """Any window of a raster; what was never written is the raster's fill."""
        return rasters.read_block(self._storage, self._raster(name), block)

    def stored_blocks(self, name: str) -> set[tuple[int, int]]:
        """First row and column of each block that a chunk is stored for; others hold the fill, or are lost."""
        return rasters.stored_blocks(self._storage, name)

    def erase_blocks(self, name: str, blocks: Iterable[Block]) -> None:
        """Remove what is stored of some blocks, which then hold the raster's fill."""
        rasters.erase_blocks(self._storage, name, blocks)

    def _raster(self, name: str) -> arrays.ZarrArray:
        if name not in self._rasters:
            self._rasters[name] = rasters.open_raster(self._storage, name)
        return self._rasters[name]

    # --- the store as a whole

    def lock(self) -> AbstractContextManager[lock.Lease]:
        """Hold the store for one run; raises LockedError, naming the holder, while another run does."""
        return lock.locked(self._storage)

    def try_write(self, name: str) -> None:
        """Write an object, read it and remove it again; raises StoreError or ProcessingError where that fails."""
        key = f"trial/{name}"
        self._storage.put_json(key, name)
        if self._storage.get_json(key) != name:
            raise StoreError(f"{self.url}: {key} was written, and cannot be read")
        self._storage.delete(key)

    def usage(self) -> Usage:
        """Objects and bytes of the store (lists all of it)."""
        return self._storage.usage()


def _count(bucket: Bucket, candidates_only: bool) -> int:
    if bucket.info is None:
        raise StoreError(f"bucket {bucket.cell.name}: not published yet; run ingest first")
    return bucket.info.n_candidates if candidates_only else bucket.info.n
