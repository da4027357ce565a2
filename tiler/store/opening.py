"""Stores as a whole: made, opened, looked for and removed; nothing that tiler did not write is opened or deleted."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from tiler.errors import ConfigError, ForeignStoreError, StoreError
from tiler.store import layout, lock
from tiler.store.meta import StoreMeta
from tiler.store.storage import Storage, seal_holds, sealed
from tiler.store.store import TileStore


def create_store(
    url: str, meta: StoreMeta, settled: Mapping[str, Any] | None = None, anew: bool = False
) -> TileStore:
    """A new store, or the one that is there if it was made with the same `StoreMeta`.

    Parameters
    ----------
    url : str
    meta : StoreMeta
    settled : mapping, optional
        JSON-able settings that the first run decides for all later ones. They appear with the store itself, in one
        object, so that no store is without them.
    anew : bool
        A store that is there is emptied, and described anew.

    Raises
    ------
    ConfigError
        A store of another `StoreMeta` is there.
    StoreError
        Something else is there.
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
                f"{url}: holds a store of other settings or inputs; use --overwrite or another --store"
            )
        return store
    if there:
        # The description stays until the new one replaces it: a run that is killed meanwhile leaves a store.
        _empty(storage)
    root = sealed({"attributes": attributes, "zarr_format": 3, "node_type": "group"})
    storage.put("zarr.json", json.dumps(root).encode())
    return TileStore(storage, meta, settled)


@contextmanager
def held_store(url: str) -> Iterator[lock.Lease]:
    """Hold the store at a place, or the place for one, for one run.

    Raises
    ------
    ForeignStoreError
        Something else is there: nothing is written.
    LockedError
        Another run holds it.
    """
    storage = Storage(url)
    _is_a_store(storage)
    with lock.locked(storage) as lease:
        yield lease


def _is_a_store(storage: Storage) -> bool:
    """Whether a store of tiler lies at a place, and not nothing; ForeignStoreError where something else does."""
    url, root = storage.url, storage.root
    if root is not None and root.is_symlink() and not root.exists():
        raise ForeignStoreError(f"{url}: is a link to nothing; make what it leads to, or give another place")
    if root is not None and root.is_file():
        raise ForeignStoreError(f"{url}: is a file, not a tile store; give another place")
    data = storage.get("zarr.json")
    if data is None:
        # What is called zarr.json and cannot be read is a folder or leads to one.
        others = [name for name in storage.names("") if name == "zarr.json" or not layout.is_ours(name)]
        others += [layout.LOCK_KEY] if lock.is_foreign(storage) else []
        if others:
            raise ForeignStoreError(
                f"{url}: holds something else than a tile store ({others[0]}); give an empty or new place"
            )
        return False
    if _description(data) is None and not _is_damaged(data):
        raise ForeignStoreError(
            f"{url}: not a tile store of tiler; give another place, or remove it yourself"
        )
    return True


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
    description = _description(data)
    if description is None:
        raise ForeignStoreError(f"{url}: not a tile store of tiler; give another path")
    if description["schema"] != layout.SCHEMA_VERSION:
        raise ForeignStoreError(
            f"{url}: store of schema {description['schema']}, this version reads {layout.SCHEMA_VERSION}; "
            "run again with --overwrite"
        )
    if not seal_holds(json.loads(data)):
        raise StoreError(
            f"{url}: zarr.json is damaged, its checksum does not fit; run again with --overwrite"
        )
    try:
        return TileStore(storage, StoreMeta.from_json(description), description.get("settled"))
    except StoreError as error:
        raise StoreError(f"{url}: {error}") from error


def _description(data: bytes) -> dict[str, Any] | None:
    """What the root of a store says of it; None where it is none that tiler wrote."""
    try:
        found = json.loads(data)["attributes"][layout.ROOT_ATTRIBUTE]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return found if isinstance(found, dict) and "schema" in found else None


def _is_damaged(data: bytes) -> bool:
    """Whether this was the root of a store before something happened to it."""
    try:
        json.loads(data)
    except (ValueError, RecursionError):
        return layout.ROOT_ATTRIBUTE.encode() in data
    return False


def store_exists(url: str) -> bool:
    """Whether a tile store, of any version, lies at ``url``."""
    data = Storage(url).get("zarr.json")
    return data is not None and _description(data) is not None


def remove_store(url: str) -> list[str]:
    """Delete the store at ``url`` if there is one; nothing but what is a store's own.

    Returns
    -------
    list of str
        Names of what was left in its folder, being somebody else's.

    Raises
    ------
    StoreError
        Something else is there; nothing is deleted.
    LockedError
        A run of another process holds the store.
    """
    storage = Storage(url)
    if not _is_a_store(storage):
        return []
    lock.refuse_if_held(storage)
    _empty(storage)
    storage.delete("zarr.json")
    storage.delete_folder("")
    return storage.names("")


def _empty(storage: Storage) -> None:
    """Remove all but the description and the lease of a store, the records of finished tasks first."""
    for folder in ("packs", "commits"):
        storage.delete_folder(folder)
    storage.delete_folder("", keep=("zarr.json", layout.LOCK_KEY))
