"""The tile store: points once, each in its bucket; halos, labels, rasters and what is done."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from tiler.errors import StoreError
from tiler.store import index, lock
from tiler.store.commits import CommitStore
from tiler.store.labels import LabelStore
from tiler.store.meta import StoreMeta
from tiler.store.rasters import RasterStore
from tiler.store.records import RecordStore
from tiler.store.spool import SpoolStore
from tiler.store.states import StateStore
from tiler.store.storage import Storage, Usage


class TileStore(LabelStore, RasterStore, SpoolStore, RecordStore, StateStore, CommitStore):
    """A store that is open; made by `create_store` or `open_store`. Each part is a class, and a module, of its own.

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
        super().__init__(storage, meta)
        self.settled = dict(settled or {})

    def lock(self) -> AbstractContextManager[lock.Lease]:
        """Hold the store for one run; raises LockedError, naming the holder, while another run does."""
        return lock.locked(self._storage)

    def tidy(self) -> None:
        """Remove the spool once its points are in buckets, older indices and scratch; pack commits (*coordinator*).

        Scratch is what the store's writes leave when they are killed, so no task may run.
        """
        if index.remove_older(self._storage).rows:
            self.drop_spool()
        self.drop_records()
        for stage in self._storage.names("commits"):
            self.compact(stage)
        self._storage.remove_scratch()

    def forget(self, folder: str) -> None:
        """Remove every object below a folder that is damaged as a whole (*coordinator*)."""
        self._storage.delete_folder(folder)
        self._open.clear()
        self._index = None

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
