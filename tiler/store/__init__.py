"""The tile store: a zarr 3 container with one writer per chunk, points once, and the halo as a view.

The only place that knows zarr, paths, dtypes, chunks and the schema version.
"""

from __future__ import annotations

from tiler.store.commits import Commits
from tiler.store.index import BucketInfo
from tiler.store.layout import SPOOL_CHUNK, chunk_numbers
from tiler.store.lock import LEASE_SECONDS, Lease, locked_folder
from tiler.store.meta import StoreMeta
from tiler.store.opening import create_store, held_store, open_store, remove_store, store_exists
from tiler.store.records import LONGEST_BYTES, KeptPiece, KeptRecords, RecordKeeper
from tiler.store.storage import Usage
from tiler.store.store import TileStore

__all__ = [
    "LEASE_SECONDS",
    "LONGEST_BYTES",
    "SPOOL_CHUNK",
    "BucketInfo",
    "Commits",
    "KeptPiece",
    "KeptRecords",
    "Lease",
    "RecordKeeper",
    "StoreMeta",
    "TileStore",
    "Usage",
    "chunk_numbers",
    "create_store",
    "held_store",
    "locked_folder",
    "open_store",
    "remove_store",
    "store_exists",
]
