"""Cells with points of each survey in a bucket, and differences between the heights of surveys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ptd.arrays import Float64, Int32, Int64
from tiler.core.lattice import CoordFrame
from tiler.core.points import PointBlock
from tiler.core.records import Record
from tiler.core.surveys import CellMask
from tiler.ingest.assemble import BucketParts, read_bucket
from tiler.ingest.coverage import cells_of, covers, is_of_sources
from tiler.store import TileStore

MIN_POINTS = 3
"""Minimum number of points of a survey in a cell whose height is compared."""
MAX_STD_M = 0.15
"""Largest standard deviation, in metres, of the heights in such a cell. Others are steep, or have plants."""
BINS_PER_M = 100
"""Bins of a difference of heights in a metre."""
MAX_DIFFERENCE_M = 200
"""Largest difference of heights in metres, above all heights of the geoid. Larger ones count as this one."""
MAX_DEVIATION = 1 << 20
"""Largest deviation from the mean of a cell in counts, so that sums of squares are exact."""


Sources = tuple[int, ...]
"""Numbers of the sources of a survey in a bucket."""


@dataclass(frozen=True, slots=True)
class SurveyCells(Record):
    """Surveys in a bucket.

    Attributes
    ----------
    cell : [ix, iy]
        Index of the bucket.
    masks : list of CellMask
        Cells with points of each survey, the one that counts most first.
    numbers : list of int
        Number of these cells.
    differences : list of [i, j, bins, numbers]
        Histogram of the heights of survey ``j`` above survey ``i`` in cells in which both are flat. A bin is a
        hundredth of a metre.
    """

    cell: list[int]
    masks: list[CellMask]
    numbers: list[int]
    differences: list[tuple[int, int, list[int], list[int]]]


@dataclass(frozen=True, slots=True)
class SurveysRecord(Record):
    """Record of a task: the surveys in each of its buckets."""

    buckets: list[SurveyCells]


def find_surveys(
    store: TileStore,
    *,
    buckets: tuple[BucketParts, ...],
    surveys: tuple[tuple[Sources, ...], ...],
) -> SurveysRecord:
    """Find the cells of each survey in some buckets.

    ``surveys`` has the surveys of each bucket, the one that counts most first.
    """
    frame = store.meta.frame
    return SurveysRecord(
        [
            surveys_in(
                read_bucket(store, bucket)[0],
                (bucket.cell.ix, bucket.cell.iy),
                of_bucket,
                frame,
            )
            for bucket, of_bucket in zip(buckets, surveys, strict=True)
        ]
    )


def surveys_in(
    block: PointBlock, cell: Sequence[int], surveys: Sequence[Sequence[int]], frame: CoordFrame
) -> SurveyCells:
    """Return the cells of each survey in a bucket, and the differences of their heights.

    Parameters
    ----------
    block : PointBlock
        Points of the bucket with classes, flags and origins.
    cell : (int, int)
        Index of the bucket.
    surveys : sequence of sequence of int
        Numbers of the sources of each survey in the bucket, the survey that counts most first.
    frame : CoordFrame
    """
    block = block.take(covers(block))
    masks, numbers, differences = [], [], []
    if len(block):
        columns, rows = cells_of(block, frame)
        column, row = int(columns.min()), int(rows.min())
        width, height = int(columns.max()) - column + 1, int(rows.max()) - row + 1
        keys = (rows - row) * width + columns - column
    else:
        column = row = width = height = 0
        keys = np.empty(0, np.int64)
    heights = []
    for sources in surveys:
        own = is_of_sources(block, sources)
        counts = np.bincount(keys[own], minlength=width * height)
        masks.append(CellMask.packed(column, row, (counts > 0).reshape(height, width)))
        numbers.append(int(np.count_nonzero(counts)))
        if len(surveys) > 1:
            max_std = MAX_STD_M / float(frame.metres_z)
            heights.append(flat_heights(keys[own], block.xyz[2][own], counts, max_std))
    for (i, lower), (j, upper) in combinations(enumerate(heights), 2):
        difference_m = (upper - lower) * float(frame.metres_z)
        bins = np.rint(difference_m[np.isfinite(difference_m)] * BINS_PER_M)
        limit = MAX_DIFFERENCE_M * BINS_PER_M
        found, n = np.unique(np.clip(bins, -limit, limit).astype(np.int64), return_counts=True)
        if found.size:
            differences.append((i, j, found.tolist(), n.tolist()))
    return SurveyCells(list(cell), masks, numbers, differences)


def flat_heights(keys: Int64, z: Int32, counts: Int64, max_std: float) -> Float64:
    """Return the mean height of each cell in counts, NaN if it has few points or is not flat.

    Parameters
    ----------
    keys : int64 (n,)
        Number of each point's cell.
    z : int32 (n,)
    counts : int64 (m,)
        Number of points in each cell.
    max_std : float
        Largest standard deviation of the heights in a flat cell, in counts.
    """
    n = np.maximum(counts, 1)
    means = np.bincount(keys, z, counts.size) / n
    # All sums are of whole numbers and exact, so the order of the points does not matter.
    centres = np.rint(means).astype(np.int64)
    deviations = np.clip(z - centres[keys], -MAX_DEVIATION, MAX_DEVIATION).astype(np.float64)
    squares = np.bincount(keys, deviations**2, counts.size)
    flat = (counts >= MIN_POINTS) & (squares <= max_std**2 * n)
    heights: Float64 = np.where(flat, means, np.nan)
    return heights
