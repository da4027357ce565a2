"""Voids inside the survey, filled from the TIN of the pixels around each void.

A halo of any width may be too small for the facets over a hole. So holes are found by coarse
cells, block by block, and joined. Each hole is filled from all pixels with a height that touch
it, in whichever block they lie. The triangulation is unique, so borders of blocks are not
visible.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy

from ptd.tin import Tin, rasterise
from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Lattice
from tiler.core.products import SURVEYED
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec, north_west
from tiler.grid.block import edit_heights, heights_in_units, pixels_of
from tiler.grid.checksum import checksum
from tiler.grid.coarse import Bools, block_runs, blocks_of, blocks_under
from tiler.grid.pieces import AROUND, Piece, cells_of, label_block
from tiler.grid.records import FilledRecord, HolesRecord
from tiler.grid.work import BlockWork
from tiler.store import TileStore, coarse_cells, coarse_values, coarse_window, open_store

Int32 = npt.NDArray[np.int32]

PART_PIXELS = BLOCK_PIXELS
"""Side in pixels of the parts that are processed one at a time."""

NEAR = 2
"""Distance from a hole, in pixels, beyond which heights do not influence how it is filled."""


@dataclass(frozen=True)
class VoidRasters:
    """Rasters from which the voids of a model are found.

    Attributes
    ----------
    heights : str
        Raster of the model.
    spec : RasterSpec
        Raster of the model's pixels.
    survey : str
        Raster of the survey.
    coarse : RasterSpec
        Raster of the survey's cells.
    numbers : str
        Raster of the same cells with the label of the void in each. Labels differ from block to block.
    """

    heights: str
    spec: RasterSpec
    survey: str
    coarse: RasterSpec
    numbers: str


@dataclass(frozen=True, kw_only=True)
class FindVoids(BlockWork):
    """Arguments of `find_voids`: a block of coarse cells of ``rasters``."""

    rasters: VoidRasters


@dataclass(frozen=True)
class Void:
    """Void of a model: its areas in each block of coarse cells."""

    pieces: tuple[Piece, ...]


@dataclass(frozen=True)
class FillBlock:
    """Arguments of `fill_block`.

    Attributes
    ----------
    name : str
    block : Block
    rasters : VoidRasters
    voids : tuple of Void
        Voids that may touch the block.
    edits : str or None
        Key in the store of edits of heights. The digest includes those that touch the block.
    """

    name: str
    block: Block
    rasters: VoidRasters
    voids: tuple[Void, ...]
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)

    def place(self, buckets: Lattice) -> Bounds:
        """Return the bounds of the block."""
        return self.rasters.spec.block_bounds(self.block)


def find_voids(store_url: str, work: FindVoids) -> HolesRecord:
    """Label the holes of a raster of heights in one block of coarse cells.

    This is a `tiler.schedule.task.Work`. Cells of a hole contain, or lie within, a pixel
    without a height inside the survey. Cells that touch belong to one hole.

    Returns
    -------
    HolesRecord
        Record of the block.
    """
    store, coarse, block = open_store(store_url), work.spec, work.block
    rasters, spec = work.rasters, work.rasters.spec
    if spec.lattice.size > coarse.lattice.size:
        empty = _within_large_pixels(store, rasters, block)
    else:
        empty = _around_small_pixels(store, rasters, block)
    labels, sides = label_block(empty, corners=True)
    values = labels.astype(np.float32)
    store.write_block(work.name, block, values)
    blocks = []
    for number, (down, right) in enumerate(scipy.ndimage.find_objects(labels), start=1):
        box = Block(
            block.row + down.start,
            block.col + right.start,
            down.stop - down.start,
            right.stop - right.start,
        )
        hole_mask = labels[down, right] == number
        blocks.append(block_runs(hole_mask, coarse.window(box), spec, BLOCK_PIXELS, NEAR))
    return HolesRecord(
        sides=sides,
        labels=len(blocks),
        blocks=blocks,
        filled=int(np.count_nonzero(values)),
        checksum=checksum(values),
    )


def _around_small_pixels(store: TileStore, rasters: VoidRasters, block: Block) -> Bools:
    """Return a mask of the cells of a block that contain the centre of an empty pixel."""
    coarse, spec = rasters.coarse, rasters.spec
    empty = np.zeros((block.height, block.width), np.bool_)
    for part in blocks_under(coarse, spec, block, PART_PIXELS):
        rows, cols = np.nonzero(_void(store, rasters, part))
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


def _within_large_pixels(store: TileStore, rasters: VoidRasters, block: Block) -> Bools:
    """Return a mask of the cells of a block whose centre lies in an empty pixel."""
    coarse, spec = rasters.coarse, rasters.spec
    empty = np.zeros((block.height, block.width), np.bool_)
    rows, cols = coarse_cells(spec, coarse, block)
    for part in blocks_under(coarse, spec, block, PART_PIXELS):
        void = _void(store, rasters, part)
        down = np.flatnonzero((rows >= part.row) & (rows < part.row + part.height))
        right = np.flatnonzero((cols >= part.col) & (cols < part.col + part.width))
        empty[np.ix_(down, right)] = void[np.ix_(rows[down] - part.row, cols[right] - part.col)]
    return empty


def fill_block(store_url: str, work: FillBlock) -> FilledRecord:
    """Write one block of the heights with holes filled. This is a `tiler.schedule.task.Work`.

    Heights are linear on the TIN of the centres of all pixels around a hole, with heights
    rounded to counts. Pixels outside all facets, as in a hole that is open to one side, stay
    without a height.

    Returns
    -------
    FilledRecord
        Record of the block.
    """
    store, block, rasters = open_store(store_url), work.block, work.rasters
    heights = store.read_block(rasters.heights, block)
    empty = _void(store, rasters, block)
    filled_before = int(np.count_nonzero(heights != np.float32(NODATA)))
    for void in work.voids:
        inside = empty & _pixels_in_void(store, rasters, void, block)
        if inside.any():
            rim = _rim(store, rasters, void)
            raster = rasterise(
                Tin.build(*rim), pixels_of(rasters.spec, block, store.meta.frame.origin)
            )
            heights = np.where(inside, heights_in_units(raster.heights), heights)
    edit_heights(store, work.edits, rasters.spec, block, heights)
    store.write_block(work.name, block, heights)
    after = int(np.count_nonzero(heights != np.float32(NODATA)))
    return FilledRecord(
        pixels=heights.size,
        filled=after,
        added=after - filled_before,
        checksum=checksum(heights),
    )


def _void(store: TileStore, rasters: VoidRasters, block: Block) -> npt.NDArray[np.bool_]:
    """Return a mask of the pixels without a height inside the survey."""
    empty: npt.NDArray[np.bool_] = store.read_block(rasters.heights, block) == np.float32(
        NODATA
    )
    if empty.any():
        empty &= (
            coarse_values(store, rasters.survey, rasters.coarse, rasters.spec, block)
            >= SURVEYED
        )
    return empty


def _pixels_in_void(store: TileStore, rasters: VoidRasters, void: Void, block: Block) -> Bools:
    """Return a mask of the pixels of a block in the coarse cells of a void."""
    window = coarse_window(rasters.coarse, rasters.spec, block)
    cells = cells_of(store, rasters.numbers, rasters.coarse, window, void.pieces)
    rows, cols = coarse_cells(rasters.coarse, rasters.spec, block)
    return cells[np.ix_(rows - window.row, cols - window.col)]


def _rim(store: TileStore, rasters: VoidRasters, void: Void) -> tuple[Int32, Int32, Int32]:
    """Return the local counts x, y, z of the centres of the pixels with a height that touch a hole."""
    spec, coarse = rasters.spec, rasters.coarse
    cores: set[Block] = set()
    for area in void.pieces:
        cells = coarse.block_at(area.row, area.col, BLOCK_PIXELS)
        piece_mask = store.read_block(rasters.numbers, cells) == area.label
        cores.update(
            blocks_of(
                block_runs(piece_mask, coarse.window(cells), spec, PART_PIXELS, 1),
                spec,
                PART_PIXELS,
            )
        )
    rim_parts = [
        _rim_of_part(store, rasters, void, part) for part in sorted(cores, key=north_west)
    ]
    x, y, z = np.concatenate([np.empty((3, 0), np.int64), *rim_parts], axis=1)
    east, north = store.meta.frame.origin
    return (x - east).astype(np.int32), (y - north).astype(np.int32), z.astype(np.int32)


def _rim_of_part(
    store: TileStore, rasters: VoidRasters, void: Void, core: Block
) -> npt.NDArray[np.int64]:
    """Return the absolute counts (3, n) of the rim's pixels in ``core``, including those beside holes outside it."""
    spec = rasters.spec
    top, left = max(core.row - 1, 0), max(core.col - 1, 0)
    bottom, right = (
        min(core.row + core.height + 1, spec.height),
        min(core.col + core.width + 1, spec.width),
    )
    wide = Block(top, left, bottom - top, right - left)
    hole_cells_mask = _pixels_in_void(store, rasters, void, wide)
    if not hole_cells_mask.any():
        return np.empty((3, 0), np.int64)
    heights = store.read_block(rasters.heights, wide)
    empty = hole_cells_mask & _void(store, rasters, wide)
    rim = scipy.ndimage.binary_dilation(empty, AROUND) & (heights != np.float32(NODATA))
    rows, cols = np.nonzero(rim)
    rows, cols = rows + wide.row, cols + wide.col
    inside = (rows >= core.row) & (rows < core.row + core.height)
    inside &= (cols >= core.col) & (cols < core.col + core.width)
    rows, cols = rows[inside], cols[inside]
    p, q = spec.lattice.p, 2 * spec.lattice.q
    x, y = ((2 * (spec.west + cols) + 1) * p) // q, ((2 * (spec.north - 1 - rows) + 1) * p) // q
    z = np.rint(heights[rows - wide.row, cols - wide.col].astype(np.float64) * COUNTS_PER_UNIT)
    return np.stack((x, y, z.astype(np.int64)))
