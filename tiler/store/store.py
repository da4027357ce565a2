"""`TileStore`, which combines the parts of a store, and functions that make, open, find and remove stores.

They do not open or delete what tiler did not write.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from tiler.core.crs import crs_name
from tiler.core.file_names import link_error
from tiler.core.records import digest_of
from tiler.errors import ConfigError, ForeignStoreError, StoreError, TilerError
from tiler.store import layout, lock
from tiler.store.buckets import LabelStore
from tiler.store.commits import CommitStore, StateStore
from tiler.store.layout import StoreMeta
from tiler.store.pieces import RecordStore, SpoolStore
from tiler.store.points import remove_older
from tiler.store.rasters import MAX_RASTER_SETS, RASTER_SETS, RASTER_STAGES, RasterStore
from tiler.store.storage import Storage, StoreSize, seal_holds, sealed


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
            self.committed_stages(RASTER_STAGES),
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
        for folder in self._storage.names(layout.RASTERS):
            raster_set = folder.partition(layout.SET_SEPARATOR)[2]
            if folder != layout.ROOT_KEY and raster_set not in names[-MAX_RASTER_SETS:]:
                self._storage.delete_folder(f"{layout.RASTERS}/{folder}")

    def clean_up(self) -> None:
        """Remove what later runs do not need, and pack the commits (*coordinator*, while no task runs).

        The spool is removed once rows are allocated to buckets. Kept records, older indices and
        the temporary files of killed writes are removed, too.
        """
        if remove_older(self._storage).rows:
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


def create_store(
    url: str, meta: StoreMeta, settled: Mapping[str, Any] | None = None, anew: bool = False
) -> TileStore:
    """Make a store, or open an existing one if it was made with the same `StoreMeta`.

    Parameters
    ----------
    url : str
    meta : StoreMeta
    settled : mapping, optional
        JSON-able settings that the first run decides for all later runs. They are written in one object with the
        description of the store, so that every store has them.
    anew : bool
        Whether to empty an existing store and give it the new description.

    Raises
    ------
    ConfigError
        The URL contains a store with another `StoreMeta`.
    StoreError
        The URL contains something other than a store.
    """
    storage = Storage(url)
    attributes = {
        layout.ROOT_ATTRIBUTE: {
            "schema": layout.SCHEMA_VERSION,
            **meta.to_json(),
            "settled": dict(settled or {}),
        }
    }
    there = _is_a_store(storage)
    if there and not anew:
        store = open_store(url)
        if store.meta != meta:
            raise ConfigError(
                f"{url}: contains a store of other settings or inputs; use --overwrite or another --store"
            )
        return store
    if there or storage.names(""):
        # The description stays until the new one replaces it, so that a killed run leaves a
        # valid store.
        _empty(storage)
    root = sealed(
        layout.ROOT_KEY, {"attributes": attributes, "zarr_format": 3, "node_type": "group"}
    )
    storage.put(layout.ROOT_KEY, json.dumps(root).encode())
    return TileStore(storage, meta, settled)


@contextmanager
def held_store(url: str) -> Iterator[lock.Lease]:
    """Lock the store at ``url`` for one run. The store need not exist yet.

    Raises
    ------
    ForeignStoreError
        The URL contains something other than a store. Nothing is written.
    ConfigError
        A folder of the store is a link. The store itself may be one.
    LockedError
        Another run holds the lock.
    """
    storage = Storage(url)
    _is_a_store(storage)
    root = storage.root
    folders = [] if root is None else [root / name for name in layout.FOLDERS]
    for folder in folders:
        if folder.is_symlink():
            raise link_error(folder)
    with lock.locked(storage) as lease:
        yield lease


def _is_a_store(storage: Storage) -> bool:
    """Return whether there is a store. Raise ForeignStoreError if there is something other than a store."""
    url = storage.url
    root = storage.root
    if root is not None and root.is_symlink() and not root.exists():
        raise ForeignStoreError(
            f"{url} is a link to a missing folder; make the folder or give another path"
        )
    if root is not None and root.is_file():
        raise ForeignStoreError(f"{url} is a file, not a tile store; give another path")
    data = storage.get(layout.ROOT_KEY)
    if data is None:
        # A zarr.json that is listed but cannot be read is a folder or a link to a folder.
        other_objects = [
            name
            for name in storage.names("")
            if name == layout.ROOT_KEY or not _is_remains(storage, name)
        ]
        if lock.is_foreign(storage):
            other_objects.append(layout.LOCK_KEY)
        if other_objects:
            raise ForeignStoreError(
                f"{url}: contains something other than a tile store ({other_objects[0]}); give an empty or new folder"
            )
        return False
    if _description(data) is None and not _is_damaged(data):
        raise ForeignStoreError(
            f"{url}: not a tile store of tiler; give another path, or remove it yourself"
        )
    return True


def _is_remains(storage: Storage, name: str) -> bool:
    """Return whether a file or folder belongs to the remains of a store that was removed while a run wrote to it."""
    return layout.is_ours(name) or (
        name in layout.FOLDERS and all(map(layout.is_ours, storage.keys(name)))
    )


def open_store(url: str) -> TileStore:
    """Open the store at ``url``. This is fast enough for every task to do it.

    Raises
    ------
    StoreError
        There is no store, another version wrote it, or its description is damaged.
    """
    storage = Storage(url)
    data = storage.get(layout.ROOT_KEY)
    if data is None:
        raise ForeignStoreError(
            f"{url}: no tile store here; run `tiler ingest` or `tiler run` to make one"
        )
    description = _description(data)
    if description is None:
        raise ForeignStoreError(f"{url}: not a tile store of tiler; give another path")
    if description["schema"] != layout.SCHEMA_VERSION:
        raise ForeignStoreError(
            f"{url}: store of schema {description['schema']}, this version reads {layout.SCHEMA_VERSION}; "
            "run again with --overwrite"
        )
    if not seal_holds(layout.ROOT_KEY, json.loads(data)):
        raise StoreError(
            f"{url}: zarr.json is damaged, its checksum does not fit; run again with --overwrite"
        )
    try:
        return TileStore(storage, StoreMeta.from_json(description), description.get("settled"))
    except StoreError as error:
        raise StoreError(f"{url}: {error}") from error


def _description(data: bytes) -> dict[str, Any] | None:
    """Return the description in the root object of a store, or None if tiler did not write the object."""
    try:
        description = json.loads(data)["attributes"][layout.ROOT_ATTRIBUTE]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return description if isinstance(description, dict) and "schema" in description else None


def _is_damaged(data: bytes) -> bool:
    """Return whether the data is the damaged root object of a store."""
    try:
        json.loads(data)
    except (ValueError, RecursionError):
        return layout.ROOT_ATTRIBUTE.encode() in data
    return False


def store_exists(url: str) -> bool:
    """Return whether there is a tile store, of any version, at ``url``."""
    data = Storage(url).get(layout.ROOT_KEY)
    return data is not None and _description(data) is not None


def remove_store(url: str) -> list[str]:
    """Delete the store at ``url`` if there is one. Files that do not belong to the store stay.

    Returns
    -------
    list of str
        Names of the files and folders that stay.

    Raises
    ------
    StoreError
        The URL contains something other than a store. Nothing is deleted.
    LockedError
        A run of another process holds the store.
    """
    storage = Storage(url)
    if not _is_a_store(storage):
        return []
    lock.validate_not_held(storage)
    _empty(storage)
    storage.delete(layout.ROOT_KEY)
    storage.delete_folder("")
    return storage.names("")


def _empty(storage: Storage) -> None:
    """Remove everything but the description and the lease of a store. The commits are removed first."""
    for folder in ("packs", "commits"):
        storage.delete_folder(folder)
    storage.delete_folder("", keep=(layout.ROOT_KEY, layout.LOCK_KEY))
