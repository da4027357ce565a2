"""Where water is, from coarse cells: by the input's class, or as flat low land with few returns between rising banks.

Lasers get few returns from water, often none, and what returns is flat; but so are shadows of buildings, gaps between
strips, wet asphalt, and dark lawns. Only water lies everywhere lower than what is around it. So a candidate is a
connected area of void or sparse flat cells, and it is water if the ground some metres from its shore is higher than
the shore almost all around, and lower nowhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from tiler.grid.reach import distances, within

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

ENOUGH_RETURNS = 8
"""In the median of the cells with any: in cells of fewer, one without a return is an accident."""
SPARSE = 0.6
"""Of the median number of returns: fewer, in the mean of those cells near to one that have any, are few."""
SPARSE_CELLS = 5
FLAT_M = 0.35
"""Difference of height between neighbouring cells of water, noise included."""
LEAST_WIDTH_M = 6
"""What is narrower is no candidate: shadows, hedges."""

SHORE_M, RING_M = 3.0, (7.0, 13.0)
"""Width of the shore, and distances from the water between which the land has risen."""
NEAREST = 20
"""Cells of the shore with which a place of the ring is compared,"""
LOW_PERCENT = 20
"""and the percentile of their heights."""
PLACES_AT_ONCE = 1 << 14
"""Each takes some 600 bytes while it is compared."""
RISE_M, FALL_M = 0.3, 0.2
"""Least difference of height by which a place of the ring is above, or below, the shore."""
LEAST_RISING, MOST_FALLING = 0.6, 0.05
"""Around water, at least this share of the ring is above the shore, and at most that share below it."""
ALMOST_RISING = 0.45
"""Least share above the shore before the area is extended to where returns are as many as on land."""
LEAST_KNOWN = 0.4
"""Least share of the shore that has ground heights: with less nothing is decided."""
LEAST_CELLS = 20
"""Fewest cells of shore and of ring with which anything is decided."""
GIVEN_SHARE = 0.03
"""A candidate with this share of cells that the input calls water is water, unless its ring is lower."""

GROW_M = 40.0
"""How far water with returns goes on beyond the cells where they are few,"""
LEVEL_M = 0.15
"""while the ground is no higher than this above it."""
BRIDGE_M, UNDER_BRIDGE_M = 14.0, 0.5
"""Widest bridge under which water goes on, and how much higher the terrain may be there."""


@dataclass(frozen=True, eq=False)
class Cells:
    """Returns, classes and ground heights of coarse cells, in arrays of one shape.

    Attributes
    ----------
    returns : float32
        Points in each cell.
    given : bool
        Most of them are water by the input.
    ground : float64
        Height of the terrain, metres; NaN where there is none.
    domain : bool
        Cells of the survey, and of gaps that could be water.
    size : float
        Metres of a cell.
    """

    returns: npt.NDArray[np.float32]
    given: Bools
    ground: Floats
    domain: Bools
    size: float

    def coarser(self) -> Cells:
        """Two by two cells as one; a row or column that is left over is joined by empty ones."""
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
        return Cells(
            fours(self.returns, 0.0).sum(axis=2), fours(self.given, False).max(axis=2), mean,
            fours(self.domain, False).max(axis=2), 2 * self.size,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Found:
    """A candidate that is water: its ``cells`` in a ``window`` of the raster, and how ``sure`` that is."""

    window: tuple[slice, slice]
    cells: Bools
    sure: float


def dense_enough(cells: Cells) -> Cells:
    """Cells merged two by two until one without a return is significant."""
    while min(cells.returns.shape) > 8 and _usual(cells) < ENOUGH_RETURNS:
        cells = cells.coarser()
    return cells


def _usual(cells: Cells) -> float:
    some = cells.returns[cells.returns > 0]
    return float(np.median(some)) if len(some) else math.inf


def find_water(cells: Cells, trusted: bool) -> Iterator[Found]:
    """Areas of water, however small, with what lies beneath bridges.

    Parameters
    ----------
    cells : Cells
        As `dense_enough` gives them.
    trusted : bool
        Whether few returns are a sign of water; False for matched clouds, which have holes anywhere: there the input's
        class decides.
    """
    flat = _relief(cells.ground) < FLAT_M
    candidates = cells.given | _sparse(cells, flat) if trusted else cells.given
    candidates = scipy.ndimage.binary_opening(candidates, disk(LEAST_WIDTH_M / 2 / cells.size))
    candidates |= cells.given & scipy.ndimage.binary_dilation(candidates, np.ones((3, 3), np.bool_))
    labels, _ = scipy.ndimage.label(candidates)
    for number, window in enumerate(scipy.ndimage.find_objects(labels), start=1):
        wide = _padded(window, math.ceil(max(RING_M[1], GROW_M) / cells.size) + 1, labels.shape)
        found = _judged(_cut(cells, wide), labels[wide], number, flat[wide])
        if found is not None:
            yield Found(wide, *found)


def _sparse(cells: Cells, flat: Bools) -> Bools:
    """Cells of the survey without a return, and flat ones with few returns around them."""
    some = cells.returns > 0
    total, held = (
        scipy.ndimage.uniform_filter(v.astype(np.float64), SPARSE_CELLS) for v in (cells.returns, some)
    )
    return cells.domain & (~some | (flat & (total < SPARSE * _usual(cells) * held)))


def _judged(cells: Cells, labels: npt.NDArray[Any], number: int, flat: Bools) -> tuple[Bools, float] | None:
    """A candidate as far as it is water, and how sure that is; None where it is none."""
    mine = labels == number
    share = float(cells.given[mine].mean())
    rim = _rim(cells, mine, (labels > 0) & ~mine)
    if share >= GIVEN_SHARE:
        return (mine, 0.95) if rim is None or rim[1] < 5 * MOST_FALLING else None
    if rim is None or rim[0] < ALMOST_RISING or rim[1] > MOST_FALLING:
        return None
    if float((cells.returns[mine] > 0).mean()) > 0.5:
        grown = _grown(cells, mine, flat)
        after = _rim(cells, grown, (labels > 0) & ~grown)
        if after is not None and after[0] >= rim[0] and after[1] <= rim[1]:
            mine, rim = grown, after
    if rim[0] < LEAST_RISING:
        return None
    return mine, round(0.5 + 0.45 * (rim[0] - LEAST_RISING) / (1 - LEAST_RISING) - 2 * rim[1], 2)


def _rim(cells: Cells, mine: Bools, others: Bools) -> tuple[float, float] | None:
    """Shares of the land around an area that rise and that fall from its shore; None where too little is known."""
    distance = distances(mine, RING_M[1] / cells.size + 1)
    distance *= cells.size
    land = ~np.isnan(cells.ground) & ~others & cells.domain
    beside = (distance > 0) & (distance <= SHORE_M + 0.1 * cells.size)
    shore, ring = beside & land & (cells.returns > 0), (distance > RING_M[0]) & (distance <= RING_M[1]) & land
    ring &= cells.returns > 0
    if (
        min(shore.sum(), ring.sum()) < LEAST_CELLS
        or shore.sum() < LEAST_KNOWN * (beside & cells.domain).sum()
    ):
        return None
    rise = cells.ground[ring] - _near_ground(
        cells.ground, shore, np.argwhere(ring), lambda near: np.percentile(near, LOW_PERCENT, axis=1)
    )
    return float((rise > RISE_M).mean()), float((rise < -FALL_M).mean())


def _grown(cells: Cells, mine: Bools, flat: Bools) -> Bools:
    """An area of water with what is flat and no higher beside it, however many returns come from there."""
    known = mine & ~np.isnan(cells.ground)
    near = flat & cells.domain & (distances(mine, GROW_M / cells.size + 1) * cells.size <= GROW_M) & ~mine
    places = np.argwhere(near)
    if not known.any() or not len(places):
        return mine
    level = _near_ground(cells.ground, known, places, lambda near: np.median(near, axis=1))
    low = np.zeros_like(mine)
    low[near] = cells.ground[near] <= level + LEVEL_M
    low = scipy.ndimage.binary_opening(low | mine, np.ones((3, 3), np.bool_)) | mine
    grown: Bools = scipy.ndimage.binary_propagation(mine, mask=low)
    return grown


def _near_ground(
    ground: Floats, known: Bools, places: npt.NDArray[np.int64], level: Callable[[Floats], Floats]
) -> Floats:
    """What ``level`` makes of the ground [n, k] of the known cells that are nearest to each place (row, column)."""
    heights, tree = ground[known], scipy.spatial.cKDTree(np.argwhere(known))
    found = np.empty(len(places))
    for first in range(0, len(places), PLACES_AT_ONCE):
        part = places[first : first + PLACES_AT_ONCE]
        _, near = tree.query(part, k=min(NEAREST, len(heights)))
        found[first : first + len(part)] = level(heights[near.reshape(len(part), -1)])
    return found


def under_bridges(cells: Cells, water: Bools) -> Bools:
    """Water with gaps closed that bridges leave, where the terrain between is about as low as the shores."""
    pad = math.ceil(BRIDGE_M / cells.size)
    padded = np.pad(water, pad)
    radius = BRIDGE_M / 2 / cells.size
    closed = ~within(~within(padded, radius), radius)[pad:-pad, pad:-pad]
    shore = scipy.ndimage.binary_dilation(water, np.ones((3, 3), np.bool_)) & ~np.isnan(cells.ground)
    around = 2 * pad + 1
    low = scipy.ndimage.minimum_filter(np.where(shore, cells.ground, np.inf), around)
    with np.errstate(invalid="ignore"):
        return water | (closed & (cells.ground - low <= UNDER_BRIDGE_M))


def without_narrows(water: Bools, width: float) -> Bools:
    """Water without what is narrower than a width in cells; what is left keeps its shore."""
    least = max(width / 2 - 0.5, 1.0)
    inner = ~within(~np.pad(water, 1), math.nextafter(least, 0.0))[1:-1, 1:-1]
    return water & within(inner, width / 2 + 1)


def disk(radius: float) -> Bools:
    """Cells within a radius of the middle one."""
    reach = max(int(radius), 1)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.asarray(x * x + y * y <= max(radius, 1.0) ** 2)


def _relief(ground: Floats) -> Floats:
    """Highest less lowest ground of a cell and its neighbours; infinite where a neighbour has none."""
    high = scipy.ndimage.maximum_filter(np.where(np.isnan(ground), np.inf, ground), 3)
    low = scipy.ndimage.minimum_filter(np.where(np.isnan(ground), -np.inf, ground), 3)
    return np.asarray(high - low)


def _padded(window: tuple[slice, ...], pad: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, cols = (
        slice(max(s.start - pad, 0), min(s.stop + pad, n)) for s, n in zip(window, shape, strict=True)
    )
    return rows, cols


def _cut(cells: Cells, window: tuple[slice, slice]) -> Cells:
    return replace(
        cells, returns=cells.returns[window], given=cells.given[window], ground=cells.ground[window],
        domain=cells.domain[window],
    )  # fmt: skip
