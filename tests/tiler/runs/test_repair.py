"""Repair of the store: what wrote a damaged object is done again, and nothing else."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from tests.scenes.records import bucket_record, tile_record
from tiler.core.lattice import Cell
from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.runs.record import Results
from tiler.runs.repair import repair
from tiler.store import BucketInfo, TileStore
from tiler.store.layout import ROW_POINTS

WEST, EAST = Cell(0, 0), Cell(1, 0)
FIRST, SECOND = (Block(0, col, BLOCK_PIXELS, BLOCK_PIXELS).name for col in (0, BLOCK_PIXELS))
STAGES = {
    "spool": ["s0-0", "s0-1"],
    "assemble": ["a-west", "a-east"],
    "filter0": ["f-west", "f-east"],
    "filter1": ["f-west", "f-east"],
    "grid-dtm": [FIRST, SECOND],
    "grid-dsm": [FIRST],
}


@pytest.fixture
def store(small_store: TileStore) -> TileStore:
    """Two buckets of two rows each, two passes, two rasters; everything is committed, no point was written."""
    found, points = small_store, ROW_POINTS + 1
    found.allocate({WEST: points, EAST: points})
    found.publish_index({cell: BucketInfo(points, 1) for cell in (WEST, EAST)})
    for stage, keys in STAGES.items():
        for key in keys:
            cells = [[int(key.endswith("east")), 0]]
            buckets = [bucket_record(cell=cell).to_json() for cell in cells]
            record = {**tile_record(cells=cells).to_json(), "buckets": buckets}
            found.commit(stage, key, "digest", record)
    found.put_state("passes", 2)
    return found


def undone(store: TileStore, *keys: str) -> dict[str, set[str]]:
    """Stage -> tasks that are no longer done after a repair."""
    notes: list[str] = []
    job: Any = SimpleNamespace(
        store=store,
        note=lambda text, kind: notes.append(text),
        invalidate=lambda s, k: store.uncommit(s, *k),
    )
    job.results = Results()
    job.results.healed = ["earlier"]
    repair(job, keys)
    assert len(notes) == len(keys)
    assert job.results.healed == sorted({"earlier", *keys})
    left = {stage: set(tasks) - set(store.committed(stage)) for stage, tasks in STAGES.items()}
    return {stage: tasks for stage, tasks in left.items() if tasks}


BOTH = {"f-west", "f-east"}


@pytest.mark.parametrize(
    ("key", "tasks"),
    [
        ("spool/s0-1", {"spool": {"s0-1"}}),
        ("rasters/dtm/c.0.1", {"grid-dtm": {SECOND}}),
        ("rasters/dtm+0123abcd/c.0.1", {"grid-dtm": {SECOND}}),
        ("rasters/dtm/zarr.json", {"grid-dtm": {FIRST, SECOND}}),
        ("points/xyz/c.1.0.0", {"assemble": {"a-west"}}),
        ("points/xyz/c.2.0.0", {"assemble": {"a-east"}}),
        ("points/xyz/c.9.0.0", {}),
        ("labels/filter0/c.3.0", {"filter0": {"f-east"}, "filter1": {"f-east"}}),
        ("elected/filter0/c.0.0", {"filter0": {"f-west"}, "filter1": {"f-west"}}),
        ("labels/filter0/zarr.json", {"filter0": BOTH, "filter1": BOTH}),
        ("index/0", {"assemble": {"a-west", "a-east"}, "filter0": BOTH, "filter1": BOTH}),
        (
            "points/xyz/zarr.json",
            {"assemble": {"a-west", "a-east"}, "filter0": BOTH, "filter1": BOTH},
        ),
    ],
)
def test_the_task_that_wrote_an_object_is_done_again(
    key: str, tasks: dict[str, set[str]], store: TileStore
) -> None:
    assert undone(store, key) == tasks


def test_several_objects_of_one_task_cost_it_once(store: TileStore) -> None:
    assert undone(store, "points/xyz/c.0.0.0", "points/xyz/c.1.0.0", "spool/s0-0") == {
        "assemble": {"a-west"},
        "spool": {"s0-0"},
    }
