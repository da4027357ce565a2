"""Heights of coarse cells for the search for water, from the terrain or from points of class water."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.classes import WATER
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, NODATA
from tiler.grid.block_surroundings import PointsNear, pixel_indices
from tiler.grid.coarse import blocks_under, padded
from tiler.grid.ground import surface_points
from tiler.grid.steps import Counts, PixelsUnder, Position
from tiler.store import coarse_cells

Float32 = npt.NDArray[np.float32]
Floats = npt.NDArray[np.float64]

NEAR_CELLS = 8
"""A cell without returns is water if the nearest cell with returns is water and at most this
far away, in cells."""


def ground_cells(
    heights: PixelsUnder,
    occupancy: Float32,
    points: PointsNear,
    place: Position,
    *,
    is_wet: bool,
) -> tuple[Floats, Counts]:
    """Return the mean height of each cell of a block in units of the CRS, `NODATA` without one.

    In cells that are water by the input, heights are those of the points of class water. In
    other cells, heights are those of the terrain. Only whole counts are added, so that sums do
    not depend on the order of pixels or points.

    Parameters
    ----------
    heights : PixelsUnder
        Terrain.
    occupancy : float32 (height + 2 `NEAR_CELLS`, width + 2 `NEAR_CELLS`)
        Number of points in each cell, negative in cells that are water by the input.
    points : PointsNear
    place : Position
    is_wet : bool
        Whether the input has points of class water near the block.
    """
    spec, block = place.spec, place.block
    size = block.height * block.width
    total, number = np.zeros(size), np.zeros(size, np.int64)
    for piece in blocks_under(spec, heights.spec, block, BLOCK_PIXELS):
        values = heights.read(piece)
        rows, cols = coarse_cells(spec, heights.spec, piece)
        rows, cols = rows - block.row, cols - block.col
        in_rows = (rows >= 0) & (rows < block.height)
        in_cols = (cols >= 0) & (cols < block.width)
        known = (values != np.float32(NODATA)) & in_rows[:, None] & in_cols
        cell_indices = (rows[:, None] * block.width + cols)[known]
        total += np.bincount(
            cell_indices, np.rint(values[known].astype(np.float64) * COUNTS_PER_UNIT), size
        )
        number += np.bincount(cell_indices, minlength=size)
    mean = _means(total, number).reshape(block.height, block.width)
    if is_wet:
        water = _water_class_heights(points, occupancy)
        mean = np.where(water == NODATA, mean, water)
    return mean, {}


def _means(total: Floats, number: npt.NDArray[np.int64]) -> Floats:
    """Convert sums of heights in counts to means in units of the CRS, `NODATA` for cells without heights."""
    means = np.full(total.shape, NODATA)
    np.divide(total, number * COUNTS_PER_UNIT, out=means, where=number > 0)
    return means


def _water_class_heights(points: PointsNear, returns: Float32) -> Floats:
    """Return the mean height of the points of class water for each cell that is water by the input, or `NODATA`.

    A cell without returns is water if the nearest cell with returns is water and near. It gets
    the height of that cell.
    """
    window, store = padded(points.block, NEAR_CELLS), points.store
    total, number = np.zeros(returns.size), np.zeros(returns.size, np.int64)
    bounds, origin = points.spec.block_bounds(window), points.frame.origin
    for bucket in store.buckets_within(bounds):
        surface, chosen = surface_points(store, points.rule, bucket)
        if surface.classification is None:
            continue
        chosen &= surface.inside(bounds, origin) & (surface.classification == WATER)
        xyz = surface.xyz[:, chosen]
        cell_indices = pixel_indices(xyz, origin, points.spec, window)
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
