"""State of the run: JSON-able values by name.

Areas, corrections, breaklines and waters are states, too; a process reads each of them once.
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

_MOST_CACHED = 6
"""Most areas, corrections, breaklines and waters in `_cache`: no run uses more at a time."""
_cache: dict[tuple[str, str], Any] = {}
"""Values by URL of the store and name. A name holds a digest of the content, so that no value goes out of date.
The cache is the process's and not the store's, since each task opens the store anew."""


class StateStore(StorePart):
    """Values that the coordinator keeps for the tasks, and for later runs."""

    def put_state(self, name: str, value: Any) -> None:
        """Keep a JSON-able value under a name (*coordinator*)."""
        try:
            self._storage.put_json(layout.state_key(name), value)
        except TypeError as error:
            raise StoreError(f"state {name}: not JSON-able ({error})") from error

    def get_state(self, name: str) -> Any:
        """The value kept under a name; None if there is none."""
        return self._storage.get_json(layout.state_key(name))

    def put_area(self, area: Area) -> None:
        """Keep an area under its key."""
        self.put_state(f"area-{area.key}", area.to_json())

    def area(self, key: str | None) -> Area | None:
        """The area kept under a key, None for None; raises StoreError if it is missing."""
        if key is None:
            return None
        return self._kept(f"area-{key}", Area.from_json)

    def put_edits(self, edits: Edits) -> None:
        """Keep corrections under their key."""
        self.put_state(f"edits-{edits.key}", edits.to_json())

    def edits(self, key: str, bounds: Bounds, actions: Iterable[str]) -> Edits | None:
        """The corrections kept under a key that take one of the actions and touch the bounds; None if there is none."""
        found = self._kept(f"edits-{key}", Edits.from_json).near(bounds, actions)
        return found if found.edits else None

    def put_breaklines(self, lines: Breaklines) -> None:
        """Keep breaklines under their key."""
        self.put_state(f"breaklines-{lines.key}", lines.to_json())

    def breaklines(self, key: str) -> Breaklines:
        """The breaklines kept under a key."""
        return self._kept(f"breaklines-{key}", Breaklines.from_json)

    def put_waters(self, waters: Waters) -> None:
        """Keep bodies of water under their key."""
        self.put_state(f"waters-{waters.key}", waters.to_json())

    def waters(self, key: str | None, bounds: Bounds) -> Waters | None:
        """The bodies of water kept under a key that touch the bounds; None if there is none, or no key."""
        if key is None:
            return None
        found = self.all_waters(key).near(bounds)
        return found if found.bodies else None

    def all_waters(self, key: str) -> Waters:
        """The bodies of water kept under a key."""
        return self._kept(f"waters-{key}", Waters.from_json)

    def _kept(self, name: str, read: Callable[[Any], Kept]) -> Kept:
        """A state, from the cache if it is there; raises StoreError if the store has no such state."""
        at = (self.url, name)
        if at not in _cache:
            found = self.get_state(name)
            if found is None:
                raise StoreError(f"{name}: not in {self.url}; run again")
            while len(_cache) >= _MOST_CACHED:
                oldest = next(iter(_cache))
                _cache.pop(oldest, None)
            _cache[at] = read(found)
        kept: Kept = _cache[at]
        return kept
