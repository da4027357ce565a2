"""Repair of the store: tasks that wrote damaged or missing objects are run again.

A repeated task writes the same bytes, so all other tasks stay done.
"""

from __future__ import annotations

from collections.abc import Iterable

from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.core.records import TileRecord, buckets_in
from tiler.observe.events import Note
from tiler.runs.job import Job
from tiler.store import SET_SEPARATOR, chunk_numbers

ROUNDS = 3
"""Maximum number of repairs in a run. A disk that keeps damaging data cannot be repaired by
them."""


def repair(job: Job, keys: Iterable[str]) -> None:
    """Invalidate the tasks that wrote damaged objects.

    Parameters
    ----------
    job : Job
    keys : iterable of str
        Keys of the objects in the store, as in `tiler.errors.CorruptStoreError`.
    """
    for key in sorted(set(keys)):
        kind, name, chunk = [*key.split("/"), "", ""][:3]
        remedy = "the tasks that wrote it are run again"
        if kind == "records":
            remedy = "the source is decoded again"
        job.note(f"store: {key} is damaged or missing; {remedy}", Note)
        numbers = chunk_numbers(chunk)  # None for the whole array
        if kind == "spool":
            job.store.uncommit("spool", name)
        elif kind == "records":
            job.store.forget(f"records/{name}")
        elif kind == "rasters" and numbers is None:
            job.store.clear(_grid_stage(name))
            job.store.forget(f"rasters/{name}")
        elif kind == "rasters" and numbers:
            _take_back_block(job, name, *numbers)
        elif kind in ("labels", "elected") and numbers is None:
            _clear_filters(job)
            job.store.forget(f"{kind}/{name}")
        elif kind in ("labels", "elected", "points") and numbers:
            _take_back_bucket(job, kind, numbers[0])
        # The key is that of whole columns, or of the index, which assigns their rows to
        # buckets.
        else:
            _clear_filters(job)
            job.store.clear("assemble")
            job.store.forget("index")
            job.store.forget("points")
            job.store.forget("labels")
            job.store.forget("elected")
    job.results.healed = sorted({*job.results.healed, *keys})


def _passes(job: Job) -> list[str]:
    return [f"filter{number}" for number in range(job.store.get_state("passes") or 0)]


def _clear_filters(job: Job) -> None:
    for stage in _passes(job):
        job.store.clear(stage)


def _take_back_bucket(job: Job, kind: str, row: int) -> None:
    """Invalidate the tasks that wrote the points, labels or elected points of a bucket, given one of its rows."""
    cell = job.store.owner_of(row)
    if cell is None:
        return
    place = [cell.ix, cell.iy]
    if kind == "points":
        for task, (_, record) in job.store.committed("assemble").items():
            if any(bucket.cell == place for bucket in buckets_in(record)):
                job.invalidate("assemble", [task])
        return
    for stage in _passes(job):
        for task, (_, record) in job.store.committed(stage).items():
            if place in TileRecord.of(record).cells:
                job.invalidate(stage, [task])


def _take_back_block(job: Job, name: str, row: int, col: int) -> None:
    """Invalidate the task that wrote a chunk of a raster."""
    block = Block(row * BLOCK_PIXELS, col * BLOCK_PIXELS, BLOCK_PIXELS, BLOCK_PIXELS)
    job.invalidate(_grid_stage(name), [block.name])


def _grid_stage(folder: str) -> str:
    """Return the stage that makes the raster in a folder of the store."""
    return f"grid-{folder.partition(SET_SEPARATOR)[0]}"
