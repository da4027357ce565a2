"""Holes: pixels inside the survey that have no height."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.edits import NOT_GROUND, TO_GROUND, VOID
from tiler.core.raster import Block, within
from tiler.grid.block_surroundings import EditsNear
from tiler.grid.steps import Counts

CELL_PIXELS = 32
"""Side in pixels of the cells that summarize holes. They keep a block's record small for holes
of any shape."""

LEAVE_HOLES = (NOT_GROUND, TO_GROUND, VOID)
"""Actions of edits that can leave pixels without a height."""

Mask = npt.NDArray[np.bool_]


def holes_of_block(known: Mask, surveyed: Mask, edits: EditsNear, area: Mask) -> Counts:
    """Count and locate the holes of a block.

    Parameters
    ----------
    known : bool, shape (height, width)
        Mask of the pixels that are delivered with a height.
    surveyed, area : bool, shape (height + 2, width + 2)
        Masks of the pixels inside the survey and in the area outside which holes do not count: those of the block and
        one more on each side.
    edits : EditsNear

    Returns
    -------
    dict
        ``surveyed``: number of pixels that have a height or should have one. ``voided``: number of holes that edits
        request. ``holes``: all other holes, see `hole_cells`. ``edit_holes``: number (name) of each edit, and count of
        the holes in it.
    """
    outside, in_area = ~(surveyed & area), area[1:-1, 1:-1]
    surveyed = surveyed[1:-1, 1:-1]
    holes = ~known & surveyed & in_area
    asked, counts = np.zeros_like(holes), []
    for edit in edits.of(LEAVE_HOLES):
        part = edits.spec.part(edits.block, edit.area.bounds)
        inside, part_in_block = edits.spec.inside(part, edit.area), within(part, edits.block)
        counts.append([edit.number, int(np.count_nonzero(inside & holes[part_in_block]))])
        if edit.action == VOID:
            asked[part_in_block] |= inside
    return {
        "surveyed": int(np.count_nonzero((known | surveyed) & in_area)),
        "voided": int(np.count_nonzero(holes & asked)),
        "holes": hole_cells(holes & ~asked, edits.block, outside),
        "edit_holes": counts,
    }


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
