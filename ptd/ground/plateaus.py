"""Wide roofs: connected surfaces whose edges fall on all sides.

A roof of any shape ends on all sides in a fall. Terrain continues somewhere: a hill at its
foot, a terrace at its ends or over a ramp. A connected surface is classified as a whole, so no
opening cuts a roof in two. A surface wider than a limit is terrain, whatever lies beyond, so
heights beyond a fixed distance do not change the result.

A lower roof may lean on a higher one, so its edge does not fall on that side. Therefore the
search is repeated without the roofs found before, and rays continue over them.

A surface that the border of the data cuts may continue there. A narrower limit applies to it,
and a surface that extends to opposite borders is terrain, for example an embankment across a
corridor.

Roofs that remain in a terrain model are found by the same rule. Between a roof and the ground next to it the model is
an interpolated ramp, which would join both. So steep cells do not count as ground, because the cloud has no ground
there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.frame import Scale
from ptd.ground.morphology import EAST, EMPTY, NORTH, CellRaster, connected_surfaces
from ptd.kernel import kernel

AREA, OTHERS, PAST, FALLS, UNSEEN, BORDER = 0, 1, 2, 3, 11, 12
"""Columns of the counts of each surface.

- `AREA`: cells.
- `OTHERS`: rays that met other ground.
- `PAST`: rays hidden by a roof found before.
- From `FALLS` on: rays that met lower ground, one column per direction.
- `UNSEEN`: rays that met no ground.
- From `BORDER` on: rays that leave the data, one column per direction.
"""

ROOF_CELL_M = 2.0
"""Size of the cells of ground from which surfaces are made. They bridge the gaps of sparse
clouds."""
ROOF_FALL_M = 1.5
"""Height difference above which ground is below a roof."""
ROOF_STEPS_M = (ROOF_FALL_M, ROOF_FALL_M, ROOF_FALL_M, 1.0)
"""Largest height difference of neighbours on a surface, for each search.

The first searches find a hall, roofs that lean on it, and roofs that lean on those. If all
steps were smaller than the fall, two flat roofs whose height difference lies between step and
fall would each count as ground that is not below the other, so both could remain ground. Larger
steps join a roof to terrain next to it. The last and smaller step separates them.
"""
ROOF_GAP_M = 8.0
"""Largest distance of neighbours on a surface. Higher parts of a building may separate the
parts of a roof."""
ROOF_VIEW_M = 24.0
"""Length of the rays that search for other ground, beyond objects around a roof."""
ROOF_SLOPE = 0.2
"""Slope that a fall must exceed, because distant ground is lower on any hill."""
ROOF_BELOW_SHARE = 0.9
"""Least share of the ground seen around a roof that lies below it."""
ROOF_UNSEEN_SHARE = 0.6
"""Largest share of the rays around a roof that meet no ground (trees, walls of courtyards, the
border of the data)."""
CUT_SIZE = 0.6
"""Factor of the largest width for roofs that the border of the data cuts. They may be terraces
that continue beyond it."""

BESIDE = 2
"""A ray that meets no ground does not count as unseen or as leaving the data, only in the
total, if a roof found before lies within this many cells of its start. This roof hides the
ground."""
CUT = 0.02
"""If a larger share than this of a surface's rays leave the data, the border of the data cuts
the surface."""
THROUGH = 3
"""A surface is terrain if at least this many of its rays leave the data on each of two opposite
sides, because it continues through a narrow survey."""


@dataclass(frozen=True)
class Plateaus:
    """Rule by which a surface is a roof. Lengths are in cells, heights in counts.

    Attributes
    ----------
    step : float
        Largest height difference of neighbouring cells on a surface.
    gap : int
        Largest distance of neighbours along one of the eight directions, over empty cells.
    view : int
        Length of the rays from each cell, along the eight directions, that search for ground outside the surface.
    fall, slope : float
        Ground is below the surface if it is lower by more than `fall` plus `slope` per cell of distance, because
        terrain itself slopes. It is not below if it is lower by at most `fall`. Between these limits the ray counts as
        unseen.
    share : float
        Least share of the ground seen around a roof that lies below it.
    unseen : float
        Largest share of the rays that meet no ground (walls of courtyards, trees, the border of the data) or ground
        between the limits. Rays that begin next to a roof found before are not among them.
    widest, widest_cut : int
        Largest number of rows and columns of a roof, and of a roof that the border of the data cuts.
    """

    step: float
    fall: float
    gap: int
    view: int
    slope: float
    share: float
    unseen: float
    widest: int
    widest_cut: int

    @classmethod
    def of(
        cls,
        scale: Scale,
        widest_m: float,
        step_m: float = ROOF_FALL_M,
        cell_m: float = ROOF_CELL_M,
    ) -> Self:
        """Return the rule for roofs up to ``widest_m`` wide whose neighbouring cells differ by at most ``step_m``.

        ``cell_m`` is the size of the cells. All three lengths are in metres.
        """

        def cells(metres: float) -> int:
            return max(round(metres / cell_m), 1)

        return cls(
            step=scale.counts_z(step_m),
            fall=scale.counts_z(ROOF_FALL_M),
            gap=cells(ROOF_GAP_M),
            view=cells(ROOF_VIEW_M),
            slope=scale.counts_z(ROOF_SLOPE * cell_m),
            share=ROOF_BELOW_SHARE,
            unseen=ROOF_UNSEEN_SHARE,
            widest=cells(widest_m),
            widest_cut=cells(CUT_SIZE * widest_m),
        )

    @property
    def rays(self) -> Rays:
        """The fields that determine the result of a ray."""
        return Rays(self.view, self.fall, self.slope)

    @property
    def reach(self) -> int:
        """Distance in cells beyond which heights do not change the result.

        If a surface continues beyond this distance, its part within the distance is already
        wider than `widest`, because the last cell of this part is at most `gap` cells from the
        limit. One further cell is for the edges (`on_plateaus`).
        """
        return self.widest + max(self.gap, self.view) + 1


class Rays(NamedTuple):
    """Fields of `Plateaus` that determine the result of a ray, as an argument of kernels."""

    view: int
    fall: float
    slope: float


def on_plateaus(
    z: Int32, ground: Bool, before: Bool, raster: CellRaster, roof_rule: Plateaus
) -> Bool:
    """Find the ground points on surfaces above their surroundings: bool [n].

    These are all ground points in cells of such surfaces. A cell next to such a surface can
    contain both ground and roof, and its lowest point is the ground. Points more than
    `Plateaus.fall` above this point are on the roof, too.

    Parameters
    ----------
    z : int32 [n]
        Heights of the points in counts.
    ground, before : bool [n]
        Masks of the ground points, and of the points found on roofs before, which are not ground any more.
    raster : CellRaster
        Raster of the points.
    roof_rule : Plateaus
    """
    heights = raster.lowest(z, ground)
    roof = plateaus(heights, roof_rule, raster.occupied(before), raster.occupied())
    beside = scipy.ndimage.maximum_filter(roof, size=3, mode="constant", cval=False)
    higher = z - heights.reshape(-1)[raster.keys].astype(np.int64) > roof_rule.fall
    return ground & (roof.reshape(-1)[raster.keys] | beside.reshape(-1)[raster.keys] & higher)


def plateaus(
    heights: Int32,
    roof_rule: Plateaus,
    removed: Bool | None = None,
    data: Bool | None = None,
    passed: Bool | None = None,
) -> Bool:
    """Find the cells of a raster on surfaces above their surroundings: bool [rows, columns].

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights of ground in counts; `EMPTY` where there is none.
    roof_rule : Plateaus
    removed : bool [rows, columns], optional
        Cells of roofs found before; none by default.
    data : bool [rows, columns], optional
        Cells with any point; the cells of ground by default.
    passed : bool [rows, columns], optional
        Cells of ground over which the rays of other surfaces continue; none by default.
    """
    removed = np.zeros(heights.shape, np.bool_) if removed is None else removed
    passed = np.zeros(heights.shape, np.bool_) if passed is None else passed
    data = heights != EMPTY if data is None else data
    limit = math.floor(roof_rule.step) + 1  # heights are whole numbers
    surface, n = connected_surfaces(heights, limit, limit, roof_rule.gap)
    looks, box = look_around(
        heights,
        surface,
        removed,
        data,
        passed,
        n,
        roof_rule.rays,
    )
    falls, border = looks[:, FALLS:UNSEEN].sum(axis=1), looks[:, BORDER:]
    seen = falls + looks[:, OTHERS]
    unseen = looks[:, UNSEEN] + border.sum(axis=1)
    every = seen + unseen + looks[:, PAST]
    above = (
        (seen > 0) & (falls >= roof_rule.share * seen) & (unseen <= roof_rule.unseen * every)
    )
    wide = np.maximum(box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]) + 1
    cut = border.sum(axis=1) > CUT * every
    ends = wide <= np.where(cut, roof_rule.widest_cut, roof_rule.widest)
    opposite = np.minimum(border[:, :2], border[:, 2:4])  # east and west, north and south
    through = (opposite >= THROUGH).any(axis=1)
    # Cells without a surface have the number -1, the last entry.
    return np.append(above & ends & ~through, False)[surface]


@kernel
def look_around(
    heights: Int32,
    surface: Int32,
    removed: Bool,
    data: Bool,
    passed: Bool,
    n: int,
    rays: Rays,
) -> tuple[Int64, Int64]:
    """Count the cells and rays of each surface (columns `AREA` to `BORDER` + 7), and find its bounding box."""
    view, fall, slope = rays
    rows, columns = heights.shape
    looks, box = np.zeros((n, BORDER + 8), np.int64), np.zeros((n, 4), np.int64)
    for row in range(rows):
        for column in range(columns):
            number = surface[row, column]
            if number < 0:
                continue
            if looks[number, AREA] == 0:
                box[number, :2], box[number, 2:] = row, column
            looks[number, AREA] += 1
            box[number, 0], box[number, 1] = min(box[number, 0], row), max(box[number, 1], row)
            box[number, 2], box[number, 3] = (
                min(box[number, 2], column),
                max(box[number, 3], column),
            )
            for way in range(8):
                met, joined = BORDER + way, False
                for steps in range(1, view + 1):
                    r, c = row + steps * NORTH[way], column + steps * EAST[way]
                    if r < 0 or c < 0 or r >= rows or c >= columns:
                        break
                    if surface[r, c] == number:
                        met = AREA
                        break
                    if met >= BORDER and data[r, c]:
                        met = UNSEEN
                    joined |= steps <= BESIDE and removed[r, c]
                    if surface[r, c] >= 0 and not passed[r, c]:
                        lower = np.int64(heights[row, column]) - np.int64(heights[r, c])
                        if lower > fall + slope * steps:
                            met = FALLS + way
                        elif lower <= fall:
                            met = OTHERS
                        break
                if met != AREA:
                    # A roof found before hides the ground here.
                    looks[number, PAST if joined and met >= UNSEEN else met] += 1
    return looks, box


MAX_WIDTH_M = 240.0
"""Width of the widest roof that is found."""
MILLIMETRES = Scale()


class RemainingRoof(NamedTuple):
    """A surface of the terrain that looks like a roof.

    Attributes
    ----------
    width_m : float
        Diameter of the largest circle inside, including the edge, in metres.
    row, column : float
        Centre of the surface's bounding box in cells.
    """

    width_m: float
    row: float
    column: float


def remaining_roofs(
    heights: Float64, cell_m: float = ROOF_CELL_M, min_width_m: float = 0.0
) -> list[RemainingRoof]:
    """Find the connected surfaces of a terrain model that lie above their surroundings.

    Each search depends on heights up to `reach_m` from a cell, and on the roofs found by the
    searches before.

    Parameters
    ----------
    heights : float64, shape (rows, columns)
        Heights in metres, NaN where unknown.
    cell_m : float
        Size of a cell in metres.
    min_width_m : float
        Width in metres below which surfaces are left out.
    """
    known = ~np.isnan(heights)
    if not known.any():
        return []
    counts, rises = np.full(heights.shape, EMPTY, np.int32), _rises(heights, known)
    counts[known] = np.rint(1000 * heights[known])
    is_roof = np.zeros(heights.shape, np.bool_)
    for step_m in ROOF_STEPS_M:
        roof_rule = Plateaus.of(MILLIMETRES, MAX_WIDTH_M, step_m, cell_m)
        ground = np.where(is_roof | (rises > step_m), EMPTY, counts).astype(np.int32)
        is_roof |= plateaus(ground, roof_rule, is_roof, known)
    numbers, _ = scipy.ndimage.label(is_roof, np.ones((3, 3)))
    boxes = scipy.ndimage.find_objects(numbers)
    roofs = (
        _measured(numbers[box] == number, box, cell_m)
        for number, box in enumerate(boxes, start=1)
    )
    return [roof for roof in roofs if roof.width_m >= min_width_m]


def _rises(heights: Float64, known: Bool) -> Float64:
    """Return the largest difference of each known height to those of its neighbours."""
    highest = scipy.ndimage.maximum_filter(np.where(known, heights, -np.inf), 3)
    lowest = scipy.ndimage.minimum_filter(np.where(known, heights, np.inf), 3)
    return np.maximum(highest - heights, heights - lowest)


def _measured(piece: Bool, box: tuple[slice, ...], cell_m: float) -> RemainingRoof:
    """Return the roof with the given cells. A row of cells at its edge was too steep to be found."""
    depth = scipy.ndimage.distance_transform_edt(np.pad(piece, 1))
    row, column = ((extent.start + extent.stop) / 2 for extent in box)
    return RemainingRoof(2 * (float(depth.max()) + 1) * cell_m, row, column)


def reach_m(cell_m: float = ROOF_CELL_M) -> float:
    """Return the distance in metres beyond which heights do not change the result of one search for roofs."""
    return (Plateaus.of(MILLIMETRES, MAX_WIDTH_M, cell_m=cell_m).reach + 1) * cell_m
