"""Counts of the ground points inside each edit, before and after the edit, bucket by bucket."""

from __future__ import annotations

import numpy as np

from tiler.core.edits import OF_POINTS, TO_GROUND, EditedPoints
from tiler.core.lattice import Cell
from tiler.grid.ground import read_classes
from tiler.grid.records import GroundSelection
from tiler.grid.steps import Counts
from tiler.store import TileStore


def count_edited_points(
    store: TileStore, *, rule: GroundSelection, edits_key: str, cell: Cell
) -> Counts:
    """Count the points of a bucket inside each edit.

    Each edit is counted as if there were no other edits.

    Returns
    -------
    dict
        ``edits``: for each edit that touches the bucket, its number, and five counts of points inside it: all; ground
        before the edit; ground after it by the input's classes; ground after it by the lowest points; points that the
        edit makes ground by the input's classes. The last three are 0 unless the edit adds ground.
    """
    edits = store.edits(edits_key, store.meta.bucket.bounds(cell), OF_POINTS)
    if edits is None:
        return {"edits": []}
    block, classes, is_ground = read_classes(store, rule, cell, needs_input=True)
    points = EditedPoints(block, classes, store.meta.frame.origin)
    counts = []
    for edit in edits.edits:
        rows = points.inside(edit.area)
        ground_before, after, given = int(is_ground[rows].sum()), [0, 0], 0
        if edit.action == TO_GROUND:
            becoming = [points.to_ground(rows, pixel) for pixel in (None, edits.cell)]
            after = [
                ground_before + int(np.count_nonzero(~is_ground[more])) for more in becoming
            ]
            given = len(becoming[0])
        counts.append([edit.number, len(rows), ground_before, *after, given])
    return {"edits": counts}
