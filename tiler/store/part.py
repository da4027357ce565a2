"""Base class of the parts of a store: its location, its metadata and the arrays that are open."""

from __future__ import annotations

from tiler.store.arrays import StoredArray, open_array
from tiler.store.layout import ArrayKind
from tiler.store.meta import StoreMeta
from tiler.store.storage import Storage


class StorePart:
    """A part of `tiler.store.store.TileStore`, which is made of all of them.

    Attributes
    ----------
    url : str
    meta : StoreMeta
    """

    def __init__(self, storage: Storage, meta: StoreMeta) -> None:
        self.url, self.meta, self._storage = storage.url, meta, storage
        self._open: dict[str, StoredArray] = {}

    def _opened(self, path: str, kind: ArrayKind) -> StoredArray:
        """The array at a path, opened once; DamagedError where there is none."""
        if path not in self._open:
            self._open[path] = open_array(self._storage, path, kind)
        return self._open[path]
