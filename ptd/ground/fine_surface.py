"""Ground of dense LiDAR clouds by a fine surface of local planes through the lowest points of cells of 0.4 m.

A TIN of the lowest point of each cell of 1 m lies below the fine relief, so a band about it
both loses ground and keeps low plants. Where points are dense enough, they are compared with
planes through the lowest of the points near this TIN instead (`ptd.ground.fine_planes`).
``docs/filters.md`` describes the rules and the reasons for each of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, UInt8
from ptd.cells import Xyz
from ptd.frame import Scale
from ptd.ground.fine_planes import (
    BLOCK_SIZE,
    CELL_M,
    CELLS,
    FILLED,
    ROUGH_M,
    SPIKE_M,
    Blocks,
    LocatedPoints,
    PlaneLimits,
    Planes,
    elect,
    fit,
    located_points,
    pages_of_blocks,
)
from ptd.ground.labelling import (
    FAR,
    GROUND,
    NEAR,
    ON,
    UNCLASSIFIED,
    Closeness,
    LabelRule,
    TinLabels,
    label_by_height,
)
from ptd.ground.outliers import LowNoise
from ptd.kernel import kernel
from ptd.passes import Stats
from ptd.tin.mesh import Tin

REACH_M = 3 * BLOCK_SIZE * CELL_M
"""Distance beyond which points do not change a point's label. The label depends on planes in
the point's block and the eight around it, and these depend on points one block farther."""
NEAR_M, NEAR_SLOPE_M = 0.2, 0.5
"""Largest distance from the TIN of points that may be ground: metres, plus metres per unit of
slope."""
HIGHER_M = 0.2
"""Addition in metres to the limit of `NEAR` that gives the limit of `CROP` (`Closeness`)."""
BELOW_M, ABOVE_M, ABOVE_SLOPE_M = 0.25, 0.1, 0.1
"""Largest distances of ground below the plane, above it, and additionally above it per unit of
slope."""
CROP_BELOW_M, CROP_ABOVE_M, CROP_ON_M, CROP_SHARE = 0.1, 0.4, 0.05, 0.5
"""Limits of a crop.

Points from `CROP_BELOW_M` below to `CROP_ABOVE_M` above the fine surface, in a block and those
around it, are counted. In settled blocks all points that are not `FAR` from the TIN are
counted, and those that are `ON` are on the surface. If less than `CROP_SHARE` of them is within
`CROP_ON_M`, there is a crop, and no further points become ground.
"""


class Heights(NamedTuple):
    """Heights of the rules in vertical counts, and the number of horizontal counts in a vertical count."""

    below: float
    above: float
    above_slope: float
    crop_below: float
    crop_above: float
    crop_on: float
    z_ratio: float

    @classmethod
    def of(cls, scale: Scale) -> Heights:
        """Convert the heights to counts of a scale."""
        z = scale.counts_z
        return cls(
            z(BELOW_M), z(ABOVE_M), z(ABOVE_SLOPE_M), z(CROP_BELOW_M), z(CROP_ABOVE_M),
            z(CROP_ON_M), scale.z_ratio,
        )  # fmt: skip


@kernel
def _judge(
    points: Xyz, where: LocatedPoints, close: UInt8, blocks: Blocks, pages: Int32, planes: Planes, heights: Heights,
    ground: Bool,
) -> None:  # fmt: skip
    """Update the mask of ground points by their heights above the plane of their cell, if there is one."""
    x, y, z = points
    index, block, cell = where
    settled, east, north, height = blocks.settled, planes.east, planes.north, planes.height
    cell_x, cell_y, cell_z = planes.x, planes.y, planes.z
    seen, on = np.zeros(settled.size, np.int32), np.zeros(settled.size, np.int32)
    joins = np.zeros(index.size, np.bool_)
    for k in range(index.size):
        i, b = index[k], block[k]
        if settled[b]:
            seen[b] += close[i] != FAR
            on[b] += close[i] == ON
            continue
        plane_index = pages[b] * CELLS + cell[k]
        if pages[b] < 0 or np.isnan(height[plane_index]):
            continue
        rise_x, rise_y = float(east[plane_index]), float(north[plane_index])
        above = float(z[i] - cell_z[plane_index]) - height[plane_index]
        above -= rise_x * float(x[i] - cell_x[plane_index]) + rise_y * float(
            y[i] - cell_y[plane_index]
        )
        if -heights.crop_below <= above <= heights.crop_above:
            seen[b] += 1
            on[b] += abs(above) <= heights.crop_on
        slope = math.sqrt(rise_x * rise_x + rise_y * rise_y)
        most = heights.above + heights.above_slope * heights.z_ratio * slope
        fits = close[i] >= NEAR and -heights.below <= above <= most
        joins[k] = fits and not ground[i]
        ground[i] = ground[i] and fits
    for k in range(index.size):
        if joins[k]:
            ground[index[k]] = _has_no_crop(blocks.around, block[k], seen, on)


@kernel
def _has_no_crop(around: Int32, b: int, seen: Int32, on: Int32) -> bool:
    """Return whether there is no crop: enough points in a block and around it lie on the surface."""
    n_on = n_seen = 0
    for n in range(9):
        if around[b, n] >= 0:
            n_on += on[around[b, n]]
            n_seen += seen[around[b, n]]
    return n_on >= CROP_SHARE * n_seen


def fine_ground(
    points: Xyz, close: UInt8, ground: Bool, uncertified: Bool, scale: Scale
) -> tuple[Bool, Bool]:
    """Find the ground points, by a fine surface where points are dense.

    Parameters
    ----------
    points : Xyz
        Points to classify, and all points within `REACH_M` of them.
    close : uint8 [n]
        Closeness of each point to the TIN (`Closeness`).
    ground, uncertified : bool [n]
        Mask of the points that are ground according to the TIN, and mask of the points for which ``ground`` or
        ``close`` is uncertified.
    scale : Scale

    Returns
    -------
    ground, uncertified : bool [n]
        Masks of the ground points and of the uncertified points.
    """
    where, blocks = located_points(points, close, uncertified, scale)
    if where.point.size == 0 or blocks.points.max() < FILLED:
        # No block can be dense, even if all uncertified points count.
        return ground, uncertified
    is_chosen = ~blocks.settled & (blocks.near >= FILLED)
    pages, n_pages = pages_of_blocks(is_chosen, blocks.around)
    ground, uncertified = ground.copy(), uncertified.copy()
    if n_pages:
        planes = Planes.none(n_pages)
        elect(points, where, close, pages, planes)
        fit(
            blocks.around,
            pages,
            is_chosen,
            planes,
            PlaneLimits(scale.counts_z(SPIKE_M), scale.counts_z(ROUGH_M)),
        )
        _judge(points, where, close, blocks, pages, planes, Heights.of(scale), ground)
    if blocks.has_uncertified.any():
        near_uncertified = blocks.has_uncertified
        for _ in range(2):
            near_uncertified = np.asarray(
                (near_uncertified[blocks.around] & (blocks.around >= 0)).any(axis=1)
            )
        uncertified[where.point] |= near_uncertified[where.block]
    return ground, uncertified


def with_fine_surface(rule: LabelRule, scale: Scale) -> LabelRule:
    """Return a copy of a rule (with ``heights_only`` set) with the closeness limits of the fine surface."""
    lengths = (ABOVE_M, ABOVE_SLOPE_M, NEAR_M, NEAR_SLOPE_M, HIGHER_M)
    return rule._replace(close=Closeness(*(scale.counts(metres) for metres in lengths)))


class FineLabels(TinLabels):
    """Model that labels points by a TIN, and by a fine surface above it where points are dense.

    Parameters
    ----------
    closed, stats, low
        Parameters of `TinLabels`.
    scale : Scale
    """

    def __init__(self, closed: bool, stats: Stats, low: LowNoise, scale: Scale) -> None:
        super().__init__(closed, stats, low)
        self._scale = scale

    def judged(self, tin: Tin, points: Xyz) -> tuple[UInt8, Bool]:
        """Return labels and a mask of uncertified labels. The rule must come from `with_fine_surface`."""
        labels, uncertified, close = label_by_height(
            tin, self.locator, points, self.uncertified, self.rule, self.bands
        )
        ground, uncertified = fine_ground(
            points, close, labels == GROUND, uncertified, self._scale
        )
        return np.where(ground, np.uint8(GROUND), np.uint8(UNCLASSIFIED)), uncertified
