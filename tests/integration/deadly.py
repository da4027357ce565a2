"""Tiles that kill, block or fill their worker, or wait: works that a worker process finds by name."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from tiler.core.lattice import Cell
from tiler.core.records import AssembledRecord, TileRecord
from tiler.filter.reading import FilterTile
from tiler.filter.tile import filter_tile
from tiler.ingest.assemble import assemble_buckets
from tiler.store import TileStore

CELL = "TILER_TEST_DEADLY_CELL"
DEED = "TILER_TEST_DEED"
HOLD = "hold"
"""Name of a file beside OUT; whose tile removes it is the only one that does not wait."""


def deadly_tile(store: TileStore, *, work: FilterTile) -> TileRecord:
    """`filter_tile`, but for the tile that holds a bucket named in the environment."""
    cell = [int(v) for v in os.environ[CELL].split(",")]
    if Cell(*cell) in work.cells:
        deed = os.environ[DEED]
        if deed == "exit":
            os._exit(1)
        if deed == "allocate":
            np.ones(1 << 32)
        if deed == "sleep":
            time.sleep(600)
    return filter_tile(store, work=work)


def held_tile(store: TileStore, *, work: FilterTile) -> TileRecord:
    """`filter_tile`, but of one tile alone: the others wait until they are killed."""
    try:
        (Path(store.url).parents[1] / HOLD).unlink()
    except FileNotFoundError:
        time.sleep(3600)
    return filter_tile(store, work=work)


def failing_group(store: TileStore, **values: Any) -> AssembledRecord:
    """`assemble_buckets`, but for the group that holds a bucket named in the environment."""
    cell = [int(v) for v in os.environ[CELL].split(",")]
    if any(bucket.cell == Cell(*cell) for bucket in values["buckets"]):
        raise RuntimeError("this group fails")
    return assemble_buckets(store, **values)
