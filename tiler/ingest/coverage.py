"""Places of a survey at which another survey counts, since it covers them (`tiler.core.surveys`).

The result at a place depends only on the points of the surveys around it, and not on buckets, pieces or files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ptd.arrays import Bool, Int64
from tiler.core.lattice import CoordFrame
from tiler.core.points import (
    NOISE,
    SOURCE_SHIFT,
    STRAY_FLAG,
    UNSEEN_FLAGS,
    UNSELECTED_FLAG,
    WITHHELD_FLAG,
    PointBlock,
)
from tiler.core.surveys import (
    CELL_M,
    GAP_M,
    MIN_WIDTH_M,
    NEAR_M,
    REACH_M,
    SEAM_M,
    CellMask,
    survey_cells_of,
    union_in,
)


@dataclass(frozen=True)
class Outranked:
    """Survey in a bucket: the numbers of its sources, and the cells near the bucket of surveys that count more."""

    sources: tuple[int, ...]
    cells: CellMask


def flag_outranked(
    block: PointBlock, surveys: Sequence[Outranked], frame: CoordFrame
) -> tuple[PointBlock, list[list[int]] | None]:
    """Flag the points at places where another survey counts. Return all points, and `BucketRecord.outranked`."""
    if not surveys or block.flags is None:
        return block, None
    columns, rows = cells_of(block, frame)
    column, row = int(columns.min()), int(rows.min())
    size = (int(columns.max()) - column + 1, int(rows.max()) - row + 1)
    seen, flags = (block.flags & UNSEEN_FLAGS) == 0, block.flags.copy()
    numbers = []
    for survey in surveys:
        hidden = covered(survey.cells, column, row, *size)[rows - row, columns - column]
        hidden &= is_of_sources(block, survey.sources)
        flags[hidden] |= UNSELECTED_FLAG
        keys = (rows * size[0] + columns)[hidden & seen]
        numbers.append([survey.sources[0], keys.size, int(np.unique(keys).size)])
    return replace(block, flags=flags), numbers


def covered(cells: CellMask, column: int, row: int, width: int, height: int) -> Bool:
    """Return the cells of a rectangle that surveys cover, with gaps and seam (`tiler.core.surveys`).

    ``cells`` must contain all cells of the surveys up to `REACH_M` around the rectangle.
    """
    pad = REACH_M // CELL_M
    window = union_in([cells], column - pad, row - pad, width + 2 * pad, height + 2 * pad)
    near, narrow, gap = (length / 2 / CELL_M for length in (NEAR_M, MIN_WIDTH_M, GAP_M))
    places = _narrowed(_widened(window, near), near)
    places = _widened(_narrowed(places, narrow), narrow)
    places = _narrowed(_widened(places, gap), gap)
    return _widened(places, SEAM_M / CELL_M)[pad : pad + height, pad : pad + width]


def _narrowed(cells: Bool, radius: float) -> Bool:
    """Return the cells that are farther than a distance, in cells, from all other cells."""
    return ~_widened(~cells, radius)


def _widened(cells: Bool, radius: float) -> Bool:
    """Return the cells up to a distance, in cells, from any of the cells."""
    if not cells.any():
        return cells
    distances = scipy.ndimage.distance_transform_edt(~cells)
    widened: Bool = distances <= radius
    return widened


def covers(block: PointBlock) -> Bool:
    """Return the mask of the points that cover a place: all but noise, strays and withheld points.

    Points that the settings do not select cover as well, since their survey measured the place.
    """
    if block.flags is None or block.classification is None:
        raise ValueError("fragments of the spool must have classes and flags")
    valid: Bool = (block.flags & (WITHHELD_FLAG | STRAY_FLAG)) == 0
    return valid & ~np.isin(block.classification, NOISE)


def is_of_sources(block: PointBlock, sources: Sequence[int]) -> Bool:
    """Return the mask of the points of some sources."""
    if block.origin is None:
        raise ValueError("fragments of the spool must have origins")
    return np.isin(block.origin >> SOURCE_SHIFT, sources)


def cells_of(block: PointBlock, frame: CoordFrame) -> tuple[Int64, Int64]:
    """Return column and row of each point's cell."""
    lattice = survey_cells_of(frame)
    x, y = (block.xyz[axis].astype(np.int64) + frame.origin[axis] for axis in (0, 1))
    return lattice.index(x), lattice.index(y)
