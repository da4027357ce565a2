"""Pixels inside the survey without a height: holes, which are counted, and voids, which are filled.

A void is filled from the TIN of the pixels around it. A halo of any width may be too small for the facets over a
hole. So holes are found by coarse cells, block by block, and joined. Each hole is filled from all pixels with a
height that touch it, in whichever block they lie. The triangulation is unique, so borders of blocks are not visible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ptd.arrays import Bool, Float32, Int32, Int64
from ptd.tin import Tin, rasterise
from tiler.core.edits import NOT_GROUND, TO_GROUND, VOID
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.products import SURVEYED
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, north_west, within
from tiler.grid.block import heights_in_units, pixels_of
from tiler.grid.block_surroundings import EditsNear
from tiler.grid.coarse import (
    AROUND,
    Piece,
    block_runs,
    blocks_of,
    blocks_under,
    cells_in,
    covered,
    label_block,
    padded_within,
)
from tiler.grid.steps import Counts, PixelsUnder, Position
from tiler.store import coarse_cells, coarse_window

PART_PIXELS = BLOCK_PIXELS
"""Side in pixels of the parts that are processed one at a time."""

NEAR = 2
"""Distance from a hole, in pixels, beyond which heights do not influence how it is filled."""


@dataclass(frozen=True)
class Void:
    """Void of a model: its areas in each block of coarse cells, and the digest of the rasters around it."""

    pieces: tuple[Piece, ...]
    around: str


def find_voids(heights: PixelsUnder, survey: Float32, place: Position) -> tuple[Int32, Counts]:
    """Label the holes of a raster of heights in one block of coarse cells.

    Cells of a hole contain, or lie within, a pixel
    without a height inside the survey. Cells that touch belong to one hole.

    Parameters
    ----------
    heights : PixelsUnder
        Model.
    survey : float32 (height + 2 margin, width + 2 margin)
        Survey. Twice the margin is not less than the side of a pixel if pixels are larger than cells.
    place : Position

    Returns
    -------
    labels : int32 (height, width)
        Labels from 1, which differ from block to block; 0 in cells without a hole.
    counts : dict
        ``sides`` and ``labels``: labels along the sides of the block, and their number (`tiler.grid.coarse`).
        ``blocks``: for each label, runs of the nearby blocks of the model (`block_runs`).
    """
    coarse, pixels, block = place.spec, place.sources.pixels, place.block
    if pixels.lattice.size > coarse.lattice.size:
        empty = _within_large_pixels(heights, survey, place)
    else:
        margin = (len(survey) - block.height) // 2
        inner = survey[margin : margin + block.height, margin : margin + block.width]
        empty = _around_small_pixels(heights, place) & (inner >= SURVEYED)
    labels, sides = label_block(empty, corners=True)
    blocks = []
    for number, (down, right) in enumerate(scipy.ndimage.find_objects(labels), start=1):
        box = Block(
            block.row + down.start,
            block.col + right.start,
            down.stop - down.start,
            right.stop - right.start,
        )
        hole_mask = labels[down, right] == number
        blocks.append(block_runs(hole_mask, coarse.window(box), pixels, BLOCK_PIXELS, NEAR))
    return labels, {"sides": sides, "labels": len(blocks), "blocks": blocks}


def _around_small_pixels(heights: PixelsUnder, place: Position) -> Bool:
    """Return a mask of the cells of a block that contain the centre of an empty pixel."""
    coarse, spec, block = place.spec, place.sources.pixels, place.block
    empty = np.zeros((block.height, block.width), np.bool_)
    for part in blocks_under(coarse, spec, block, PART_PIXELS):
        rows, cols = np.nonzero(_without_height(heights, part))
        if len(rows):
            cell_rows, cell_cols = coarse_cells(coarse, spec, part)
            cells = cell_rows[rows] - block.row, cell_cols[cols] - block.col
            in_block = (
                (cells[0] >= 0)
                & (cells[0] < block.height)
                & (cells[1] >= 0)
                & (cells[1] < block.width)
            )
            empty[cells[0][in_block], cells[1][in_block]] = True
    return empty


def _within_large_pixels(heights: PixelsUnder, survey: Float32, place: Position) -> Bool:
    """Return a mask of the cells of a block whose centre lies in an empty pixel with its centre in the survey."""
    coarse, spec, block = place.spec, place.sources.pixels, place.block
    empty = np.zeros((block.height, block.width), np.bool_)
    window = covered(coarse, spec, block)
    if window.height <= 0 or window.width <= 0:
        return empty
    margin = (len(survey) - block.height) // 2
    rows, cols = coarse_cells(coarse, spec, window)
    at_centre = survey[np.ix_(rows - block.row + margin, cols - block.col + margin)]
    void = _without_height(heights, window) & (at_centre >= SURVEYED)
    rows, cols = coarse_cells(spec, coarse, block)
    rows, cols = rows - window.row, cols - window.col
    down = np.flatnonzero((rows >= 0) & (rows < window.height))
    right = np.flatnonzero((cols >= 0) & (cols < window.width))
    empty[np.ix_(down, right)] = void[np.ix_(rows[down], cols[right])]
    return empty


def fill_voids(
    heights: PixelsUnder,
    cells: PixelsUnder,
    place: Position,
    *,
    voids: tuple[Void, ...] = (),
) -> tuple[Float32, Counts]:
    """Return one block of a model with its holes filled.

    Heights are linear on the TIN of the centres of all pixels around a hole, with heights
    rounded to counts. Pixels outside all facets, as in a hole that is open to one side, stay
    without a height.

    Parameters
    ----------
    heights : PixelsUnder
        Model.
    cells : PixelsUnder
        Coarse cells with the labels of `find_voids`.
    place : Position
    voids : tuple of Void
        Voids that may touch the block.

    Returns
    -------
    heights : float32 (height, width)
        `NODATA` for pixels without a height.
    counts : dict
        It is empty.
    """
    spec, block = place.spec, place.block
    values = heights.read(block)
    empty = values == np.float32(NODATA)
    for void in voids:
        inside = empty & _pixels_in_void(cells, spec, void, block)
        if inside.any():
            rim = _rim(heights, cells, place, void)
            raster = rasterise(Tin.build(*rim), pixels_of(spec, block, place.frame.origin))
            values = np.where(inside, heights_in_units(raster.heights), values)
    return values, {}


def _without_height(heights: PixelsUnder, block: Block) -> Bool:
    mask: Bool = heights.read(block) == np.float32(NODATA)
    return mask


def _pixels_in_void(cells: PixelsUnder, spec: RasterSpec, void: Void, block: Block) -> Bool:
    """Return a mask of the pixels of a block whose centres lie in the coarse cells of a void."""
    window = coarse_window(cells.spec, spec, block)
    in_void = cells_in(cells.read(window), window, void.pieces)
    rows, cols = coarse_cells(cells.spec, spec, block)
    return in_void[np.ix_(rows - window.row, cols - window.col)]


def _rim(
    heights: PixelsUnder, cells: PixelsUnder, place: Position, void: Void
) -> tuple[Int32, Int32, Int32]:
    """Return the local counts x, y, z of the centres of the pixels with a height that touch a hole."""
    spec, coarse = place.spec, cells.spec
    cores: set[Block] = set()
    for area in void.pieces:
        window = coarse.block_at(area.row, area.col, BLOCK_PIXELS)
        runs = block_runs(
            cells.read(window) == area.label, coarse.window(window), spec, PART_PIXELS, 1
        )
        cores.update(blocks_of(runs, spec, PART_PIXELS))
    rim_parts = [
        _rim_of_part(heights, cells, spec, void, part) for part in sorted(cores, key=north_west)
    ]
    x, y, z = np.concatenate([np.empty((3, 0), np.int64), *rim_parts], axis=1)
    east, north = place.frame.origin
    return (x - east).astype(np.int32), (y - north).astype(np.int32), z.astype(np.int32)


def _rim_of_part(
    heights: PixelsUnder, cells: PixelsUnder, spec: RasterSpec, void: Void, core: Block
) -> Int64:
    """Return the absolute counts (3, n) of the rim's pixels in ``core``, including those beside holes outside it."""
    wide = padded_within(core, 1, spec)
    in_void = _pixels_in_void(cells, spec, void, wide)
    if not in_void.any():
        return np.empty((3, 0), np.int64)
    values = heights.read(wide)
    known = values != np.float32(NODATA)
    rim = scipy.ndimage.binary_dilation(in_void & ~known, AROUND) & known
    in_core = within(core, wide)
    rows, cols = np.nonzero(rim[in_core])
    x, y = spec.axes(core)
    z = np.rint(values[in_core][rows, cols].astype(np.float64) * COUNTS_PER_UNIT)
    return np.stack((x[cols], y[rows], z.astype(np.int64)))


CELL_PIXELS = 32
"""Side in pixels of the cells that summarize holes. They keep a block's record small for holes
of any shape."""

LEAVE_HOLES = (NOT_GROUND, TO_GROUND, VOID)
"""Actions of edits that can leave pixels without a height."""


def holes_of_block(known: Bool, surveyed: Bool, edits: EditsNear, area: Bool) -> Counts:
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
        request. ``holes``: all other holes, see `hole_cells`. ``edit_holes``: key of each edit, and count of
        the holes in it.
    """
    outside, in_area = ~(surveyed & area), area[1:-1, 1:-1]
    surveyed = surveyed[1:-1, 1:-1]
    holes = ~known & surveyed & in_area
    asked, counts = np.zeros_like(holes), []
    for edit in edits.of(LEAVE_HOLES):
        part = edits.spec.part(edits.block, edit.area.bounds)
        inside, part_in_block = edits.spec.inside(part, edit.area), within(part, edits.block)
        counts.append([edit.key, int(np.count_nonzero(inside & holes[part_in_block]))])
        if edit.action == VOID:
            asked[part_in_block] |= inside
    return {
        "surveyed": int(np.count_nonzero((known | surveyed) & in_area)),
        "voided": int(np.count_nonzero(holes & asked)),
        "holes": hole_cells(holes & ~asked, edits.block, outside),
        "edit_holes": counts,
    }


def hole_cells(holes: Bool, block: Block, outside: Bool) -> list[list[int]]:
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
    return counts_and_extents.T.tolist()
