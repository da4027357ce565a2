"""Shore of a body of water: the line between cells at which the ground of the bank reaches the level.

The shore runs between the middles of coarse cells. At an upright bank, a coarse cell has both bank and water. So the
polygon of the water may include ground high above the level, or miss a strip of water at the foot of a quay. In fine
cells, high ground is land if it is connected with the bank. Fine cells of a quay are water if they have no points, or
ground at the level.

A lake may have been scanned at two water levels, in different flight strips. The lake gets the lower level. At this
level, the shore that was found is partly too high on the bank. So the bank is continued below the higher level, and
the shore lies where the bank reaches the lower level. The lower level is used only if the shore at this level lies in
the outermost cells of the water.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy
import shapely

from ptd.arrays import AnyArray, Bool, Float64
from tiler.core.lattice import Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.core.raster import within as within_window
from tiler.grid.block_surroundings import pixel_indices
from tiler.grid.coarse import AROUND, padded, within, within_square
from tiler.grid.ground import read_ground_and_objects
from tiler.grid.records import GroundSelection
from tiler.grid.river import MIN_PIXELS, SMOOTH_M
from tiler.grid.water_cells import WaterCells
from tiler.grid.water_extent import LEVEL_M
from tiler.grid.water_search import inner_window
from tiler.store import TileStore

REACH_CELLS = 40
"""The level of the water in a block depends on cells up to this distance from the block, in
cells."""
MAX_HEIGHT_M = 2.0
"""Heights relative to the level are clipped to at most this, above and below the level, in
metres."""
MIN_HEIGHT_M = 0.02
"""Heights relative to the level are clipped to at least this, above and below the level, in
metres."""
BANK_WIDTH_CELLS = 2
"""The outermost cells of the water may be bank: a border of this width, in cells.

With cells of 2 m, gravel that rises by 4 % has two cells below
`tiler.grid.water_extent.LEVEL_M`.
"""
UPRIGHT_M = 0.4
"""A bank is upright only if it is at least this high above the water, in metres.

The slope of lower banks is not known well.
"""
MAX_QUAY_SLOPE = 0.15
"""The land behind an upright bank is at most this steep."""
CUT_SHARE = 0.5
"""A cell at an upright bank is mostly water if it has less than this share of the returns of
the land behind it."""
SIDES = ((0, 1), (0, -1), (1, 1), (1, -1))
"""The four sides of a cell: axis and step with which `np.roll` moves the neighbour on this side
onto the cell."""


def heights_above_water(
    cells: WaterCells, wet: Bool, level: Float64 | None, is_lowered: bool = False
) -> Float64:
    """Return a field of heights relative to the level of the water. Its zero line is the shore.

    In cells of land next to water, the field has the height of the bank. In the outermost cells of the water, it has
    the height of the bank extrapolated below the level. Heights are clipped. In all other cells, the field is
    `MAX_HEIGHT_M` on land and ``-MAX_HEIGHT_M`` in the water, so without heights the shore lies halfway between cells.

    Parameters
    ----------
    cells : WaterCells
        Cells with smoothed heights, in a window with a margin of at least `REACH_CELLS`.
    wet : bool, shape of the cells
        Mask of the water.
    level : float64, shape of the cells
        Level of the water near each cell in metres, see `tiler.grid.water_extent.water_heights`; None if not known.
    is_lowered : bool
        Whether the level was lowered below the returns of the water. If so, the extrapolated bank replaces the heights
        of these returns.
    """
    if level is None:
        return np.where(wet, -MAX_HEIGHT_M, MAX_HEIGHT_M)
    above = cells.ground - level
    for _ in range(BANK_WIDTH_CELLS):
        banks, heights = _banks(above, wet, cells.returns > 0)
        if is_lowered:
            above[banks] = heights[banks]
        wet = wet & ~banks
    mostly_wet = _cut_cells(cells, above, wet)
    wet = wet | mostly_wet
    above[mostly_wet] = np.nan
    field = np.where(wet, -MAX_HEIGHT_M, MAX_HEIGHT_M)
    beside = ~wet & ~np.isnan(above) & scipy.ndimage.binary_dilation(wet, AROUND)
    field[beside] = np.clip(above[beside], MIN_HEIGHT_M, MAX_HEIGHT_M)
    beside_m, extrapolated_m = _extrapolated_bank(above, wet)
    outermost = ~np.isnan(extrapolated_m)
    # A high bank that hardly falls towards the water is upright, so the shore lies halfway
    # between the cells.
    is_upright = (extrapolated_m > beside_m / 2) & (beside_m > UPRIGHT_M)
    outer_heights = np.where(is_upright, -beside_m, extrapolated_m)
    field[outermost] = np.clip(outer_heights[outermost], -MAX_HEIGHT_M, -MIN_HEIGHT_M)
    return field


def _banks(above: Float64, wet: Bool, has_returns: Bool) -> tuple[Bool, Float64]:
    """Return a mask of the outermost cells of the water that are bank, and the heights of the bank there.

    In these cells, both the ground and the extrapolated bank are above the water. The ground
    alone is not enough: in a cell on the shore, the mean height may be above the water although
    the height in the middle is not.
    """
    _, extrapolated_m = _extrapolated_bank(above, wet)
    with np.errstate(invalid="ignore"):
        heights = np.minimum(above, extrapolated_m)
        return wet & has_returns & (heights > MIN_HEIGHT_M), heights


def _cut_cells(cells: WaterCells, above: Float64, wet: Bool) -> Bool:
    """Return a mask of the outermost cells of a high, level bank that are mostly water, as at a quay.

    Water returns few pulses. So such a cell has few returns compared to the mean of the next
    two cells of the bank.
    """
    land_returns = np.where(wet, 0.0, cells.returns)
    is_cut = np.zeros_like(wet)
    for axis, step, upright in _upright_sides(above, wet, cells.size_m):
        returns, next_returns = (np.roll(land_returns, n * step, axis) for n in (1, 2))
        few = cells.returns < CUT_SHARE * (returns + next_returns) / 2
        is_cut |= upright & few & (np.minimum(returns, next_returns) > 0)
    return is_cut


def _upright_sides(above: Float64, wet: Bool, size_m: float) -> Iterator[tuple[int, int, Bool]]:
    """Yield axis and step of each side (`SIDES`), and a mask of the cells with an upright bank on that side.

    The next two cells on that side are high, level bank. The next cell on the opposite side is
    water.
    """
    bank = np.where(wet, np.nan, above)
    for axis, step in SIDES:
        heights, next_heights = (np.roll(bank, n * step, axis) for n in (1, 2))
        with np.errstate(invalid="ignore"):
            upright = np.minimum(heights, next_heights) >= UPRIGHT_M
            upright &= np.abs(heights - next_heights) <= MAX_QUAY_SLOPE * size_m
        yield axis, step, upright & np.roll(wet, -step, axis) & ~wet


def _extrapolated_bank(above: Float64, wet: Bool) -> tuple[Float64, Float64]:
    """Return two heights above the water for each of its outermost cells, NaN for all other cells.

    The first is the height of the bank next to the cell. The second is the height in the cell
    itself, extrapolated from the two next cells of the bank. Both are means over the sides with
    bank.
    """
    bank = np.where(wet, np.nan, above)
    totals = np.zeros((2, *wet.shape))
    number = np.zeros(wet.shape, np.int64)
    for axis, step in SIDES:
        first, second = (
            np.clip(np.roll(bank, n * step, axis), MIN_HEIGHT_M, MAX_HEIGHT_M) for n in (1, 2)
        )
        extrapolated = 2 * first - second
        here = wet & ~np.isnan(extrapolated)
        totals[0, here] += first[here]
        totals[1, here] += np.clip(extrapolated[here], -MAX_HEIGHT_M, MAX_HEIGHT_M)
        number[here] += 1
    heights = np.full(totals.shape, np.nan)
    np.divide(totals, number, out=heights, where=number > 0)
    return heights[0], heights[1]


def shore_polygons(field: Float64, coarse: RasterSpec, window: Block) -> list[Any]:
    """Return polygons in absolute counts of the water of a window, where ``field`` is below 0.

    ``field`` is a result of `heights_above_water`.
    """
    from contourpy import FillType, contour_generator

    side = float(coarse.lattice.size)
    x = (coarse.west + window.col + np.arange(window.width) + 0.5) * side
    y = (coarse.north - window.row - np.arange(window.height) - 0.5) * side
    lines = contour_generator(x, y, field, fill_type=FillType.OuterOffset)
    outers, offsets = lines.filled(-2 * MAX_HEIGHT_M, 0.0)  # type: ignore[misc]
    polygons = []
    for vertices, starts in zip(outers, offsets, strict=True):
        rings = np.split(vertices, starts[1:-1])
        polygons.append(shapely.make_valid(shapely.Polygon(rings[0], rings[1:])))
    return polygons


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
    is_dense_quay: Bool


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
    fine, fine_window = _finer_raster(coarse), _finer_window(window)
    field = finer_field(shore.field)
    ground, has_points = _fine_cells(
        store, rule, fine, fine_window, _near_shore(field, BANK_REACH_FINE_CELLS)
    )
    above = ground - _each_finer(shore.level)
    banks = high_banks(field, above)
    water = quay_water(field, _each_finer(shore.is_dense_quay), above, has_points)
    dry = _shape(banks, field >= 0, fine, fine_window)
    wet = _shape(water, field < 0, fine, fine_window)
    return ShoreDetails(dry, wet)


def _shape(cells: Bool, among: Bool, fine: RasterSpec, window: Block) -> Any:
    """Return the shape of some cells of a window, in absolute counts.

    The shape is extended over their neighbours in the mask ``among``. Otherwise it would end
    half a cell before the centres of these neighbours, and leave a gap.
    """
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
    return scipy.ndimage.maximum_filter(level, NEAR_SIDE)


def dense_quays(cells: WaterCells, wet: Bool, level: Float64) -> Bool:
    """Return a mask of the cells at upright banks near which fine cells of land have `ENOUGH_POINTS` on average.

    Parameters are those of `tiler.grid.water_shore.heights_above_water`.
    """
    # Sums of whole numbers in the square around each cell.
    n_points, n_land = (
        np.rint(scipy.ndimage.uniform_filter(n.astype(np.float64), NEAR_SIDE) * NEAR_SIDE**2)
        for n in (np.where(wet, 0.0, cells.returns), ~wet)
    )
    is_dense = n_points >= FINER**2 * ENOUGH_POINTS * n_land
    sides = _upright_sides(cells.ground - level, wet, cells.size_m)
    is_quay = np.logical_or.reduce([upright for _, _, upright in sides])
    return np.asarray(is_dense & within(is_quay, math.sqrt(2)))


def _finer_raster(coarse: RasterSpec) -> RasterSpec:
    """Return the raster of the fine cells."""
    lattice = Lattice(coarse.lattice.size / FINER)
    return RasterSpec(
        lattice,
        coarse.west * FINER,
        coarse.north * FINER,
        coarse.height * FINER,
        coarse.width * FINER,
    )


def _finer_window(window: Block) -> Block:
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


def _each_finer(values: AnyArray) -> AnyArray:
    """Repeat the values of coarse cells in their fine cells."""
    return values.repeat(FINER, axis=0).repeat(FINER, axis=1)


def _near_shore(field: Float64, radius: int) -> Bool:
    """Return a mask of the cells that have both land and water within ``radius`` cells, also diagonally."""
    return within_square(field < 0, radius) & within_square(field >= 0, radius)


def _fine_cells(
    store: TileStore, rule: GroundSelection, fine: RasterSpec, window: Block, selected: Bool
) -> tuple[Float64, Bool]:
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


def high_banks(field: Float64, above: Float64) -> Bool:
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


def quay_water(field: Float64, is_dense_quay: Bool, above: Float64, has_points: Bool) -> Bool:
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


def _spread(start: Bool, over: Bool, reach: int) -> Bool:
    """Return a mask of the cells of ``over`` that are connected with ``start`` by at most ``reach`` steps."""
    return np.asarray(
        scipy.ndimage.binary_dilation(start, AROUND, reach, mask=start | over) & ~start
    )


def bank_rises(ground: Float64, wet: Bool, measured: Bool) -> Float64:
    """Return the rises in metres from the land at the shore to the next cells behind it, float64 (n,).

    Parameters
    ----------
    ground : float64 (h, w)
        Heights of the terrain in metres, NaN if there are none.
    wet : bool (h, w)
        Mask of the water.
    measured : bool (h, w)
        Mask of the cells of water at whose sides rises are measured, at least three cells from the border of the array.
    """
    bank = np.where(wet, np.nan, ground)
    rises_by_side = []
    for axis, step in SIDES:
        next_heights = np.roll(bank, 2 * step, axis)
        rises_by_side.append((next_heights - np.roll(bank, step, axis))[measured])
    rises: Float64 = np.concatenate(rises_by_side)
    return rises[~np.isnan(rises)]


def lower_level(heights: Float64, rises: Float64) -> float | None:
    """Return the lower level of a lake in metres, or None if it has one level or its bank is too flat.

    Parameters
    ----------
    heights : float64 (n,)
        Heights of the returns of the water in metres.
    rises : float64 (n,)
        Result of `bank_rises`.
    """
    if min(len(heights), len(rises)) < MIN_PIXELS:
        return None
    low, high = np.percentile(heights, (25, 75))
    if not SMOOTH_M < high - low <= BANK_WIDTH_CELLS * np.median(rises):
        return None
    return float(low)
