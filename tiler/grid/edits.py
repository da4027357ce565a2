"""Counts of the ground points inside each edit, before and after the edit, bucket by bucket."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiler.core.edits import OF_POINTS, TO_GROUND, EditedPoints
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.grid.ground import GroundSelection, read_classes
from tiler.grid.records import EditCountsRecord
from tiler.store import open_store


@dataclass(frozen=True)
class CountEditedPoints:
    """Arguments of `count_edited_points`: a bucket, and the key in the store of the edits."""

    rule: GroundSelection
    edits: str
    cell: Cell

    def place(self, buckets: Lattice) -> Bounds | None:
        """Return the bounds of the bucket."""
        return buckets.bounds(self.cell)


def count_edited_points(store_url: str, work: CountEditedPoints) -> EditCountsRecord:
    """Count the points of a bucket inside each edit. This is a `tiler.schedule.task.Work`.

    Each edit is counted as if there were no other edits.

    Returns
    -------
    EditCountsRecord
        Record of the bucket.
    """
    store = open_store(store_url)
    edits = store.edits(work.edits, store.meta.bucket.bounds(work.cell), OF_POINTS)
    if edits is None:
        return EditCountsRecord([])
    block, classes, is_ground = read_classes(store, work.rule, work.cell, needs_input=True)
    points = EditedPoints(block, classes, store.meta.frame.origin)
    counts = []
    for edit in edits.edits:
        rows = points.inside(edit.area)
        ground_before, after, given = int(is_ground[rows].sum()), [0, 0], 0
        if edit.action == TO_GROUND:
            becoming = [points.to_ground(rows, cell) for cell in (None, edits.cell)]
            after = [
                ground_before + int(np.count_nonzero(~is_ground[more])) for more in becoming
            ]
            given = len(becoming[0])
        counts.append([edit.number, len(rows), ground_before, *after, given])
    return EditCountsRecord(counts)
