"""Unpacked chunks of rasters that this process read last.

A task on coarse cells also reads the eight neighbours of its block. So each chunk is read by nine tasks of a step, and
again by the next steps. Unpacking takes ten times as long as reading the packed bytes.
"""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from typing import Any

import numpy.typing as npt

MAX_CHUNKS = 32
"""This many chunks are kept, 1 MiB each, as nine blocks of three rasters are 27 chunks."""


class RecentChunks:
    """The `MAX_CHUNKS` chunks that were used last, by key.

    A chunk is returned only for the packed bytes that it was unpacked from. So a chunk that any process wrote anew is
    unpacked again.
    """

    def __init__(self) -> None:
        self._chunks: OrderedDict[str, tuple[bytes, npt.NDArray[Any]]] = OrderedDict()
        self._lock = Lock()

    def find(self, key: str, data: bytes) -> npt.NDArray[Any] | None:
        """Return the values of a chunk with these packed bytes, or None if they are not kept."""
        with self._lock:
            packed, values = self._chunks.get(key, (b"", None))
            if values is None or packed != data:
                return None
            self._chunks.move_to_end(key)
            return values

    def keep(self, key: str, data: bytes, values: npt.NDArray[Any]) -> None:
        """Keep the values of a chunk (read-only) in place of the chunk that was used least recently."""
        with self._lock:
            self._chunks[key] = (data, values)
            self._chunks.move_to_end(key)
            if len(self._chunks) > MAX_CHUNKS:
                self._chunks.popitem(last=False)


RECENT_CHUNKS = RecentChunks()
"""Chunks of all stores that this process reads."""
