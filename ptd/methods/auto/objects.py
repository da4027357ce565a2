"""Objects, distinguished from terrain by the steep drop of the lowest points of cells in morphological openings.

An object drops steeply: an opening with a disk a little wider than the object removes its
height, while terrain loses no more than its slope gives. So a cell belongs to an object if for
some radius r (in metres)::

    drop(r) - allowance > (per_metre + per_slope * slope) * r

Here drop(r) is the fall to the opening with r from that one cell smaller, both of the original
raster. The slope is that of the surface after the last opening (for seeds) or of the ground
(for residuals). For residuals the threshold also grows where there are few objects around.
Heights beyond a fixed distance do not change any of these results.
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
    """Rule by which a cell belongs to an object (see the module), in metres and metres per metre."""

    allowance_m: float
    per_metre: float
    per_slope: float


@dataclass(frozen=True)
class Shape:
    """Lengths in cells of the rule for seeds.

    Attributes
    ----------
    radius : int
        Radius of the largest opening.
    slope : int
        Half width of the boxes for slopes (`ptd.ground.slopes.Boxes.slopes`).
    """

    radius: int
    slope: int

    @property
    def reach(self) -> int:
        """Distance in cells beyond which heights do not change `steep_objects`."""
        return 2 * self.radius + 2 * self.slope


@dataclass(frozen=True)
class Residuals:
    """Rule of `residual_objects`, with lengths in cells.

    Attributes
    ----------
    drop : Drop
    trend, radius, slope, around : int
        Half width of the boxes for the mean that is subtracted, radius of the largest opening, half width of the boxes
        for slopes, and half width of the boxes for the share of objects.
    lack : float
        Addition to the threshold where there are no objects around, in metres per metre.
    enough : float
        Share of objects from which on the threshold does not grow.
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
        """Distance in cells beyond which heights do not change `residual_objects`."""
        return max(self.trend + 2 * self.radius, 2 * self.slope, self.around)


class Lowest:
    """The lowest point of each cell of a block as a raster.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts of one point per cell, at least one.
    cells : CellLattice
    cell_m : float
        Size of the cells in metres.
    scale : Scale
    """

    def __init__(
        self, x: Int32, y: Int32, z: Int32, cells: CellLattice, cell_m: float, scale: Scale
    ) -> None:
        self.raster, self.z, self.scale = CellRaster(x, y, cells), z, scale
        self.unit = scale.counts_z(cell_m)
        """Rise in vertical counts over one cell at a slope of 1."""

    def heights(self, mask: Bool) -> Int32:
        """Return the raster of the heights of the points in a mask: int32 [rows, columns]."""
        return self.raster.lowest(self.z, mask)

    def steep_objects(self, mask: Bool, drop: Drop, shape: Shape) -> Bool:
        """Return a mask of the points where the surface of the chosen points drops like an object: bool [n]."""
        steepest, opened = steepest_drops(
            self.heights(mask),
            range(1, shape.radius + 1),
            self.scale.counts_z(drop.allowance_m),
        )
        keys = self.raster.keys
        allowed = drop.per_metre * self.unit + drop.per_slope * Boxes(opened).slopes(
            shape.slope, keys
        )
        is_object: Bool = steepest.reshape(-1)[keys] > allowed
        return is_object

    def residual_objects(self, ground: Bool, present: Bool, limits: Residuals) -> Bool:
        """Return a mask of the points that rise like objects after subtracting the mean of the ground: bool [n].

        Once the mean is subtracted, slopes do not hide low objects, so small radii and
        thresholds suffice. Where there are no objects around, a rise is more likely a bump of
        the terrain, so the threshold grows (`lack`).
        """
        boxes, drop, keys = Boxes(self.heights(ground)), limits.drop, self.raster.keys
        means = boxes.means(limits.trend, keys)
        # Without ground, a point is its own trend.
        trend = np.where(np.isnan(means), self.z, np.rint(means))
        residuals = self.raster.lowest((self.z - trend).astype(np.int32), present)
        steepest, _ = steepest_drops(
            residuals, range(1, limits.radius + 1), self.scale.counts_z(drop.allowance_m)
        )
        allowed = drop.per_metre * self.unit + drop.per_slope * boxes.slopes(limits.slope, keys)
        allowed += limits.lack * self.unit * self.lack_of_objects(ground, limits)
        is_object: Bool = steepest.reshape(-1)[keys] > allowed
        return is_object

    def lack_of_objects(self, ground: Bool, limits: Residuals) -> Float64:
        """Return 1 where all cells around are ground, falling to 0 where a share `enough` is not: float64 [n]."""
        objects = self.raster.lowest((~ground).astype(np.int32), np.ones(ground.size, np.bool_))
        share = Boxes(objects).means(
            limits.around, self.raster.keys
        )  # A mean is never NaN: the cell is filled.
        return 1.0 - np.minimum(share / limits.enough, 1.0)
