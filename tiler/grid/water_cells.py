"""Cells of the search for water: their heights, candidates for water, and the decision which of them are water.

Laser scanners get few returns from water, often none, and returns of water are at one height. The same is true of
shadows of buildings, gaps between flight strips, wet asphalt and dark lawns, but only water is lower than everything
around it. So a candidate is a connected area of cells that are empty, or flat with few returns, or classified as
water in the input. A candidate is water if the ground some metres from its shore is higher than the shore almost all
around, and lower almost nowhere. The land around an area is counted block by block and added up, so that large areas
need not be in memory.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from ptd.arrays import AnyArray, Bool, Float32, Float64, Int64
from tiler.core.lattice import COUNTS_PER_UNIT
from tiler.core.points import WATER
from tiler.core.raster import BLOCK_PIXELS, NODATA
from tiler.grid.block_surroundings import PointsNear, pixel_indices
from tiler.grid.coarse import blocks_under, distances, opened, padded
from tiler.grid.coverage import merged
from tiler.grid.ground import surface_points
from tiler.grid.steps import Counts, PixelsUnder, Position
from tiler.store import coarse_cells

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
) -> tuple[Float64, Counts]:
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


def _means(total: Float64, number: Int64) -> Float64:
    """Convert sums of heights in counts to means in units of the CRS, `NODATA` for cells without heights."""
    means = np.full(total.shape, NODATA)
    np.divide(total, number * COUNTS_PER_UNIT, out=means, where=number > 0)
    return means


def _water_class_heights(points: PointsNear, returns: Float32) -> Float64:
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


ENOUGH_RETURNS = 8
"""Cells are merged until the median number of returns, of the cells with returns, is at least this.

With fewer returns, a cell may be empty by chance.
"""
SPARSE = 0.6
"""A flat cell has few returns if the mean number of returns per cell around it is below this share of the median.

The median is that of the block and its neighbours. Mean and median leave out cells without
returns.
"""
MEAN_SIDE_CELLS = 5
"""The mean around a cell is computed in a square of this side, in cells."""
FLAT_M = 0.35
"""A cell is flat if the heights of the cell and its eight neighbours differ by less than this,
in metres."""
MIN_WIDTH_M = 6
"""Narrower parts of candidates are left out, in metres. This excludes shadows and hedges."""

SHORE_BAND_M = 3.0
"""The shore of an area consists of cells up to this distance from the area, in metres."""
RING_M = (7.0, 13.0)
"""The ring of an area consists of cells between these distances from the area, in metres.

The ring of water is higher than the shore.
"""
N_NEAREST = 20
"""A cell of the ring is compared with this many cells of the shore, the nearest ones."""
LOW_PERCENT = 20
"""The height of a cell of the ring is compared with this percentile of the heights of its
nearest shore cells."""
CELLS_PER_BATCH = 1 << 14
"""This many cells of the ring are compared in one batch. Each takes about 600 bytes."""
RISE_M = 0.3
"""A cell of the ring rises if it is more than this above the shore, in metres."""
FALL_M = 0.2
"""A cell of the ring falls if it is more than this below the shore, in metres."""
MIN_RISING = 0.6
"""An area that is not water by the input is water only if at least this share of its ring
rises."""
MAX_FALLING = 0.05
"""An area that is not water by the input is water only if at most this share of its ring
falls."""
MIN_KNOWN = 0.4
"""The land around an area is used only if at least this share of its shore has heights and
returns."""
MIN_CELLS = 20
"""The land around an area is used only if shore and ring each have this many cells with heights
and returns."""
GIVEN_SHARE = 0.03
"""An area is water if at least this share of its cells is water by the input, unless much of
its ring falls."""


@dataclass(frozen=True, eq=False)
class WaterCells:
    """Returns, classes and ground heights of coarse cells, in arrays of one shape.

    Attributes
    ----------
    returns : float32
        Number of points in each cell.
    given : bool
        Whether most points of a cell are water by the input. After merging, whether this is so for any merged cell.
    ground : float64
        Height of the terrain in metres, NaN if there is none.
    domain : bool
        Whether a cell lies in the survey, or in a gap of the survey that may be water.
    size_m : float
        Side of a cell in metres.
    """

    returns: Float32
    given: Bool
    ground: Float64
    domain: Bool
    size_m: float

    def coarser(self) -> WaterCells:
        """Merge squares of two by two cells. A remaining row or column is merged with empty cells."""
        pads = [(0, side % 2) for side in self.returns.shape]

        def fours(values: AnyArray, fill: Any) -> AnyArray:
            """Return the four values of each square, along a third axis."""
            return merged(np.pad(values, pads, constant_values=fill), 2)

        ground = fours(self.ground, np.nan)
        known = ~np.isnan(ground)
        total = np.where(known, ground, 0.0).sum(axis=2)
        number = known.sum(axis=2)
        mean = np.where(number > 0, total / np.maximum(number, 1), np.nan)
        return WaterCells(
            fours(self.returns, 0.0).sum(axis=2), fours(self.given, False).max(axis=2), mean,
            fours(self.domain, False).max(axis=2), 2 * self.size_m,
        )  # fmt: skip

    def merged(self, times: int) -> WaterCells:
        """Merge squares of ``times`` by ``times`` cells. ``times`` is a power of two."""
        cells = self
        for _ in range(times.bit_length() - 1):
            cells = cells.coarser()
        return cells

    def finer(self, times: int) -> WaterCells:
        """Divide each cell into ``times`` by ``times`` cells with the same values."""

        def repeated(values: AnyArray) -> AnyArray:
            return values.repeat(times, axis=0).repeat(times, axis=1)

        return WaterCells(
            repeated(self.returns), repeated(self.given), repeated(self.ground), repeated(self.domain),
            self.size_m / times,
        )  # fmt: skip

    def with_ground(self, ground: Float64) -> WaterCells:
        """Return the same cells with other heights."""
        return replace(self, ground=ground)

    def cut(self, window: tuple[slice, slice]) -> WaterCells:
        """Return the cells of a window."""
        return replace(
            self, returns=self.returns[window], given=self.given[window], ground=self.ground[window],
            domain=self.domain[window],
        )  # fmt: skip


class Rim(NamedTuple):
    """Numbers of cells of the land around an area, added up over blocks.

    Attributes
    ----------
    n_shore : int
        Cells of the shore, in the domain.
    n_known_shore : int
        Cells of the shore with a height and returns.
    n_ring : int
        Cells of the ring with a height, and with returns or water.
    n_rising : int
        Cells of the ring that rise (`RISE_M`).
    n_falling : int
        Cells of the ring that fall (`FALL_M`).
    """

    n_shore: int = 0
    n_known_shore: int = 0
    n_ring: int = 0
    n_rising: int = 0
    n_falling: int = 0

    def plus(self, other: Rim) -> Rim:
        """Return the sums of the numbers of two rims."""
        return Rim(*map(operator.add, self, other))

    @property
    def known(self) -> bool:
        """Whether enough cells of the land have heights and returns to classify the area."""
        return (
            min(self.n_known_shore, self.n_ring) >= MIN_CELLS
            and self.n_known_shore >= MIN_KNOWN * self.n_shore
        )

    @property
    def rising_share(self) -> float:
        """Share of the ring that rises."""
        return self.n_rising / self.n_ring

    @property
    def falling_share(self) -> float:
        """Share of the ring that falls."""
        return self.n_falling / self.n_ring

    @property
    def confidence(self) -> float:
        """Confidence that the area is water, for areas with enough of the ring rising."""
        return round(
            0.5
            + 0.45 * (self.rising_share - MIN_RISING) / (1 - MIN_RISING)
            - 2 * self.falling_share,
            2,
        )


class CellCounts(NamedTuple):
    """Numbers of cells of an area, added up over blocks: all cells, and cells that are water by the input."""

    cells: int = 0
    given: int = 0

    @property
    def is_given(self) -> bool:
        """Whether the area has cells that are water by the input, at least `GIVEN_SHARE` of its cells."""
        return 0 < self.given >= GIVEN_SHARE * self.cells


def water_candidates(cells: WaterCells, usual: float | None) -> Bool:
    """Return a mask of the cells that may be water. Connected cells are one candidate.

    Parameters
    ----------
    cells : WaterCells
        Cells of a size at which a cell without returns is significant.
    usual : float or None
        Median number of returns in the block and its neighbours, of the cells with returns. None if few returns are not
        a sign of water, as in photogrammetric clouds. Then only the class of the input decides.
    """
    candidates = cells.given
    if usual is not None:
        candidates = candidates | sparse_cells(cells, flat_cells(cells), usual)
    candidates = opened(candidates, max(MIN_WIDTH_M / 2 / cells.size_m, 1.0))
    candidates |= cells.given & scipy.ndimage.binary_dilation(
        candidates, np.ones((3, 3), np.bool_)
    )
    return np.asarray(candidates)


def flat_cells(cells: WaterCells) -> Bool:
    """Return a mask of the flat cells, see `FLAT_M`."""
    return relief(cells.ground) < FLAT_M


def sparse_cells(cells: WaterCells, flat: Bool, usual: float) -> Bool:
    """Return a mask of the cells of the domain that have no returns, or are flat with few returns around them."""
    has_returns = cells.returns > 0
    returns = scipy.ndimage.uniform_filter(cells.returns.astype(np.float64), MEAN_SIDE_CELLS)
    share = scipy.ndimage.uniform_filter(has_returns.astype(np.float64), MEAN_SIDE_CELLS)
    return cells.domain & (~has_returns | (flat & (returns < SPARSE * usual * share)))


def water_confidence(counts: CellCounts, rim: Rim) -> float | None:
    """Return the confidence that an area is water, from the input and the land around it, or None if it is land.

    An area that is not water by the input counts as land also if too little of the land around
    it is known.
    """
    if counts.is_given:
        return None if rim.known and rim.falling_share >= 5 * MAX_FALLING else 0.95
    if not rim.known or rim.rising_share < MIN_RISING or rim.falling_share > MAX_FALLING:
        return None
    return rim.confidence


def rim_of(
    cells: WaterCells, area: Bool, others: Bool, counted: Bool, water: Bool | None = None
) -> Rim:
    """Count the land around an area.

    Parameters
    ----------
    cells : WaterCells
    area : bool, shape of the cells
        Mask of the area.
    others : bool, shape of the cells
        Mask of cells that do not count as land, such as other candidates.
    counted : bool, shape of the cells
        Mask of the cells that are counted. Cells of the ring are also compared with shore cells outside of the mask.
    water : bool, shape of the cells, optional
        Mask of cells that count in the ring even without returns. With this water, the ring around the level crest of a
        dam falls, so the crest is not water.
    """
    distance = distances(area, RING_M[1] / cells.size_m + 1)
    distance *= cells.size_m
    land = ~np.isnan(cells.ground) & ~others & cells.domain
    has_returns = cells.returns > 0
    beside = (distance > 0) & (distance <= SHORE_BAND_M + 0.1 * cells.size_m)
    shore = beside & land & has_returns
    ring = (distance > RING_M[0]) & (distance <= RING_M[1]) & land & counted
    ring &= has_returns if water is None else has_returns | water
    n_shore = int((beside & cells.domain & counted).sum())
    counts = Rim(n_shore, int((shore & counted).sum()), int(ring.sum()))
    if not shore.any() or not counts.n_ring:
        return counts
    rise = cells.ground[ring] - _low_shore(cells.ground, shore, np.argwhere(ring))
    return counts._replace(
        n_rising=int((rise > RISE_M).sum()), n_falling=int((rise < -FALL_M).sum())
    )


def _low_shore(ground: Float64, shore: Bool, cells: Int64) -> Float64:
    """Return a low percentile of the heights of the shore near some cells, float64 (n,).

    ``cells`` are rows and columns of these cells, int64 (n, 2).
    """
    heights = ground[shore]
    tree = scipy.spatial.cKDTree(np.argwhere(shore))
    low_heights = np.empty(len(cells))
    for first in range(0, len(cells), CELLS_PER_BATCH):
        batch = cells[first : first + CELLS_PER_BATCH]
        _, near = tree.query(batch, k=min(N_NEAREST, len(heights)))
        near_heights = heights[near.reshape(len(batch), -1)]
        low_heights[first : first + len(batch)] = np.percentile(
            near_heights, LOW_PERCENT, axis=1
        )
    return low_heights


def relief(ground: Float64) -> Float64:
    """Return the range of heights of each cell and its neighbours, infinite if one of these cells has no ground."""
    unknown = np.isnan(ground)
    high, low = np.where(unknown, np.inf, ground), np.where(unknown, -np.inf, ground)
    for values, extreme in ((high, np.maximum), (low, np.minimum)):
        pairs = extreme(values[1:], values[:-1])
        extreme(values[1:], pairs, out=values[1:])
        extreme(values[:-1], pairs, out=values[:-1])
        pairs = extreme(values[:, 1:], values[:, :-1])
        extreme(values[:, 1:], pairs, out=values[:, 1:])
        extreme(values[:, :-1], pairs, out=values[:, :-1])
    return high - low
