"""Heights of coarse cells for the search for water, from the terrain or from points of class water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.classes import WATER
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, NODATA, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.coarse import blocks_under, padded
from tiler.grid.ground import GroundSelection, surface_points
from tiler.grid.points_near import pixel_indices
from tiler.grid.records import BlockRecord
from tiler.grid.work import BlockWork
from tiler.store import TileStore, coarse_cells, open_store, read_cells

Floats = npt.NDArray[np.float64]

NEAR_CELLS = 8
"""A cell without returns is water if the nearest cell with returns is water and at most this
far away, in cells."""


@dataclass(frozen=True, kw_only=True)
class GroundCells(BlockWork):
    """Arguments of `ground_cells`.

    Attributes
    ----------
    heights : str
        Raster of the terrain.
    pixels : RasterSpec
        Raster of the terrain's pixels.
    occupancy : str or None
        Raster of the number of points in each cell; None if the input has no points of class water near the block.
    rule : GroundSelection
    """

    heights: str
    pixels: RasterSpec
    occupancy: str | None
    rule: GroundSelection


def ground_cells(store_url: str, work: GroundCells) -> BlockRecord:
    """Write the mean height of each cell of a block in units of the CRS. This is a `tiler.schedule.task.Work`.

    In cells that are water by the input, heights are those of the points of class water. In
    other cells, heights are those of the terrain. Only whole counts are added, so that sums do
    not depend on the order of pixels or points.

    Returns
    -------
    BlockRecord
        Record of the block. ``filled`` is the number of cells with a height.
    """
    store, block = open_store(store_url), work.block
    size = block.height * block.width
    total, number = np.zeros(size), np.zeros(size, np.int64)
    for piece in blocks_under(work.spec, work.pixels, block, BLOCK_PIXELS):
        heights = store.read_block(work.heights, piece)
        rows, cols = coarse_cells(work.spec, work.pixels, piece)
        rows, cols = rows - block.row, cols - block.col
        in_rows = (rows >= 0) & (rows < block.height)
        in_cols = (cols >= 0) & (cols < block.width)
        known = (heights != np.float32(NODATA)) & in_rows[:, None] & in_cols
        cell_indices = (rows[:, None] * block.width + cols)[known]
        total += np.bincount(
            cell_indices, np.rint(heights[known].astype(np.float64) * COUNTS_PER_UNIT), size
        )
        number += np.bincount(cell_indices, minlength=size)
    mean = _means(total, number).reshape(block.height, block.width)
    if work.occupancy is not None:
        water = _water_class_heights(store, work, work.occupancy)
        mean = np.where(water == NODATA, mean, water)
    values = mean.astype(np.float32)
    store.write_block(work.name, block, values)
    return BlockRecord(
        filled=int(np.count_nonzero(values != np.float32(NODATA))), checksum=checksum(values)
    )


def _means(total: Floats, number: npt.NDArray[np.int64]) -> Floats:
    """Convert sums of heights in counts to means in units of the CRS, `NODATA` for cells without heights."""
    means = np.full(total.shape, NODATA)
    np.divide(total, number * COUNTS_PER_UNIT, out=means, where=number > 0)
    return means


def _water_class_heights(store: TileStore, work: GroundCells, occupancy: str) -> Floats:
    """Return the mean height of the points of class water for each cell that is water by the input, or `NODATA`.

    A cell without returns is water if the nearest cell with returns is water and near. It gets
    the height of that cell.
    """
    window = padded(work.block, NEAR_CELLS)
    returns = read_cells(store, occupancy, work.spec, window)
    total, number = np.zeros(returns.size), np.zeros(returns.size, np.int64)
    bounds, origin = work.spec.block_bounds(window), store.meta.frame.origin
    for bucket in store.buckets_within(bounds):
        points, chosen = surface_points(store, work.rule, bucket)
        if points.classification is None:
            continue
        chosen &= points.inside(bounds, origin) & (points.classification == WATER)
        xyz = points.xyz[:, chosen]
        cell_indices = pixel_indices(xyz, origin, work.spec, window)
        total += np.bincount(cell_indices, xyz[2], returns.size)
        number += np.bincount(cell_indices, minlength=returns.size)
    mean = _means(total, number).reshape(returns.shape)
    heights = np.full(returns.shape, NODATA)
    if (returns != 0).any():
        distance, near = scipy.ndimage.distance_transform_edt(returns == 0, return_indices=True)
        # The number of returns is negative in cells that are water by the input.
        water = (returns[tuple(near)] < 0) & (distance <= NEAR_CELLS)
        heights[water] = mean[tuple(near)][water]
    return heights[NEAR_CELLS:-NEAR_CELLS, NEAR_CELLS:-NEAR_CELLS]
