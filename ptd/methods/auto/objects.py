"""Tell objects from terrain by how steeply the lowest points of cells drop around them.

An object drops steeply: an opening with a disk a little wider than it takes away its height, where terrain loses no
more than its slope gives. So a cell is an object's if for some radius r (in cells)::

    drop(r) - allowance > (per_metre + per_slope * slope) * r

with drop(r) the fall from the opening with r - 1 to that with r, both of the raster as it is, and the slope that of
the surface after the last opening. Nothing farther than a fixed reach has a part in any of these answers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptd.cells import Int32
from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import Bool, CellRaster, Float64, steepest_drops
from ptd.ground.slopes import Boxes


@dataclass(frozen=True)
class Drop:
    """When a cell is an object's: see the module. Metres and metres per metre."""

    allowance_m: float
    per_metre: float
    per_slope: float


@dataclass(frozen=True)
class Shape:
    """Lengths in cells that the rules share.

    Attributes
    ----------
    radius : int
        Of the largest opening.
    slope : int
        Of the boxes of `ptd.ground.slopes.slopes`.
    """

    radius: int
    slope: int

    @property
    def reach(self) -> int:
        """Cells beyond which nothing has a part in `steep_objects`: an opening's, and that of slopes of openings."""
        return 2 * self.radius + 2 * self.slope


@dataclass(frozen=True)
class Residuals:
    """Rule of `residual_objects`; lengths in cells.

    Attributes
    ----------
    drop : Drop
    trend, radius, slope, around : int
        Reach of the mean that is taken off; of the largest opening; of the boxes of slopes; of the share of objects.
    lack : float
        By how much the threshold grows where there are no objects around.
    enough : float
        Share of objects from which on it does not grow.
    """

    drop: Drop
    trend: int
    radius: int
    slope: int
    around: int
    lack: float
    enough: float

    @property
    def reach(self) -> int:
        """Cells beyond which nothing has a part in the answer."""
        return max(self.trend + 2 * self.radius, 2 * self.slope, self.around)


class Lowest:
    """The lowest point of each cell of a block as a raster.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, one point a cell; at least one.
    cells : CellLattice
    cell_m : float
        Their side in metres.
    scale : Scale
    """

    def __init__(self, x: Int32, y: Int32, z: Int32, cells: CellLattice, cell_m: float, scale: Scale) -> None:
        self.raster, self.z, self.scale = CellRaster(x, y, cells), z, scale
        self.unit = scale.counts_z(cell_m)
        """Counts a cell of a slope of 1."""

    def heights(self, which: Bool) -> Int32:
        """Raster of the heights of some points: int32."""
        return self.raster.lowest(self.z, which)

    def steep_objects(self, which: Bool, drop: Drop, shape: Shape) -> Bool:
        """Mask of the points in cells where the surface of the chosen points drops like an object: bool [n]."""
        steepest, opened = steepest_drops(
            self.heights(which), range(1, shape.radius + 1), self.scale.counts_z(drop.allowance_m)
        )
        keys = self.raster.keys
        allowed = drop.per_metre * self.unit + drop.per_slope * Boxes(opened).slopes(shape.slope, keys)
        found: Bool = steepest.reshape(-1)[keys] > allowed
        return found

    def residual_objects(self, ground: Bool, present: Bool, rule: Residuals) -> Bool:
        """Mask of the points that rise like objects once the mean of the ground is taken off.

        Without the trend slopes do not hide what is low, so small radii and thresholds suffice. Where there are no
        objects around, a bump of the terrain is the likelier reason, so the threshold grows (`lack`).
        """
        boxes, drop, keys = Boxes(self.heights(ground)), rule.drop, self.raster.keys
        means = boxes.means(rule.trend, keys)
        trend = np.where(np.isnan(means), self.z, np.rint(means))  # where there is none a point is its own
        residuals = self.raster.lowest((self.z - trend).astype(np.int32), present)
        steepest, _ = steepest_drops(
            residuals, range(1, rule.radius + 1), self.scale.counts_z(drop.allowance_m)
        )
        allowed = drop.per_metre * self.unit + drop.per_slope * boxes.slopes(rule.slope, keys)
        allowed += rule.lack * self.unit * self.lack_of_objects(ground, rule)
        found: Bool = steepest.reshape(-1)[keys] > allowed
        return found

    def lack_of_objects(self, ground: Bool, rule: Residuals) -> Float64:
        """1 where all cells around are ground, 0 where a share `enough` of them is not: float64 [n]."""
        objects = self.raster.lowest((~ground).astype(np.int32), np.ones(ground.size, np.bool_))
        share = Boxes(objects).means(rule.around, self.raster.keys)  # never NaN: its own cell is filled
        return 1.0 - np.minimum(share / rule.enough, 1.0)
