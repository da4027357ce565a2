"""Find wide roofs: connected surfaces whose edges fall on all sides.

A roof of any shape ends on all sides in a fall, where terrain goes on somewhere: a hill by its foot, a terrace by its
ends, a ramp. So a roof is a whole connected surface, or nothing of it is: no opening cuts it in two. A surface wider
than a limit is terrain, whatever lies beyond; so nothing farther than a fixed reach has a part in the answer.

Lower roofs lean on higher ones: beside a hall they see what does not fall. So it is done again without the roofs found
before, over which rays go on.

Where the border of the data cuts a surface, it may go on: a narrower limit holds, and what reaches opposite borders is
terrain, as an embankment across a corridor is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
import scipy

from ptd.cells import Int32, Int64
from ptd.frame import Scale
from ptd.ground.connected import EAST, NORTH, connected_surfaces
from ptd.ground.morphology import EMPTY, Bool, CellRaster
from ptd.kernel import kernel

_AREA, _FALLS, _OTHERS, _PAST, _UNSEEN, _BORDER = range(6)
"""What is counted of each surface; from the last on, looks along each of the eight ways that leave the data."""

ROOF_CELL_M = 2.0
"""Side of the cells of ground that surfaces are made of: they bridge the gaps of sparse clouds."""
ROOF_FALL_M = 1.5
"""What lies lower by more is below a roof."""
ROOF_STEPS_M = (ROOF_FALL_M, ROOF_FALL_M, ROOF_FALL_M, 1.0)
"""Neighbours on a surface differ by no more, each time that roofs are looked for: a hall, what leans on it, and what
leans on that. With a step below the fall alone, two flat roofs whose heights differ by something in between would keep
each other as ground; the last and smaller one parts roofs from the terrain beside them, to which larger ones join."""
ROOF_GAP_M = 8.0
"""Neighbours are no farther apart: parts of a roof lie among higher ones."""
ROOF_VIEW_M = 24.0
"""Distance within which other ground is looked for: past what stands around a roof."""
ROOF_SLOPE = 0.2
"""What is seen far away lies lower on any hill: a fall has to be steeper than this."""
ROOF_BELOW_SHARE = 0.9
"""Least share of the ground seen around a roof that lies below it."""
ROOF_UNSEEN_SHARE = 0.6
"""Largest share of all looks around a roof that meet no ground (trees, walls of courtyards, the border of the data)."""
CUT_SIZE = 0.6
"""Share of the widest roof's width for roofs that the border of the data cuts: a terrace may go on there."""

BESIDE = 2
"""A ray that starts within so many cells of a roof found before, and meets nothing, is left out: what hides the ground
there is known."""
CUT = 0.02
"""Share of the looks around that leave the data from which on a surface is cut by their border."""
THROUGH = 3
"""Looks that leave the data on one side, and as many on the opposite one: terrain that goes through a narrow survey."""


@dataclass(frozen=True)
class Plateaus:
    """When a surface is a roof; lengths and areas in cells, heights in counts.

    Attributes
    ----------
    step : float
        Cells are of one surface where their heights differ by no more.
    gap : int
        Also if so many steps lie between them, along one of the eight directions, over empty cells.
    view : int
        As far is looked from each cell, along the eight directions, for what is no part of the surface.
    fall, slope : float
        What lies lower by more than `fall` and `slope` for each cell of distance lies below: terrain slopes. What lies
        between the first and both could be either; such a look says nothing.
    share : float
        Of what is seen around, so much at least lies below.
    unseen : float
        Of the looks around, so many at most meet or say nothing: walls of courtyards, trees, the border of the data;
        those that begin beside a roof found before are not among them.
    widest, widest_cut : int
        At most so many columns and rows; and of what the border of the data cuts.
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
        cls, scale: Scale, widest_m: float, step_m: float = ROOF_FALL_M, cell_m: float = ROOF_CELL_M
    ) -> Self:
        """The rule for roofs whose neighbouring cells differ by no more than a step."""

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
    def reach(self) -> int:
        """Cells beyond which nothing has a part in the answer.

        A surface that goes on beyond is wider than `widest` already by what is seen of it: the last cell that is seen
        is no more than `gap` from the border. One cell more is for the edges (`on_plateaus`).
        """
        return self.widest + max(self.gap, self.view) + 1


def on_plateaus(z: Int32, ground: Bool, before: Bool, raster: CellRaster, rule: Plateaus) -> Bool:
    """Find the points of ground on surfaces above their surroundings: bool [n].

    That is all in cells of such surfaces; and in the cells at their edges, whose lowest point lies beside the roof,
    what is higher than that by more than `Plateaus.fall`.

    Parameters
    ----------
    z : int32 [n]
        Counts.
    ground, before : bool [n]
        Which are ground; which were found on roofs before, and are no ground any more.
    raster : CellRaster
        Of the points.
    rule : Plateaus
    """
    heights = raster.lowest(z, ground)
    removed = np.zeros(heights.size, np.bool_)
    removed[raster.keys[before]] = True
    data = np.zeros(heights.size, np.bool_)
    data[raster.keys] = True
    roof = plateaus(heights, rule, removed.reshape(heights.shape), data.reshape(heights.shape))
    beside = scipy.ndimage.maximum_filter(roof, size=3, mode="constant", cval=False)
    higher = z - heights.reshape(-1)[raster.keys].astype(np.int64) > rule.fall
    found: Bool = ground & (roof.reshape(-1)[raster.keys] | beside.reshape(-1)[raster.keys] & higher)
    return found


def plateaus(heights: Int32, rule: Plateaus, removed: Bool | None = None, data: Bool | None = None) -> Bool:
    """Find the cells of a raster on surfaces above their surroundings: bool, of its shape.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Of ground, counts; `EMPTY` where there is none.
    rule : Plateaus
    removed : bool [rows, columns], optional
        Cells of roofs found before; none if left out.
    data : bool [rows, columns], optional
        Cells with any point; those of ground if left out.
    """
    removed = np.zeros(heights.shape, np.bool_) if removed is None else removed
    data = heights != EMPTY if data is None else data
    limit = math.floor(rule.step) + 1  # heights are whole numbers
    surface, n = connected_surfaces(heights, limit, limit, rule.gap)
    looks, box = _looks(heights, surface, removed, data, n, rule.view, rule.fall, rule.slope)
    seen, border = looks[:, _FALLS] + looks[:, _OTHERS], looks[:, _BORDER:]
    unseen = looks[:, _UNSEEN] + border.sum(axis=1)
    every = seen + unseen + looks[:, _PAST]
    above = (seen > 0) & (looks[:, _FALLS] >= rule.share * seen) & (unseen <= rule.unseen * every)
    wide = np.maximum(box[:, 1] - box[:, 0], box[:, 3] - box[:, 2]) + 1
    cut = border.sum(axis=1) > CUT * every
    ends = wide <= np.where(cut, rule.widest_cut, rule.widest)
    opposite = np.minimum(border[:, :2], border[:, 2:4])  # east and west, north and south
    through = (opposite >= THROUGH).any(axis=1)
    found: Bool = np.append(above & ends & ~through, False)[surface]  # -1: no surface
    return found


@kernel
def _looks(
    heights: Int32, surface: Int32, removed: Bool, data: Bool, n: int, view: int, fall: float, slope: float
) -> tuple[Int64, npt.NDArray[np.int64]]:
    """Counts for each surface, `_AREA` (cells) to `_BORDER` (rays that leave the data), and its box."""
    rows, columns = heights.shape
    looks, box = np.zeros((n, _BORDER + 8), np.int64), np.zeros((n, 4), np.int64)
    for row in range(rows):
        for column in range(columns):
            own = surface[row, column]
            if own < 0:
                continue
            if looks[own, _AREA] == 0:
                box[own, :2], box[own, 2:] = row, column
            looks[own, _AREA] += 1
            box[own, 0], box[own, 1] = min(box[own, 0], row), max(box[own, 1], row)
            box[own, 2], box[own, 3] = min(box[own, 2], column), max(box[own, 3], column)
            for way in range(8):
                met, joined = _BORDER + way, False
                for steps in range(1, view + 1):
                    r, c = row + steps * NORTH[way], column + steps * EAST[way]
                    if r < 0 or c < 0 or r >= rows or c >= columns:
                        break
                    if surface[r, c] == own:
                        met = _AREA
                        break
                    if met >= _BORDER and data[r, c]:
                        met = _UNSEEN
                    joined |= steps <= BESIDE and removed[r, c]
                    if surface[r, c] >= 0:
                        lower = np.int64(heights[row, column]) - np.int64(heights[r, c])
                        if lower > fall + slope * steps:
                            met = _FALLS
                        elif lower <= fall:
                            met = _OTHERS
                        break
                if met != _AREA:
                    # What hides the ground here is known: a roof.
                    looks[own, _PAST if joined and met >= _UNSEEN else met] += 1
    return looks, box
