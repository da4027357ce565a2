"""Fills voids inside the survey from the TIN of each void's rim.

No halo bounds the facets over a hole, so holes are found in the whole run, by coarse cells, and each is filled from all
pixels with a height that touch it, whichever blocks they lie in. The triangulation is unique, so blocks do not show.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ptd.tin import Tin, rasterise
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Lattice
from tiler.core.products import SURVEYED
from tiler.core.raster import BLOCK_PIXELS, NODATA, Block, RasterSpec
from tiler.grid.block import edit_heights, heights_in_units, pixels_of
from tiler.grid.checksum import checksum
from tiler.grid.survey import Bools, block_runs, blocks_of, coarse_cells, coarse_values, covered
from tiler.schedule import NOT_IN_DIGEST
from tiler.store import TileStore, open_store

Int32 = npt.NDArray[np.int32]

PIECE = BLOCK_PIXELS
"""Side in pixels of the pieces that are processed one at a time."""

NEAR = 2
"""Pixels: heights farther from a hole have no influence on how it is filled."""

AROUND = np.ones((3, 3), np.bool_)


@dataclass(frozen=True)
class VoidRasters:
    """The rasters that say where a model has voids.

    Attributes
    ----------
    heights : str
        The model.
    spec : RasterSpec
        Of its pixels.
    survey : str
    coarse : RasterSpec
        Of the cells of the survey.
    numbers : str
        The raster of the same cells with the number of the void in each.
    """

    heights: str
    spec: RasterSpec
    survey: str
    coarse: RasterSpec
    numbers: str


@dataclass(frozen=True)
class Void:
    """A void of a model: its number from 1 on, and the window of coarse cells that it lies in."""

    number: int
    cells: Block


@dataclass(frozen=True)
class FillBlock:
    """A block of a model with its voids filled.

    Attributes
    ----------
    name : str
    block : Block
    rasters : VoidRasters
    voids : tuple of Void
        Those that may touch the block.
    edits : str or None
        Key in the store of corrections of heights; which of them touch a block is in its digest.
    """

    name: str
    block: Block
    rasters: VoidRasters
    voids: tuple[Void, ...]
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the block."""
        return self.rasters.spec.block_bounds(self.block)


def find_voids(store_url: str, work: VoidRasters) -> dict[str, Any]:
    """Number the holes of a raster of heights; a `tiler.schedule.task.Work`.

    Coarse cells that hold a pixel without a height inside of the survey; those that touch belong to one hole. Writes
    the raster ``numbers`` of the cells: number of the hole, 0 for none.

    Returns
    -------
    dict
        ``voids``: row, column, height and width of each hole in cells, from number 1 on; ``blocks``: of each the
        blocks of the raster that it comes within `NEAR` pixels of, as `block_runs` gives them; ``checksum``.
    """
    store, spec, coarse = open_store(store_url), work.spec, work.coarse
    empty = np.zeros((coarse.height, coarse.width), np.bool_)
    survey = store.read_block(work.survey, Block(0, 0, coarse.height, coarse.width)) >= SURVEYED
    for block in blocks_of(block_runs(survey, coarse, spec, PIECE), spec, PIECE):
        rows, cols = np.nonzero(_void(store, work, block))
        if len(rows):
            cell_rows, cell_cols = coarse_cells(coarse, spec, block)
            empty[cell_rows[rows], cell_cols[cols]] = True
    numbers, _ = scipy.ndimage.label(empty, AROUND)
    values = numbers.astype(np.float32)
    for b in coarse.blocks(BLOCK_PIXELS):
        store.write_block(work.numbers, b, values[b.row : b.row + b.height, b.col : b.col + b.width])
    boxes, blocks = [], []
    for number, (down, right) in enumerate(scipy.ndimage.find_objects(numbers), start=1):
        box = Block(down.start, right.start, down.stop - down.start, right.stop - right.start)
        boxes.append([box.row, box.col, box.height, box.width])
        blocks.append(block_runs(numbers[down, right] == number, _part(coarse, box), spec, PIECE, NEAR))
    return {"voids": boxes, "blocks": blocks, "checksum": checksum(values)}


def _part(spec: RasterSpec, block: Block) -> RasterSpec:
    """A window of a raster as a raster of its own."""
    return RasterSpec(spec.lattice, spec.west + block.col, spec.north - block.row, block.height, block.width)


def fill_block(store_url: str, work: FillBlock) -> dict[str, Any]:
    """Write one block of the heights with holes filled; a `tiler.schedule.task.Work`.

    Linear on the TIN of the centres of all pixels around a hole, their heights rounded to counts. What no facet covers,
    where a hole is open to one side, stays without.

    Returns
    -------
    dict
        ``pixels``, ``filled`` (pixels with a height), ``added``; ``checksum``.
    """
    store, block, rasters = open_store(store_url), work.block, work.rasters
    heights = store.read_block(rasters.heights, block)
    empty = _void(store, rasters, block)
    before = int(np.count_nonzero(heights != np.float32(NODATA)))
    numbers = coarse_values(store, rasters.numbers, rasters.coarse, rasters.spec, block)
    for void in work.voids:
        inside = empty & (numbers == void.number)
        if inside.any():
            rim = _rim(store, rasters, void)
            raster = rasterise(Tin.build(*rim), pixels_of(rasters.spec, block, store.meta.frame.origin))
            heights = np.where(inside, heights_in_units(raster.heights), heights)
    edit_heights(store, work.edits, rasters.spec, block, heights)
    store.write_block(work.name, block, heights)
    after = int(np.count_nonzero(heights != np.float32(NODATA)))
    return {"pixels": heights.size, "filled": after, "added": after - before, "checksum": checksum(heights)}


def _void(store: TileStore, rasters: VoidRasters, block: Block) -> npt.NDArray[np.bool_]:
    """Pixels without a height inside of the survey."""
    empty: npt.NDArray[np.bool_] = store.read_block(rasters.heights, block) == np.float32(NODATA)
    if empty.any():
        empty &= coarse_values(store, rasters.survey, rasters.coarse, rasters.spec, block) >= SURVEYED
    return empty


def _rim(store: TileStore, rasters: VoidRasters, void: Void) -> tuple[Int32, Int32, Int32]:
    """Local counts x, y, z of the centres of the pixels with a height that touch a hole, piece by piece."""
    found: list[npt.NDArray[np.int64]] = [np.empty((3, 0), np.int64)]
    region = covered(rasters.coarse, rasters.spec, void.cells, 1)
    mine: Bools = store.read_block(rasters.numbers, void.cells) == void.number
    part = _part(rasters.spec, region)
    for piece in blocks_of(block_runs(mine, _part(rasters.coarse, void.cells), part, PIECE, 1), part, PIECE):
        core = Block(region.row + piece.row, region.col + piece.col, piece.height, piece.width)
        found.append(_rim_of_piece(store, rasters, void.number, core))
    x, y, z = np.concatenate(found, axis=1)
    east, north = store.meta.frame.origin
    return (x - east).astype(np.int32), (y - north).astype(np.int32), z.astype(np.int32)


def _rim_of_piece(store: TileStore, rasters: VoidRasters, number: int, core: Block) -> npt.NDArray[np.int64]:
    """Absolute counts (3, n) of the rim's pixels in ``core``; its neighbours' empty pixels count as well."""
    spec = rasters.spec
    top, left = max(core.row - 1, 0), max(core.col - 1, 0)
    bottom, right = min(core.row + core.height + 1, spec.height), min(core.col + core.width + 1, spec.width)
    wide = Block(top, left, bottom - top, right - left)
    mine = coarse_values(store, rasters.numbers, rasters.coarse, spec, wide) == number
    if not mine.any():
        return np.empty((3, 0), np.int64)
    heights = store.read_block(rasters.heights, wide)
    void = mine & _void(store, rasters, wide)
    rim = scipy.ndimage.binary_dilation(void, AROUND) & (heights != np.float32(NODATA))
    rows, cols = np.nonzero(rim)
    rows, cols = rows + wide.row, cols + wide.col
    inside = (rows >= core.row) & (rows < core.row + core.height)
    inside &= (cols >= core.col) & (cols < core.col + core.width)
    rows, cols = rows[inside], cols[inside]
    p, q = spec.lattice.p, 2 * spec.lattice.q
    x, y = ((2 * (spec.west + cols) + 1) * p) // q, ((2 * (spec.north - 1 - rows) + 1) * p) // q
    z = np.rint(heights[rows - wide.row, cols - wide.col].astype(np.float64) * COUNTS_PER_UNIT)
    return np.stack((x, y, z.astype(np.int64)))
