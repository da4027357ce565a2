"""Tile store: a zarr 3 container in which each chunk has one writer and each point is stored once.

No other package depends on zarr, or on the paths, dtypes, chunks and schema version of a store.
"""

from __future__ import annotations

from tiler.store.arrays import packed_by_one_thread
from tiler.store.commits import Commits
from tiler.store.layout import SET_SEPARATOR, SPOOL_CHUNK, StoreMeta, chunk_numbers
from tiler.store.lock import LEASE_SECONDS, Lease, locked_folder
from tiler.store.pieces import MAX_RECORD_BYTES, KeptPiece, KeptRecords, RecordKeeper
from tiler.store.points import BucketInfo
from tiler.store.rasters import (
    Steps,
    between_centres,
    coarse_cells,
    coarse_values,
    coarse_window,
    read_cells,
)
from tiler.store.store import (
    TileStore,
    create_store,
    held_store,
    open_store,
    remove_store,
    store_exists,
)

__all__ = [
    "LEASE_SECONDS",
    "MAX_RECORD_BYTES",
    "SET_SEPARATOR",
    "SPOOL_CHUNK",
    "BucketInfo",
    "Commits",
    "KeptPiece",
    "KeptRecords",
    "Lease",
    "RecordKeeper",
    "Steps",
    "StoreMeta",
    "TileStore",
    "between_centres",
    "chunk_numbers",
    "coarse_cells",
    "coarse_values",
    "coarse_window",
    "create_store",
    "held_store",
    "locked_folder",
    "open_store",
    "packed_by_one_thread",
    "read_cells",
    "remove_store",
    "store_exists",
]
