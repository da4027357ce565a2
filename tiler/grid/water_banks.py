"""Correction of the shore by points, in cells that are finer than the coarse cells in which water is found.

The shore runs between the middles of coarse cells. At an upright bank, a coarse cell has both
bank and water. So the polygon of the water may include ground high above the level, or miss a
strip of water at the foot of a quay. In fine cells, high ground is land if it is connected with
the bank. Fine cells of a quay are water if they have no points, or ground at the level.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.lattice import Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.core.raster import within as within_window
from tiler.grid.block_surroundings import pixel_indices
from tiler.grid.coarse import Bools, Float64, padded, within, within_square
from tiler.grid.ground import read_ground_and_objects
from tiler.grid.records import GroundSelection
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_extent import LEVEL_M
from tiler.grid.water_search import inner_window
from tiler.grid.water_shore import quays, shore_polygons
from tiler.store import TileStore

FINER = 2
"""A coarse cell has this many fine cells along its side.

Fine cells are usually 1 m wide. With 2 points per m2, six of seven of them have a point.
"""
HIGH_M = 0.3
"""Ground in a fine cell is land if it is more than this above the water, in metres. Broken
water is lower."""
BANK_REACH_FINE_CELLS = 4
"""High ground becomes land only up to this distance from cells that are already land, in fine
cells."""
BANK_MARGIN = math.ceil(2 * BANK_REACH_FINE_CELLS / FINER)
"""The fine cells of a block depend on cells up to this distance from the block, in coarse
cells."""
ENOUGH_POINTS = 5
"""A fine cell without points is water only if fine cells of the land near it have this many points on average.

By chance, 1 % of such cells are empty.
"""
NEAR_SIDE = 11
"""The highest level near a cell is the highest in a square of this side, in coarse cells.

The mean number of points of land near a cell also comes from such a square.
"""
AROUND = np.ones((3, 3), np.bool_)


class Shore(NamedTuple):
    """Water and its surroundings in the coarse cells of a window, in arrays of the shape of the window.

    Attributes
    ----------
    field : float64
        Heights above the water in metres, negative in the water, see `tiler.grid.water_shore.heights_above_water`.
    level : float64
        Highest level of the water in the `NEAR_SIDE` square around each cell in metres, NaN for cells whose ground is
        not a bank.
    is_dense_quay : bool
        Mask of the cells at upright banks whose land has many points, see `dense_quays`.
    """

    field: Float64
    level: Float64
    is_dense_quay: Bools


class ShoreDetails(NamedTuple):
    """Details of a shore that fine cells show, as shapes in absolute counts.

    Attributes
    ----------
    dry : shapely.Geometry or None
        Part of the water of the coarse cells that is land.
    wet : shapely.Geometry or None
        Part of the land of the coarse cells that is water.
    """

    dry: Any
    wet: Any


NO_DETAILS = ShoreDetails(None, None)


def shore_details(
    store: TileStore, rule: GroundSelection, coarse: RasterSpec, window: Block, shore: Shore
) -> ShoreDetails:
    """Return the details of the shore of the coarse cells, from the points at the shore.

    Parameters
    ----------
    store : TileStore
    rule : GroundSelection
    coarse : RasterSpec
        Raster of the coarse cells.
    window : Block
        Block with a margin of `BANK_MARGIN` coarse cells.
    shore : Shore
    """
    fine, fine_window = finer_raster(coarse), finer_window(window)
    field = finer_field(shore.field)
    ground, has_points = fine_cells(
        store, rule, fine, fine_window, _near_shore(field, BANK_REACH_FINE_CELLS)
    )
    above = ground - each_finer(shore.level)
    banks = high_banks(field, above)
    water = quay_water(field, each_finer(shore.is_dense_quay), above, has_points)
    dry = _shape(banks, field >= 0, fine, fine_window)
    wet = _shape(water, field < 0, fine, fine_window)
    return ShoreDetails(dry, wet)


def _shape(cells: Bools, among: Bools, fine: RasterSpec, window: Block) -> Any:
    """Return the shape of some cells of a window, in absolute counts.

    The shape is extended over their neighbours in the mask ``among``. Otherwise it would end
    half a cell before the centres of these neighbours, and leave a gap.
    """
    import shapely

    neighbours = among & scipy.ndimage.binary_dilation(cells, AROUND)
    field = np.where(cells | neighbours, -1.0, 1.0)
    # The shape extends one coarse cell and one fine cell beyond the block.
    margin = FINER * (BANK_MARGIN - 1) - 1
    inner = padded(window, -margin)
    return shapely.union_all(shore_polygons(field[inner_window(inner, margin)], fine, inner))


def highest_near(level: Float64) -> Float64:
    """Return the highest level in the square around each cell.

    Some levels are too low, because a few points lie below the water surface.
    """
    highest: Float64 = scipy.ndimage.maximum_filter(level, NEAR_SIDE)
    return highest


def dense_quays(cells: WaterCells, wet: Bools, level: Float64) -> Bools:
    """Return a mask of the cells at upright banks near which fine cells of land have `ENOUGH_POINTS` on average.

    Parameters are those of `tiler.grid.water_shore.heights_above_water`.
    """

    def total(values: npt.NDArray[Any]) -> Float64:
        """Return the sum of whole numbers in the square around each cell."""
        mean = scipy.ndimage.uniform_filter(values.astype(np.float64), NEAR_SIDE)
        return np.asarray(np.rint(mean * NEAR_SIDE**2))

    n_points = total(np.where(wet, 0.0, cells.returns))
    is_dense = n_points >= FINER**2 * ENOUGH_POINTS * total(~wet)
    return np.asarray(is_dense & within(quays(cells, wet, level), math.sqrt(2)))


def finer_raster(coarse: RasterSpec) -> RasterSpec:
    """Return the raster of the fine cells."""
    lattice = Lattice(coarse.lattice.size / FINER)
    return RasterSpec(
        lattice,
        coarse.west * FINER,
        coarse.north * FINER,
        coarse.height * FINER,
        coarse.width * FINER,
    )


def finer_window(window: Block) -> Block:
    """Return the fine cells of a window of coarse cells."""
    return Block(
        window.row * FINER, window.col * FINER, window.height * FINER, window.width * FINER
    )


def finer_field(field: Float64) -> Float64:
    """Interpolate a field linearly between the middles of coarse cells, float64 (2 h, 2 w)."""
    for axis in (0, 1):
        cells = np.moveaxis(field, axis, 0)
        cells = np.concatenate((cells[:1], cells, cells[-1:]))
        halves = [0.75 * cells[1:-1] + 0.25 * beside for beside in (cells[:-2], cells[2:])]
        both = np.stack(halves, axis=1).reshape(-1, cells.shape[1])
        field = np.moveaxis(both, 0, axis)
    return field


def each_finer(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Repeat the values of coarse cells in their fine cells."""
    return values.repeat(FINER, axis=0).repeat(FINER, axis=1)


def _near_shore(field: Float64, radius: int) -> Bools:
    """Return a mask of the cells that have both land and water within ``radius`` cells, also diagonally."""
    return within_square(field < 0, radius) & within_square(field >= 0, radius)


def fine_cells(
    store: TileStore, rule: GroundSelection, fine: RasterSpec, window: Block, selected: Bools
) -> tuple[Float64, Bools]:
    """Return the mean height of the ground points of each cell in metres, and a mask of the cells with points.

    Heights are NaN for cells without ground points. Points of objects also count for the mask. Only buckets with
    ``selected`` cells are read, so the results for other cells may be incomplete.
    """
    frame, bounds = store.meta.frame, fine.block_bounds(window)
    total, number, objects = np.zeros((3, window.height, window.width))
    for bucket in store.buckets_within(bounds):
        inside = store.meta.bucket.bounds(bucket).intersection(bounds)
        part = fine.part(window, inside)
        in_window = within_window(part, window)
        if not selected[in_window].any():
            continue
        ground, others = read_ground_and_objects(store, rule, inside)
        cells = pixel_indices(ground, frame.origin, fine, part)
        shape, size = (part.height, part.width), part.height * part.width
        total[in_window] += np.bincount(cells, ground[2].astype(np.float64), size).reshape(
            shape
        )
        number[in_window] += np.bincount(cells, minlength=size).reshape(shape)
        others_cells = pixel_indices(others, frame.origin, fine, part)
        objects[in_window] += np.bincount(others_cells, minlength=size).reshape(shape)
    heights = np.full(total.shape, np.nan)
    np.divide(total, number, out=heights, where=number > 0)
    return heights * float(frame.metres_z), number + objects > 0


def high_banks(field: Float64, above: Float64) -> Bools:
    """Return a mask of the cells of water with high ground that is connected with the land.

    Parameters
    ----------
    field : float64 (h, w)
        Heights above the water in metres, negative in the water.
    above : float64 (h, w)
        Mean height of the ground points above the water in metres, NaN if there are none.
    """
    land, high = field >= 0, above > HIGH_M
    return _spread(land, high, BANK_REACH_FINE_CELLS)


def quay_water(
    field: Float64, is_dense_quay: Bools, above: Float64, has_points: Bools
) -> Bools:
    """Return a mask of the cells at upright banks that are water and connected with the water.

    They have no points, because water returns few pulses, or their ground is at most `LEVEL_M`
    above the water.

    Parameters
    ----------
    field, above : float64 (h, w)
        See `high_banks`.
    is_dense_quay : bool (h, w)
        Mask of the cells at upright banks whose land has many points, see `dense_quays`.
    has_points : bool (h, w)
        Mask of the cells with points.
    """
    return _spread(field < 0, is_dense_quay & (~has_points | (above <= LEVEL_M)), FINER)


def _spread(start: Bools, over: Bools, reach: int) -> Bools:
    """Return a mask of the cells of ``over`` that are connected with ``start`` by at most ``reach`` steps."""
    return np.asarray(
        scipy.ndimage.binary_dilation(start, AROUND, reach, mask=start | over) & ~start
    )
