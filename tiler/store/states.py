"""State of the run: JSON-able values by name.

Areas, edits, breaklines and waters are states, too. A process caches the last ones that it
read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from tiler.core.area import Area
from tiler.core.breaklines import Breaklines
from tiler.core.edits import Edits
from tiler.core.lattice import Bounds
from tiler.core.water import Waters
from tiler.errors import StoreError
from tiler.store import layout
from tiler.store.part import StorePart

Kept = TypeVar("Kept")

_MAX_CACHED = 6
"""Maximum number of areas, edits, breaklines and waters in `_cache`: no run uses more at the
same time."""
_cache: dict[tuple[str, str], Any] = {}
"""Values by URL of the store and name. A name contains a digest of the content, so no value can be outdated.

The cache belongs to the process and not to a `TileStore`, since each task opens the store
again."""


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
