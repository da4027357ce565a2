"""Commits: one small object per finished task, written after the task's data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tiler.core.digests import digest_of
from tiler.errors import StoreError
from tiler.store import layout
from tiler.store.part import StorePart
from tiler.store.storage import parse_json

OWNER = "owner"
"""Name of the state that tells whose commits are valid (see `CommitStore.keep_apart`)."""
Commits = dict[str, tuple[str, Mapping[str, Any]]]
"""Digest and record of each finished task, by key of the task."""


class CommitStore(StorePart):
    """Commits of the finished tasks of each stage."""

    def commit(self, stage: str, key: str, digest: str, record: Mapping[str, Any]) -> None:
        """Record that a task is done, in place of an earlier record. The task's data must be written before."""
        self._storage.put_json(
            layout.commit_key(stage, key), {"digest": digest, "record": dict(record)}
        )

    def committed(self, stage: str) -> Commits:
        """Return every finished task of a stage. A task with a damaged commit counts as not done."""
        commits = self._packed(stage)
        names = self._names(stage)
        keys = [layout.commit_key(stage, name) for name in names]
        for name, key, data in zip(names, keys, self._storage.get_many(keys), strict=True):
            if data is None:
                continue
            try:
                body = parse_json(key, data, name)
            except StoreError:
                commits.pop(name, None)
                continue
            commits[name] = (body["digest"], body["record"])
        return commits

    def compact(self, stage: str, fewest: int = 1) -> None:
        """Pack the commits of a stage into one object (*coordinator*, while no task of the stage runs).

        Without this, each call of `committed` for a stage of 10^5 tasks would need 10^5 requests. Fewer commits than
        ``fewest`` are not packed.
        """
        names = self._names(stage)
        if len(names) >= fewest:
            self._storage.put_json(layout.pack_key(stage), self.committed(stage))
            for name in names:
                self._storage.delete(layout.commit_key(stage, name))

    def committed_stages(self, prefix: str) -> list[str]:
        """Return the names of the stages with commits that begin with ``prefix``."""
        packed = (name.removesuffix(".json") for name in self._storage.names("packs"))
        names = {*packed, *self._storage.names("commits")}
        return sorted(name for name in names if name.startswith(prefix))

    def uncommit(self, stage: str, *keys: str) -> None:
        """Remove the records of some tasks (*coordinator*). The pack is written once for all of them."""
        if not keys:
            return
        pack = self._packed(stage)
        if not pack.keys().isdisjoint(keys):
            for key in keys:
                pack.pop(key, None)
            self._storage.put_json(layout.pack_key(stage), pack)
        for key in keys:
            self._storage.delete(layout.commit_key(stage, key))

    def clear(self, stage: str) -> None:
        """Remove the records of all tasks of a stage (*coordinator*)."""
        self._storage.delete(layout.pack_key(stage))
        self._storage.delete_folder(f"commits/{layout.safe(stage)}")

    def keep_apart(self, stages: Sequence[str], owner: str) -> None:
        """Have the commits of ``stages`` be those of ``owner``, and keep those of the owner before (*coordinator*).

        Stages that write files outside the store have commits for each place of these files. ``owner`` identifies one.
        """
        # A digest, since passwords and tokens in a URL are neither stored nor part of a digest.
        before, owner = self._storage.get_json(layout.state_key(OWNER)), digest_of(owner)
        if before == owner:
            return
        for stage in stages if before is not None else ():
            kept = self._storage.get_json(_kept_key(stage, owner)) or {}
            self._storage.put_json(_kept_key(stage, before), self.committed(stage))
            self.clear(stage)
            self._storage.put_json(layout.pack_key(stage), kept)
        self._storage.put_json(layout.state_key(OWNER), owner)

    def _packed(self, stage: str) -> Commits:
        try:
            pack = self._storage.get_json(layout.pack_key(stage)) or {}
        except StoreError:
            return {}
        return {key: (digest, record) for key, (digest, record) in pack.items()}

    def _names(self, stage: str) -> list[str]:
        entries = self._storage.names(f"commits/{layout.safe(stage)}")
        return [name.removesuffix(".json") for name in entries if name.endswith(".json")]


def _kept_key(stage: str, owner: str) -> str:
    return layout.state_key(f"{stage}-{owner}")
