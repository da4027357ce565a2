"""`TileStore`, which combines the parts of a store: points, labels, rasters, spool, records, states and commits."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from tiler.core.crs import crs_name
from tiler.errors import StoreError, TilerError
from tiler.store import index, lock
from tiler.store.commits import CommitStore
from tiler.store.labels import LabelStore
from tiler.store.meta import StoreMeta
from tiler.store.rasters import RasterStore
from tiler.store.records import RecordStore
from tiler.store.spool import SpoolStore
from tiler.store.states import StateStore
from tiler.store.storage import Storage, StoreSize


class TileStore(LabelStore, RasterStore, SpoolStore, RecordStore, StateStore, CommitStore):
    """Open store, made by `create_store` or `open_store`. Each part has its own class and module.

    All calls block and may come from several processes at once, as long as each bucket, block,
    piece and commit has one writer. Methods marked *coordinator* are only for the process that
    holds the `lock`.

    Attributes
    ----------
    url : str
    meta : StoreMeta
    settled : mapping
        Settings that the first run decided for all later runs.
    """

    def __init__(
        self, storage: Storage, meta: StoreMeta, settled: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(storage, meta)
        self.settled = dict(settled or {})

    def __repr__(self) -> str:
        try:
            buckets = self.buckets().values()
        except TilerError as error:
            return f"<TileStore {self.url}: {error}>"
        points = sum(bucket.n for bucket in buckets)
        crs = crs_name(self.meta.frame.crs_wkt)
        return f"<TileStore {self.url}: {points:,} points in {len(buckets):,} buckets, {crs}>"

    def lock(self) -> AbstractContextManager[lock.Lease]:
        """Hold the lock of the store for one run. Raise LockedError if another run holds it."""
        return lock.locked(self._storage)

    def clean_up(self) -> None:
        """Remove what later runs do not need, and pack the commits (*coordinator*, while no task runs).

        The spool is removed once rows are allocated to buckets. Kept records, older indices and
        the temporary files of killed writes are removed, too.
        """
        if index.remove_older(self._storage).rows:
            self.drop_spool()
        self.drop_records()
        for stage in self._storage.names("commits"):
            self.compact(stage)
        self._storage.remove_scratch()

    def forget(self, folder: str) -> None:
        """Remove every object in a damaged folder (*coordinator*)."""
        self._storage.delete_folder(folder)
        self._open.clear()
        self._index = None

    def try_write(self, name: str) -> None:
        """Write an object, read it and remove it. Raise StoreError or ProcessingError if one of these steps fails."""
        key = f"trial/{name}"
        self._storage.put_json(key, name)
        if self._storage.get_json(key) != name:
            raise StoreError(
                f"{self.url}: {key} was written but cannot be read; check the storage"
            )
        self._storage.delete(key)

    def usage(self) -> StoreSize:
        """Count the objects of the store and their bytes. This lists the whole store."""
        return self._storage.usage()
