"""Commits: one small object per finished task, written after its data; and the state of the run."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from tiler.errors import StoreError
from tiler.store import layout
from tiler.store.storage import Storage, parse_json

Commits = dict[str, tuple[str, dict[str, Any]]]
"""Key of a task -> its digest and its record."""


def commit(storage: Storage, stage: str, key: str, digest: str, record: Mapping[str, Any]) -> None:
    """Say that a task is done; replaces what was said of it before."""
    storage.put_json(layout.commit_key(stage, key), {"digest": digest, "record": dict(record)})


def committed(storage: Storage, stage: str) -> Commits:
    """Every finished task of a stage. A damaged commit is none: its task is done again."""
    found = _packed(storage, stage)
    names = _names(storage, stage)
    for name, data in zip(names, storage.get_many([layout.commit_key(stage, n) for n in names]), strict=True):
        if data is None:
            continue
        try:
            body = parse_json(data, name)
        except StoreError:
            found.pop(name, None)
            continue
        found[name] = (body["digest"], body["record"])
    return found


def compact(storage: Storage, stage: str, fewest: int = 1) -> None:
    """Pack the commits of a stage into one object: for the coordinator, while no task of the stage runs.

    A stage of 10^5 tasks would otherwise cost 10^5 requests each time that somebody asks what is done. Fewer than
    ``fewest`` are left as they are.
    """
    names = _names(storage, stage)
    if len(names) >= fewest:
        storage.put_json(layout.pack_key(stage), committed(storage, stage))
        for name in names:
            storage.delete(layout.commit_key(stage, name))


def uncommit(storage: Storage, stage: str, keys: Collection[str]) -> None:
    """Take back that some tasks are done: for the coordinator. The pack is written once, however many they are."""
    if not keys:
        return
    pack = _packed(storage, stage)
    if not pack.keys().isdisjoint(keys):
        gone = set(keys)
        storage.put_json(layout.pack_key(stage), {k: c for k, c in pack.items() if k not in gone})
    for key in keys:
        storage.delete(layout.commit_key(stage, key))


def clear(storage: Storage, stage: str) -> None:
    """Take back everything that a stage has done: for the coordinator."""
    storage.delete(layout.pack_key(stage))
    storage.delete_folder(f"commits/{layout.safe(stage)}")


def put_state(storage: Storage, name: str, value: Any) -> None:
    """Keep a JSON-able value under a name."""
    try:
        storage.put_json(layout.state_key(name), value)
    except TypeError as error:
        raise StoreError(f"state {name}: not JSON-able ({error})") from error


def get_state(storage: Storage, name: str) -> Any:
    """The value kept under a name; None where there is none."""
    return storage.get_json(layout.state_key(name))


def _packed(storage: Storage, stage: str) -> Commits:
    try:
        pack = storage.get_json(layout.pack_key(stage)) or {}
    except StoreError:
        return {}
    return {key: (digest, record) for key, (digest, record) in pack.items()}


def _names(storage: Storage, stage: str) -> list[str]:
    entries = storage.names(f"commits/{layout.safe(stage)}")
    return [name.removesuffix(".json") for name in entries if name.endswith(".json")]
