"""Functions that make, open, find and remove stores. They do not open or delete what tiler did not write."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from tiler.core.links import link_error
from tiler.errors import ConfigError, ForeignStoreError, StoreError
from tiler.store import layout, lock
from tiler.store.meta import StoreMeta
from tiler.store.storage import Storage, seal_holds, sealed
from tiler.store.store import TileStore


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
