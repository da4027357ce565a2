"""Holes: pixels inside the survey that have no height."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.area import Area
from tiler.core.edits import NOT_GROUND, TO_GROUND, VOID
from tiler.core.raster import NODATA, Block, RasterSpec, within
from tiler.grid.coarse import padded
from tiler.store import TileStore

CELL_PIXELS = 32
"""Side in pixels of the cells that summarize holes. They keep a block's record small for holes
of any shape."""

LEAVE_HOLES = (NOT_GROUND, TO_GROUND, VOID)
"""Actions of edits that can leave pixels without a height."""

Mask = npt.NDArray[np.bool_]


class BlockHoles(NamedTuple):
    """Holes of a block.

    Attributes
    ----------
    n_surveyed : int
        Number of pixels that have a height or should have one.
    n_voided : int
        Number of holes that edits request.
    cells : list of list of int
        All other holes, see `hole_cells`.
    by_edit : list of [number, pixels]
        Number (name) of each edit, and count of the holes in it.
    """

    n_surveyed: int
    n_voided: int
    cells: list[list[int]]
    by_edit: list[list[int]]


def holes_of_block(
    store: TileStore,
    spec: RasterSpec,
    block: Block,
    heights: npt.NDArray[np.float32],
    surveyed: Mask,
    edits: str | None,
    area: Area | None,
) -> BlockHoles:
    """Count and locate the holes of a block.

    Parameters
    ----------
    store : TileStore
    spec : RasterSpec
    block : Block
    heights : float32, shape (height, width)
        Heights as they are delivered.
    surveyed : bool, shape (height + 2, width + 2)
        Mask of the pixels inside the survey: those of the block and one more on each side.
    edits : str or None
        Key in the store of the edits.
    area : Area or None
        Area outside which holes do not count.
    """
    empty, in_area = heights == np.float32(NODATA), spec.inside(padded(block, 1), area)
    outside, in_area = ~(surveyed & in_area), in_area[1:-1, 1:-1]
    surveyed = surveyed[1:-1, 1:-1]
    holes = empty & surveyed & in_area
    asked, counts = np.zeros_like(holes), []
    block_edits = (
        None if edits is None else store.edits(edits, spec.block_bounds(block), LEAVE_HOLES)
    )
    for edit in () if block_edits is None else block_edits.edits:
        part = spec.part(block, edit.area.bounds)
        inside, part_in_block = spec.inside(part, edit.area), within(part, block)
        counts.append([edit.number, int(np.count_nonzero(inside & holes[part_in_block]))])
        if edit.action == VOID:
            asked[part_in_block] |= inside
    return BlockHoles(
        n_surveyed=int(np.count_nonzero((~empty | surveyed) & in_area)),
        n_voided=int(np.count_nonzero(holes & asked)),
        cells=hole_cells(holes & ~asked, block, outside),
        by_edit=counts,
    )


def hole_cells(holes: Mask, block: Block, outside: Mask) -> list[list[int]]:
    """Return a list of numbers for each cell with holes.

    These are the number of holes, their first row and column, their last row and column, the number of holes that
    touch a pixel outside the survey, and row and column of the hole next to the mean of all.

    Parameters
    ----------
    holes : bool, shape (height, width)
    block : Block
    outside : bool, shape (height + 2, width + 2)
        Mask of the pixels outside the survey: those of the block and one more on each side.
    """
    rows, cols = np.nonzero(holes)
    if not len(rows):
        return []
    near_outside = scipy.ndimage.binary_dilation(outside, np.ones((3, 3), np.bool_))
    at_border = near_outside[1:-1, 1:-1][rows, cols]
    rows, cols = rows + block.row, cols + block.col
    cell_positions = np.stack((rows // CELL_PIXELS, cols // CELL_PIXELS))
    cells, number = np.unique(cell_positions, axis=1, return_inverse=True)
    number = number.ravel()
    counts_and_extents = np.empty((8, cells.shape[1]), np.int64)
    counts_and_extents[0] = np.bincount(number)
    counts_and_extents[1:3], counts_and_extents[3:5] = np.iinfo(np.int64).max, -1
    counts_and_extents[5] = np.bincount(number[at_border], minlength=cells.shape[1])
    for axis, values in enumerate((rows, cols)):
        np.minimum.at(counts_and_extents[1 + axis], number, values)
        np.maximum.at(counts_and_extents[3 + axis], number, values)
    mean_row, mean_col = (
        np.bincount(number, values) / counts_and_extents[0] for values in (rows, cols)
    )
    from_mean = np.hypot(rows - mean_row[number], cols - mean_col[number])
    nearest_first = np.lexsort((cols, rows, from_mean, number))
    nearest = nearest_first[np.searchsorted(number[nearest_first], np.arange(cells.shape[1]))]
    counts_and_extents[6:] = rows[nearest], cols[nearest]
    listed: list[list[int]] = counts_and_extents.T.tolist()
    return listed
