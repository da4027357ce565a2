"""Cells in the passes of `auto`: the codes that a pass gives to the next one, and the drops that mark objects.

Each cell has one code, which applies to all its points. An object drops steeply: an opening
with a disk a little wider than the object removes its height, while terrain loses no more than
its slope gives. So a cell belongs to an object if for some radius r (in metres)::

    drop(r) - allowance > (per_metre + per_slope * slope) * r

Here drop(r) is the fall to the opening with r from that one cell smaller, both of the original
raster. The slope is that of the surface after the last opening (for seeds) or of the ground
(for residuals). For residuals the threshold also grows where there are few objects around.
Heights beyond a fixed distance do not change any of these results.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ptd.arrays import Bool, Float64, Int32, UInt8
from ptd.cells import CellIndex, Xyz, lowest_per_cell
from ptd.frame import CellLattice, Scale, Window
from ptd.ground.labelling import LOW_NOISE, UNCLASSIFIED
from ptd.ground.morphology import EMPTY, CellRaster, disk_minimum, steepest_drops
from ptd.ground.slopes import Boxes
from ptd.kernel import kernel
from ptd.passes import Model, Points, Stats

OBJECT, OUTLIER, SEED, DENSIFIED, ROOF = UNCLASSIFIED, LOW_NOISE, 3, 4, 6
"""Codes of cells between passes. Cells that stay ground after `refine` have the code
`GROUND` (`ptd.ground.labelling`). `ROOF` is also that of crowns on slopes."""
ABOVE_NOISE = 32
"""Bit of the codes of cells in which points below the elected one are low noise. It stays the
same in all passes."""

LEVEL_M = 0.3
"""Largest height difference of cells that vote on one another (`Lowest.outvoted`)."""
VOTERS, LOST_SHARE = 3, 0.75
"""Least number of votes, and the least share of them against a cell."""
ROUNDED_M = 1e-4
"""Unit of the heights beside a level (`Lowest.residual_objects`), so that the unit of the counts has no effect."""
ANNEX_ROUNDS = 2
"""Rounds in which `Lowest.annexes` searches, so that it finds two parts of a building one behind the other."""


class CellCodes(Model):
    """Model with a code per cell. Cells without a point are unclassified.

    Parameters
    ----------
    x, y : int32 [m]
        Local counts of a point of each cell, by rows of cells.
    codes : uint8 [m]
        Codes of the cells.
    cells : CellLattice
    certain : Window
        Window outside which all cells are uncertified.
    stats : dict
    uncertified : bool [m], optional
        Mask of the codes that points outside the window could change. By default all codes within `certain` are
        certified.
    """

    def __init__(
        self,
        x: Int32,
        y: Int32,
        codes: UInt8,
        cells: CellLattice,
        certain: Window,
        stats: Stats,
        uncertified: Bool | None = None,
    ) -> None:
        self.stats, self._certain = {"cells": int(x.size), **stats}, certain
        self._codes = np.append(codes, np.uint8(UNCLASSIFIED))
        self._uncertified = (
            np.zeros(x.size + 1, np.bool_)
            if uncertified is None
            else np.append(uncertified, False)
        )
        self._x, self._y, self._cells = x, y, cells
        self._index: CellIndex | None = None

    def label(self, points: Points) -> tuple[UInt8, Bool]:
        """Return the codes of the cells of points (uint8 [n]), and a mask of uncertified codes (bool [n])."""
        x, y, _ = points.columns()
        if np.array_equal(x, self._x) and np.array_equal(
            y, self._y
        ):  # In an untiled run the points are those of the model.
            codes, uncertified_codes = self._codes[:-1].copy(), self._uncertified[:-1].copy()
        else:
            slots = self._slots(x, y)
            codes, uncertified_codes = self._codes[slots], self._uncertified[slots]
        if points.labels is not None:
            codes |= points.labels & ABOVE_NOISE
        if self._certain.closed:
            w = self._certain
            uncertified_codes |= (x < w.west) | (y < w.south) | (x >= w.east) | (y >= w.north)
        return codes, uncertified_codes

    def _slots(self, x: Int32, y: Int32) -> Int32:
        """Return the index of the model's cell in which each point lies, or -1 if there is none: int32 [n]."""
        if self._x.size == 0:
            return np.full(x.size, -1, np.int32)
        if self._index is None:
            self._index = CellIndex(self._x, self._y, self._cells)
        return self._index.find(x, y)


def lowest_points(points: Points, cells: CellLattice) -> tuple[Int32, Int32, Int32, UInt8]:
    """Return x, y, z and code of the lowest point of each cell, by rows of cells.

    Codes have no bit `ABOVE_NOISE`, and are 0 before the first pass that gives labels.
    """
    x, y, z = points.columns()
    index = lowest_per_cell(x, y, z, cells)
    labels = np.zeros(index.size, np.uint8) if points.labels is None else points.labels[index]
    return x[index], y[index], z[index], labels & ~np.uint8(ABOVE_NOISE)


class ElectedCells(CellCodes):
    """Model that elects a point of each cell: the lowest that is not noise, or else the highest.

    Cells whose elected point is noise have the code `OUTLIER`, and cells with noise below the elected point the bit
    `ABOVE_NOISE`.

    Parameters
    ----------
    points : Xyz
        All points of a window.
    noise : bool [n]
        Mask of the points that are noise.
    cells : CellLattice
    certain : Window
        See `CellCodes`.
    """

    def __init__(self, points: Xyz, noise: Bool, cells: CellLattice, certain: Window) -> None:
        index = lowest_per_cell(*points, cells)
        codes = np.zeros(index.size, np.uint8)
        lowest_is_noise = noise[index]
        table = None
        if lowest_is_noise.any():
            table = CellIndex(points.x[index], points.y[index], cells)
            cell_of = table.find(points.x, points.y)
            changed = lowest_is_noise[cell_of]
            for which, sign, code in ((noise, -1, OUTLIER), (~noise, 1, ABOVE_NOISE)):
                among = np.flatnonzero(changed & which)
                x, y, z = (axis[among] for axis in points)
                found = among[lowest_per_cell(x, y, sign * z, cells)]
                index[cell_of[found]], codes[cell_of[found]] = found, code
        x, y, self._z = (axis[index] for axis in points)
        stats = {"low_noise": int(noise.sum())}
        super().__init__(x, y, codes, cells, certain, stats)
        self._index = table  # The elected points lie in the same cells.

    def elect(self, bounds: Window) -> Int32:
        """Return the elected points within bounds, by rows of cells."""
        inside = bounds.contains(self._x, self._y)
        return np.stack([self._x[inside], self._y[inside], self._z[inside]])


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
        return steepest.reshape(-1)[keys] > allowed

    def residual_objects(
        self, ground: Bool, present: Bool, limits: Residuals, level: Bool | None = None
    ) -> Bool:
        """Return a mask of the points that rise like objects after subtracting the mean of the ground: bool [n].

        Once the mean is subtracted, slopes do not hide low objects, so small radii and
        thresholds suffice. Where there are no objects around, a rise is more likely a bump of
        the terrain, so the threshold grows (`lack`). The points in ``level`` count as if they were at the mean.
        """
        boxes, drop, keys = Boxes(self.heights(ground)), limits.drop, self.raster.keys
        means = boxes.means(limits.trend, keys)
        trend = np.where(
            np.isnan(means), self.z, means
        )  # Without ground, a point is its own trend.
        residuals, parts = self.z - np.rint(trend), 1.0
        if level is not None:
            # Beside a level, the rounding of neighbours does not cancel.
            parts = float(self.scale.metres_z) / ROUNDED_M
            residuals = np.where(level, 0.0, np.rint((self.z - trend) * parts))
        steepest, _ = steepest_drops(
            self.raster.lowest(residuals.astype(np.int32), present),
            range(1, limits.radius + 1),
            self.scale.counts_z(drop.allowance_m) * parts,
        )
        allowed = drop.per_metre * self.unit + drop.per_slope * boxes.slopes(limits.slope, keys)
        allowed += limits.lack * self.unit * self.lack_of_objects(ground, limits)
        return steepest.reshape(-1)[keys] > allowed * parts

    def outvoted(self, before: Bool, stays: Bool, reach: int) -> Bool:
        """Return a mask of the cells that stay ground although most cells around them at their height do not: bool [n].

        ``before`` are the cells that were ground before, and ``reach`` is the half width of the square around a cell.
        """
        stays_ground, level = self.raster.occupied(stays), self.scale.counts_z(LEVEL_M)
        lost = _outvoted(self.heights(before), stays_ground, reach, level)
        return lost.reshape(-1)[self.raster.keys]

    def annexes(self, ground: Bool, roofs: Bool, limits: Residuals, near: int) -> Bool:
        """Return a mask of the ground that rises like an object within `near` cells of a roof or crown: bool [n].

        The mean of the ground stands in for the roofs, because an opening does not cut a low part of a building that
        ends at cells without ground. Once a part is found, the next round finds what it hid.
        """
        found, nothing = roofs, np.zeros_like(self.z)
        for _ in range(ANNEX_ROUNDS):
            left = ground & ~found
            beside = disk_minimum(self.raster.lowest(nothing, found), near) != EMPTY
            rises = self.residual_objects(left, left | found, limits, found)
            found = found | left & rises & beside.reshape(-1)[self.raster.keys]
        return found & ~roofs

    def lack_of_objects(self, ground: Bool, limits: Residuals) -> Float64:
        """Return 1 where all cells around are ground, falling to 0 where a share `enough` is not: float64 [n]."""
        objects = self.raster.lowest((~ground).astype(np.int32), np.ones(ground.size, np.bool_))
        share = Boxes(objects).means(
            limits.around, self.raster.keys
        )  # A mean is never NaN: the cell is filled.
        return 1.0 - np.minimum(share / limits.enough, 1.0)


@kernel
def _outvoted(heights: Int32, stays: Bool, reach: int, level: float) -> Bool:
    rows, columns = heights.shape
    lost = np.zeros((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            if not stays[row, column]:
                continue
            n, n_lost = -1, 0  # The cell itself is not counted.
            for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for c in range(max(column - reach, 0), min(column + reach + 1, columns)):
                    if heights[r, c] == EMPTY:
                        continue
                    rise = np.int64(heights[r, c]) - np.int64(heights[row, column])
                    if abs(rise) <= level:
                        n += 1
                        n_lost += not stays[r, c]
            lost[row, column] = n >= VOTERS and n_lost >= LOST_SHARE * n
    return lost
