"""Shore of a body of water between coarse cells: the line at which the ground of the bank reaches the level."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy

from tiler.core.raster import Block, RasterSpec
from tiler.grid.coarse import Bools, Float64
from tiler.grid.water_cells import WaterCells

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
AROUND = np.ones((3, 3), np.bool_)


def heights_above_water(
    cells: WaterCells, wet: Bools, level: Float64 | None, is_lowered: bool = False
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


def _banks(above: Float64, wet: Bools, has_returns: Bools) -> tuple[Bools, Float64]:
    """Return a mask of the outermost cells of the water that are bank, and the heights of the bank there.

    In these cells, both the ground and the extrapolated bank are above the water. The ground
    alone is not enough: in a cell on the shore, the mean height may be above the water although
    the height in the middle is not.
    """
    _, extrapolated_m = _extrapolated_bank(above, wet)
    with np.errstate(invalid="ignore"):
        heights = np.minimum(above, extrapolated_m)
        return wet & has_returns & (heights > MIN_HEIGHT_M), heights


def _cut_cells(cells: WaterCells, above: Float64, wet: Bools) -> Bools:
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


def quays(cells: WaterCells, wet: Bools, level: Float64) -> Bools:
    """Return a mask of the outermost cells of upright banks. Parameters are those of `heights_above_water`."""
    is_quay = np.zeros_like(wet)
    for _, _, upright in _upright_sides(cells.ground - level, wet, cells.size_m):
        is_quay |= upright
    return is_quay


def _upright_sides(
    above: Float64, wet: Bools, size_m: float
) -> Iterator[tuple[int, int, Bools]]:
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


def _extrapolated_bank(above: Float64, wet: Bools) -> tuple[Float64, Float64]:
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
    import shapely
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
