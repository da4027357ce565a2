"""`TileStore`, which combines the parts of a store: points, labels, rasters, spool, records, states and commits."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from tiler.core.crs import crs_name
from tiler.core.digests import digest_of
from tiler.errors import StoreError, TilerError
from tiler.store import index, layout, lock
from tiler.store.commits import CommitStore
from tiler.store.labels import LabelStore
from tiler.store.meta import StoreMeta
from tiler.store.rasters import MAX_RASTER_SETS, RASTER_SETS, RasterStore
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

    def use_rasters(self, resolution: str) -> None:
        """Have the rasters and the commits of their stages be those of a resolution (*coordinator*).

        The `MAX_RASTER_SETS` that were used last stay, others are removed. No task depends on this choice, since its
        digest decides whether it is done.
        """
        names, chosen = self.get_state(RASTER_SETS) or [""], digest_of(resolution)[:8]
        if names[-1] == chosen:
            return
        commits, stages = (
            self.get_state(f"rasters-{chosen}") or {},
            self.committed_stages("grid-"),
        )
        self.put_state(f"rasters-{names[-1]}", {s: self.committed(s) for s in stages})
        # A run that is killed here loses commits, but never has those of another set.
        for stage in stages:
            self.clear(stage)
        names = [*(name for name in names if name != chosen), chosen]
        self.put_state(RASTER_SETS, names[-MAX_RASTER_SETS:])
        self._raster_set = chosen
        for stage, done in commits.items():
            self._storage.put_json(layout.pack_key(stage), done)
        for name in names[:-MAX_RASTER_SETS]:
            self._storage.delete(layout.state_key(f"rasters-{name}"))
        for folder in self._storage.names("rasters"):
            if folder.partition(layout.SET_SEPARATOR)[2] not in names[-MAX_RASTER_SETS:]:
                self._storage.delete_folder(f"rasters/{folder}")

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
