"""Base class of the parts of a store, with the location, the metadata and the open arrays."""

from __future__ import annotations

from tiler.store.arrays import StoredArray, open_array
from tiler.store.layout import ArrayKind
from tiler.store.meta import StoreMeta
from tiler.store.storage import Storage


class StorePart:
    """Part of `tiler.store.store.TileStore`, which inherits from all parts.

    Attributes
    ----------
    url : str
    meta : StoreMeta
    """

    def __init__(self, storage: Storage, meta: StoreMeta) -> None:
        self.url = storage.url
        self.meta = meta
        self._storage = storage
        self._open: dict[str, StoredArray] = {}

    def _opened(self, path: str, kind: ArrayKind) -> StoredArray:
        """Return the array at a path, which the first call opens. Raise CorruptStoreError if there is no array."""
        if path not in self._open:
            self._open[path] = open_array(self._storage, path, kind)
        return self._open[path]
