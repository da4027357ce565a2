"""Stores as a whole: made, opened, looked for and removed; nothing that tiler did not write is opened or deleted."""

from __future__ import annotations

import json

from tiler.errors import ConfigError, ForeignStoreError, StoreError
from tiler.store import layout, lock
from tiler.store.meta import StoreMeta
from tiler.store.storage import Storage, seal_holds, sealed
from tiler.store.store import TileStore


def create_store(url: str, meta: StoreMeta) -> TileStore:
    """A new store, or the one that is there if it was made with the same `StoreMeta`.

    Raises
    ------
    ConfigError
        A store of another `StoreMeta` is there.
    StoreError
        Something else is there.
    """
    storage = Storage(url)
    if storage.get("zarr.json") is not None:
        store = open_store(url)
        if store.meta != meta:
            raise ConfigError(
                f"{url}: holds a store of other settings or inputs; use --overwrite or another --store"
            )
        return store
    if storage.root is not None and storage.root.is_file():
        raise ForeignStoreError(f"{url}: is a file, not a tile store; give another place")
    if storage.names(""):
        raise ForeignStoreError(f"{url}: holds something else than a tile store; give an empty or new place")
    attributes = {layout.ROOT_ATTRIBUTE: {"schema": layout.SCHEMA_VERSION, **meta.to_json()}}
    root = sealed({"attributes": attributes, "zarr_format": 3, "node_type": "group"})
    storage.put("zarr.json", json.dumps(root).encode())
    return TileStore(storage, meta)


def open_store(url: str) -> TileStore:
    """The store at ``url``; cheap, so that every task can call it.

    Raises
    ------
    StoreError
        There is none, or it is not one that this version wrote.
    """
    storage = Storage(url)
    data = storage.get("zarr.json")
    if data is None:
        raise ForeignStoreError(f"{url}: no tile store here; `tiler ingest` or `tiler run` makes one")
    try:
        root = json.loads(data)
        description = root["attributes"][layout.ROOT_ATTRIBUTE]
        schema = description["schema"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ForeignStoreError(f"{url}: not a tile store of tiler; give another path") from error
    if schema != layout.SCHEMA_VERSION:
        raise ForeignStoreError(
            f"{url}: store of schema {schema}, this version reads {layout.SCHEMA_VERSION}; run again with --overwrite"
        )
    if not seal_holds(root):
        raise StoreError(
            f"{url}: zarr.json is damaged, its checksum does not fit; run again with --overwrite"
        )
    try:
        return TileStore(storage, StoreMeta.from_json(description))
    except StoreError as error:
        raise StoreError(f"{url}: {error}") from error


def store_exists(url: str) -> bool:
    """Whether something that claims to be a zarr store lies at ``url``."""
    return Storage(url).get("zarr.json") is not None


def remove_store(url: str) -> None:
    """Delete the store at ``url`` if there is one.

    Raises
    ------
    StoreError
        Something else is there; nothing is deleted.
    LockedError
        A run of another process holds the store.
    """
    storage = Storage(url)
    data = storage.get("zarr.json")
    if data is None:
        if storage.names(""):
            raise ForeignStoreError(f"{url}: holds something else than a tile store; remove it yourself")
        return
    if layout.ROOT_ATTRIBUTE.encode() not in data:
        raise ForeignStoreError(f"{url}: not a tile store of tiler; remove it yourself")
    lock.refuse_if_held(storage)
    storage.delete_everything()
