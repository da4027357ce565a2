"""Candidates for water: by the input's class, or flat, low, with few returns and rising banks.

Laser scanners get few returns from water, often none, and its returns are flat. The same is true of shadows of
buildings, gaps between strips, wet asphalt and dark lawns, but only water is lower than everything around it. So a
candidate is a connected area of void or sparse flat cells. It is water if the ground some metres from its shore is
higher than the shore almost all around, and lower almost nowhere. The land around an area is counted block by block and
added up, so that large areas need not be in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from tiler.grid.reach import distances

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

ENOUGH_RETURNS = 8
"""Least median of the returns in cells with returns. With fewer returns, a cell may be empty by chance."""
SPARSE = 0.6
"""Share of the median number of returns below which the mean of the cells around a cell counts as few."""
SPARSE_CELLS = 5
FLAT_M = 0.35
"""Largest difference of height between neighbouring cells of water, noise included."""
MIN_WIDTH_M = 6
"""Least width of a candidate, which excludes shadows and hedges."""

SHORE_M, RING_M = 3.0, (7.0, 13.0)
"""Width of the shore, and limits of the distance from the water of the ring, where the land has to be higher."""
NEAREST = 20
"""Number of cells of the shore with which a cell of the ring is compared."""
LOW_PERCENT = 20
"""Percentile of the heights of these cells that is compared."""
PLACES_PER_BATCH = 1 << 14
"""Number of cells of the ring that are compared in one batch, with about 600 bytes each."""
RISE_M, FALL_M = 0.3, 0.2
"""Least difference of height by which a cell of the ring is above, or below, the shore."""
MIN_RISING, MAX_FALLING = 0.6, 0.05
"""Least share of the ring above the shore, and largest share below it, for water."""
MIN_KNOWN = 0.4
"""Least share of the shore with ground heights from which an area can be classified."""
MIN_CELLS = 20
"""Least number of cells of shore and of ring from which an area can be classified."""
GIVEN_SHARE = 0.03
"""Least share of cells of class water that makes a candidate water, unless its ring is lower."""


@dataclass(frozen=True, eq=False)
class WaterCells:
    """Returns, classes and ground heights of coarse cells, in arrays of one shape.

    Attributes
    ----------
    returns : float32
        Number of points in each cell.
    given : bool
        Whether most points of a cell are water by the input.
    ground : float64
        Height of the terrain in metres; NaN for none.
    domain : bool
        Cells of the survey, and of gaps that could be water.
    size : float
        Side of a cell in metres.
    """

    returns: npt.NDArray[np.float32]
    given: Bools
    ground: Floats
    domain: Bools
    size: float

    def coarser(self) -> WaterCells:
        """Merge cells two by two. A remaining row or column is merged with empty cells."""
        pads = [(0, side % 2) for side in self.returns.shape]

        def fours(values: npt.NDArray[Any], fill: Any) -> npt.NDArray[Any]:
            padded = np.pad(values, pads, constant_values=fill)
            rows, cols = padded.shape
            return padded.reshape(rows // 2, 2, cols // 2, 2).swapaxes(1, 2).reshape(rows // 2, cols // 2, 4)

        ground = fours(self.ground, np.nan)
        known = ~np.isnan(ground)
        total = np.where(known, ground, 0.0).sum(axis=2)
        number = known.sum(axis=2)
        mean = np.where(number > 0, total / np.maximum(number, 1), np.nan)
        return WaterCells(
            fours(self.returns, 0.0).sum(axis=2), fours(self.given, False).max(axis=2), mean,
            fours(self.domain, False).max(axis=2), 2 * self.size,
        )  # fmt: skip

    def finer(self, times: int) -> WaterCells:
        """Divide each cell into ``times`` by ``times`` cells with its values."""

        def repeated(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return values.repeat(times, axis=0).repeat(times, axis=1)

        return WaterCells(
            repeated(self.returns), repeated(self.given), repeated(self.ground), repeated(self.domain),
            self.size / times,
        )  # fmt: skip

    def with_ground(self, ground: Floats) -> WaterCells:
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
    beside : int
        Cells of the domain next to the area.
    shore : int
        Cells next to the area with a height and returns.
    ring : int
        Cells with a height and returns between the distances `RING_M`.
    rising, falling : int
        Cells of the ring that are above, and below, the shore.
    """

    beside: int = 0
    shore: int = 0
    ring: int = 0
    rising: int = 0
    falling: int = 0

    def plus(self, other: Rim) -> Rim:
        """Return the sum of two counts."""
        return Rim(*(own_count + other_count for own_count, other_count in zip(self, other, strict=True)))

    @property
    def known(self) -> bool:
        """Whether enough of the land is known to classify the area."""
        return min(self.shore, self.ring) >= MIN_CELLS and self.shore >= MIN_KNOWN * self.beside

    @property
    def rises(self) -> float:
        """Share of the ring that is above the shore."""
        return self.rising / self.ring

    @property
    def falls(self) -> float:
        """Share of the ring that is below the shore."""
        return self.falling / self.ring

    @property
    def sure(self) -> float:
        """Confidence that the area is water, if enough of the ring rises."""
        return round(0.5 + 0.45 * (self.rises - MIN_RISING) / (1 - MIN_RISING) - 2 * self.falls, 2)


class Size(NamedTuple):
    """Number of cells of an area, added up over blocks: all, and cells that are water by the input."""

    cells: int = 0
    given: int = 0

    @property
    def is_given(self) -> bool:
        """Whether enough of the area is water by the input."""
        return 0 < self.given >= GIVEN_SHARE * self.cells


def water_areas(cells: WaterCells, usual: float | None) -> Bools:
    """Return a mask of the cells that may be water. Connected cells are one candidate.

    Parameters
    ----------
    cells : WaterCells
        Cells of a size at which a cell without returns is significant.
    usual : float or None
        Median of the returns of the cells in this region with returns. None: few returns are not a sign of water, as in
        photogrammetric clouds, which have holes anywhere, so the input's class decides.
    """
    candidates = cells.given
    if usual is not None:
        candidates = candidates | sparse_cells(cells, flat_cells(cells), usual)
    candidates = scipy.ndimage.binary_opening(candidates, disk(MIN_WIDTH_M / 2 / cells.size))
    candidates |= cells.given & scipy.ndimage.binary_dilation(candidates, np.ones((3, 3), np.bool_))
    return np.asarray(candidates)


def flat_cells(cells: WaterCells) -> Bools:
    """Return a mask of the cells with as little relief as water."""
    return _relief(cells.ground) < FLAT_M


def sparse_cells(cells: WaterCells, flat: Bools, usual: float) -> Bools:
    """Return a mask of the cells of the survey without returns, and of flat ones with few returns around them."""
    some = cells.returns > 0
    total, held = (
        scipy.ndimage.uniform_filter(v.astype(np.float64), SPARSE_CELLS) for v in (cells.returns, some)
    )
    return cells.domain & (~some | (flat & (total < SPARSE * usual * held)))


def judged(size: Size, rim: Rim) -> float | None:
    """Return the confidence that an area is water, by the land around it, or None if it is not water."""
    if size.is_given:
        return None if rim.known and rim.falls >= 5 * MAX_FALLING else 0.95
    if not rim.known or rim.rises < MIN_RISING or rim.falls > MAX_FALLING:
        return None
    return rim.sure


def rim_of(cells: WaterCells, mine: Bools, others: Bools, counted: Bools, water: Bools | None = None) -> Rim:
    """Count the land around an area.

    Parameters
    ----------
    cells : WaterCells
    mine, others : bool, shape of the cells
        Masks of the area, and of other candidates, which do not count as land.
    counted : bool
        Mask of the cells that are counted. Other cells are only neighbours.
    water : bool, shape of the cells, optional
        Mask of cells that count in the ring even without returns, so that a dam falls to the water beside it.
    """
    distance = distances(mine, RING_M[1] / cells.size + 1)
    distance *= cells.size
    land = ~np.isnan(cells.ground) & ~others & cells.domain
    beside = (distance > 0) & (distance <= SHORE_M + 0.1 * cells.size)
    shore, ring = beside & land & (cells.returns > 0), (distance > RING_M[0]) & (distance <= RING_M[1]) & land
    seen = cells.returns > 0
    if water is not None:
        seen |= water
    ring &= seen & counted
    counts = Rim(int((beside & cells.domain & counted).sum()), int((shore & counted).sum()), int(ring.sum()))
    if not shore.any() or not counts.ring:
        return counts
    rise = cells.ground[ring] - _near_ground(
        cells.ground, shore, np.argwhere(ring), lambda near: np.percentile(near, LOW_PERCENT, axis=1)
    )
    return counts._replace(rising=int((rise > RISE_M).sum()), falling=int((rise < -FALL_M).sum()))


def _near_ground(
    ground: Floats, known: Bools, places: npt.NDArray[np.int64], level: Callable[[Floats], Floats]
) -> Floats:
    """Return ``level`` of the ground [n, k] of the k nearest known cells of n places (row, column)."""
    heights, tree = ground[known], scipy.spatial.cKDTree(np.argwhere(known))
    levels = np.empty(len(places))
    for first in range(0, len(places), PLACES_PER_BATCH):
        part = places[first : first + PLACES_PER_BATCH]
        _, near = tree.query(part, k=min(NEAREST, len(heights)))
        levels[first : first + len(part)] = level(heights[near.reshape(len(part), -1)])
    return levels


def disk(radius: float) -> Bools:
    """Return a mask of the cells within a radius of the middle one."""
    radius_cells = max(int(radius), 1)
    y, x = np.mgrid[-radius_cells : radius_cells + 1, -radius_cells : radius_cells + 1]
    return np.asarray(x * x + y * y <= max(radius, 1.0) ** 2)


def _relief(ground: Floats) -> Floats:
    """Return the height range of each cell and its neighbours, infinite if one of them has no ground."""
    high = scipy.ndimage.maximum_filter(np.where(np.isnan(ground), np.inf, ground), 3)
    low = scipy.ndimage.minimum_filter(np.where(np.isnan(ground), -np.inf, ground), 3)
    return np.asarray(high - low)
