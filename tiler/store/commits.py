"""Facts about a run: a commit per finished task, written after the task's data, and states, which are JSON-able values.

Areas, edits, breaklines and waters are states, too. A process caches the last ones that it read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

from tiler.core.area import Area
from tiler.core.breaklines import Breaklines
from tiler.core.drawn_sheets import StoredAreas
from tiler.core.edits import Edits
from tiler.core.lattice import Bounds
from tiler.core.records import digest_of
from tiler.core.water import Waters
from tiler.errors import StoreError
from tiler.store import layout
from tiler.store.arrays import StorePart
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

    def committed_stages(self, prefixes: tuple[str, ...]) -> list[str]:
        """Return the names of the stages with commits that begin with one of ``prefixes``."""
        packed = (name.removesuffix(".json") for name in self._storage.names("packs"))
        names = {*packed, *self._storage.names("commits")}
        return sorted(name for name in names if name.startswith(prefixes))

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


Kept = TypeVar("Kept")

_MAX_CACHED = 6
"""Maximum number of areas, edits, breaklines and waters in `_cache`: no run uses more at the
same time."""
_cache: dict[tuple[str, str], Any] = {}
"""Values by URL of the store and name. A name contains a digest of the content, so no value can be outdated.

The cache belongs to the process and not to a `TileStore`, since each task opens the store
again."""


def _by_key(state: Sequence[Any]) -> dict[str, Area]:
    areas = [Area.from_json(rings) for rings in state]
    return {area.key: area for area in areas}


class StateStore(StorePart):
    """Values that the coordinator keeps for the tasks and for later runs."""

    def put_state(self, name: str, value: Any) -> None:
        """Write a JSON-able value under a name (*coordinator*)."""
        try:
            self._storage.put_json(layout.state_key(name), value)
        except TypeError as error:
            raise StoreError(f"state {name}: not JSON-able ({error})") from error

    def get_state(self, name: str) -> Any:
        """Return the value kept under a name, or None if there is none."""
        return self._storage.get_json(layout.state_key(name))

    def put_area(self, area: Area) -> None:
        """Write an area under its key."""
        self.put_state(f"area-{area.key}", area.to_json())

    def area(self, key: str | None) -> Area | None:
        """Return the area kept under a key, or None for None. Raise StoreError if it is missing."""
        if key is None:
            return None
        return self._kept(f"area-{key}", Area.from_json)

    def put_areas(self, areas: Sequence[Area]) -> str:
        """Write many areas as one state, and return its name (*coordinator*)."""
        name = f"areas-{digest_of([area.key for area in areas])}"
        self.put_state(name, [area.to_json() for area in areas])
        return name

    def areas(self, stored: StoredAreas) -> list[Area]:
        """Return areas that `put_areas` wrote. Raise StoreError if they are missing."""
        by_key = self._kept(stored.name, _by_key)
        return [by_key[key] for key in stored.keys]

    def put_edits(self, edits: Edits) -> None:
        """Write edits under their key."""
        self.put_state(f"edits-{edits.key}", edits.to_json())

    def edits(self, key: str, bounds: Bounds, actions: Iterable[str]) -> Edits | None:
        """Return the edits kept under a key that have one of the actions and touch the bounds.

        The result is None if there are no matching edits. Raise StoreError if the key is
        missing.
        """
        edits = self._kept(f"edits-{key}", Edits.from_json).near(bounds, actions)
        return edits if edits.edits else None

    def put_breaklines(self, lines: Breaklines) -> None:
        """Write breaklines under their key."""
        self.put_state(f"breaklines-{lines.key}", lines.to_json())

    def breaklines(self, key: str) -> Breaklines:
        """Return the breaklines kept under a key. Raise StoreError if they are missing."""
        return self._kept(f"breaklines-{key}", Breaklines.from_json)

    def put_waters(self, waters: Waters) -> None:
        """Write bodies of water under their key."""
        self.put_state(f"waters-{waters.key}", waters.to_json())

    def waters(self, key: str | None, bounds: Bounds) -> Waters | None:
        """Return the bodies of water kept under a key that touch the bounds.

        The result is None if no body touches the bounds or if ``key`` is None. Raise StoreError
        if the key is missing.
        """
        if key is None:
            return None
        waters = self.all_waters(key).near(bounds)
        return waters if waters.bodies else None

    def all_waters(self, key: str) -> Waters:
        """Return all bodies of water kept under a key. Raise StoreError if they are missing."""
        return self._kept(f"waters-{key}", Waters.from_json)

    def _kept(self, name: str, read: Callable[[Any], Kept]) -> Kept:
        """Return a state from the cache or from the store. Raise StoreError if the store has no such state."""
        at = (self.url, name)
        if at not in _cache:
            state = self.get_state(name)
            if state is None:
                raise StoreError(f"{name}: not in {self.url}; run again")
            while len(_cache) >= _MAX_CACHED:
                oldest = next(iter(_cache))
                _cache.pop(oldest, None)
            _cache[at] = read(state)
        kept: Kept = _cache[at]
        return kept
