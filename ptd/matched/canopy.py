"""Closed canopy on matched clouds: where crowns hide the ground, and where they were taken for it.

Image matching sees no ground below closed crowns. What it does see tells them from other things:

- A *wavy* surface of the ground climbed onto crowns: residuals of planes over 9 m are some decimetres nearly
  everywhere around, and its slopes scatter in every direction. A fold, a dam or a cliff bends one way, steep terrain
  falls one way, lava and grass are lower. Crowns are bounded: over 25 m the surface is not much rougher. And they are
  what is seen: little stands above them. Beside trees on a steep slope the surface bends, too, but they stand above it.
- *Tall* cells stand above the ground found, and are rough over 5 m, as halls are not. Roofs side by side are, but many
  of their cells lie in one plane with their neighbours.

The canopy is what these cover together, less small openings, if a square fits into it: a smaller one where half of it
is wavy, a larger one where all of it is tall, as gardens and gables are rough, too. In it, crowns that were taken for
ground are no ground; ground that was seen beside and between them stays, as far as it goes on without a step, but for
pits in crowns, far less deep than the trees are tall where their foot is seen. Every sum ends at a fixed distance, so
nothing beyond `reach_cells` has a part in the answer.

Colours are not asked: a store holds them for the few methods that need them alone. What they would add, and what is
found and lost, is in ``docs/filters.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from ptd.ground.morphology import Bool
from ptd.matched.crowns import residuals
from ptd.matched.surface import Surface

Float64 = npt.NDArray[np.float64]

AROUND_M = 25.0
"""Side of the squares in which shares and the scatter of slopes are reckoned: several crowns."""
WAVES_M, WAVE_M = 9.0, 0.3
"""Side of the windows of planes over several crowns, and the residual from which on a surface is rough over them: noise
and grass leave less, rocks, too, mostly."""
TEXTURE_M, TEXTURE = 5.0, 0.3
"""Side of the windows of planes over a crown, and the residual from which on what is tall is no roof."""
TALL_M = 1.0
"""What rises less above the ground is no crown that hides it."""
SLOPE_M = 2.0
"""Slopes are between cells so far away to both sides."""
ROUGH_SHARE, SCATTER, ONE_WAY = 0.6, 0.17, 0.8
"""A surface is wavy where more than this share of the cells around is rough, where its slopes scatter by this standard
deviation in the direction in which they do least, and where their mean is shorter than this part of their lengths'."""
BOUNDED = 0.3
"""Crowns are bounded: residuals of planes over several of them are more than this part of those over `AROUND_M`. On
bare slopes, ridges and rocks they go on to grow."""
OVER, TILT = 2.0, 1.1
"""Where the surface goes over crowns, they are what is seen: all heights are less than so many times as rough as it is.
Where plants stand above a surface that they drag up, heights are rougher. Asked where slopes scatter by less than so
many times their mean: steep ground bends in many ways beside what stands on it."""
CLOSED_M = 7.0
"""Side of openings that are part of a canopy."""
WAVY_M, WAVY_SHARE, TALL_SIDE_M = 24.0, 0.5, 40.0
"""Sides of the squares that fit into a canopy: of this share of wavy cells, and of any."""
PLANE_CELLS, PLANE_M, PLANE_SHARE = 3, 0.15, 0.25
"""Cells on a side of windows of planes within a roof, the residual up to which one is a plane, and the share of the
tall cells in a square of `TALL_SIDE_M` from which on they are roofs: crowns have next to no planes."""
GROWN_M, STEEPEST = 8.0, 0.3
"""Seen ground goes on so far into what is wavy, where it rises no more than this from cell to cell."""


PIT_M, WIDE_M, TREES_M, PIT_SHARE = 15.0, 6.0, 160.0, 0.5
"""Sides of the squares that hold the top from which the depth of ground is reckoned, that fit into a wide opening, and
in which the mean depth of the ground in wide openings tells how tall the trees are; what is less deep than this part of
it is no ground, but a pit. The deepest ground would be that at the foot of a cliff."""


class Canopy(NamedTuple):
    """What crowns cover; bool [rows, columns] each.

    Attributes
    ----------
    covered : cells of a closed canopy and of small openings in it
    crowns : those of them that were taken for ground, and are none
    """

    covered: Bool
    crowns: Bool


def reach_cells(cell_m: float) -> int:
    """Cells beyond which nothing has a part in `canopy`, the surface apart."""
    wavy = 2 * (_side(AROUND_M, cell_m) // 2)
    shape = 2 * (_side(CLOSED_M, cell_m) // 2 + _side(TALL_SIDE_M, cell_m) // 2)
    pits = 2 * (_side(WIDE_M, cell_m) // 2) + _side(PIT_M, cell_m) // 2 + _side(TREES_M, cell_m) // 2
    return wavy + shape + _steps(cell_m) + pits


def canopy(heights: Float64, surface: Surface, ground: Bool, cell_m: float) -> Canopy:
    """Where a closed canopy hides the ground.

    Parameters
    ----------
    heights : float64 [rows, columns]
        Metres, of all cells; NaN elsewhere.
    surface : Surface
        The ground's surface, as if there were no canopy.
    ground : bool [rows, columns]
        Cells that lie about it.
    cell_m : float
        Side of the cells.
    """
    there, around = np.isfinite(heights), _Squares(cell_m)
    found = np.where(there & np.isfinite(surface.narrowing), surface.height, np.nan)
    wavy = _wavy(heights, found, around)
    tall = there & ~ground & ~(heights - surface.height < TALL_M)  # where there is no surface, too
    closed = around.closed(wavy | tall & _rough(heights, cell_m), CLOSED_M)
    half = around.mean(wavy.astype(np.float64), there, WAVY_M) > WAVY_SHARE
    climbed = there & around.opened(closed, WAVY_M) & half
    wide = there & around.opened(closed, TALL_SIDE_M)
    if wide.any():
        wide &= ~_roofs(heights, tall, around)
    seen = _grown(heights, ground & ~wide & ~climbed & ~wavy, ground & climbed, cell_m)
    covered, crowns = (wide | climbed) & ~seen, climbed & ~seen
    return Canopy(covered, crowns | covered & _pits(heights, ground & ~crowns, covered, around))


def may_be(heights: Float64, cell_m: float) -> Bool:
    """Cells that a canopy may cover, whatever the surface is: squares of rough ones fit in."""
    around = _Squares(cell_m)
    waves = _rough_around(residuals(heights, _side(WAVES_M, cell_m)), around)
    closed = around.closed(waves | _rough(heights, cell_m), CLOSED_M)
    half = around.mean(waves.astype(np.float64), np.isfinite(heights), WAVY_M) > WAVY_SHARE
    found: Bool = around.opened(closed, WAVY_M) & half | around.opened(closed, TALL_SIDE_M)
    return found


def _rough(heights: Float64, cell_m: float) -> Bool:
    """Cells beside which heights differ as those of a crown do."""
    found: Bool = residuals(heights, _side(TEXTURE_M, cell_m)) > TEXTURE
    return found


def _rough_around(waves: Float64, around: _Squares) -> Bool:
    """Cells of a surface that is rough over several crowns nearly everywhere around, from its residuals."""
    known = np.isfinite(waves)
    found: Bool = known & (around.mean((waves > WAVE_M).astype(np.float64), known, AROUND_M) > ROUGH_SHARE)
    return found


def _wavy(heights: Float64, found: Float64, around: _Squares) -> Bool:
    """Cells around which the surface of the ground goes over crowns."""
    waves, all_waves = (residuals(v, _side(WAVES_M, around.cell_m)) for v in (found, heights))
    wavy = _rough_around(waves, around) & _rough_around(all_waves, around)
    if not wavy.any():  # as nearly everywhere: what follows is most of the work
        return wavy
    scatter, one_way, tilt = _slopes(found, around)
    wavy &= (scatter > SCATTER) & (one_way < ONE_WAY)
    surface = _mean_around(waves, around)
    bounded = surface > BOUNDED * _mean_around(residuals(found, _side(AROUND_M, around.cell_m)), around)
    seen = _mean_around(all_waves, around) < OVER * surface
    found_wavy: Bool = wavy & bounded & (seen | (scatter > TILT * tilt))
    return found_wavy


def _mean_around(left: Float64, around: _Squares) -> Float64:
    return around.mean(left, np.isfinite(left), AROUND_M)


def _roofs(heights: Float64, tall: Bool, around: _Squares) -> Bool:
    """Places where many of the tall cells lie in one plane with their neighbours."""
    plane = tall & (residuals(heights, PLANE_CELLS) < PLANE_M)
    found: Bool = around.mean(plane.astype(np.float64), tall, TALL_SIDE_M) > PLANE_SHARE
    return found


def _slopes(found: Float64, around: _Squares) -> tuple[Float64, Float64, Float64]:
    """Least scatter of the slopes around each cell, how far they fall one way, and the slope of their mean."""
    far = _far(around.cell_m)
    north, east = np.full(found.shape, np.nan), np.full(found.shape, np.nan)
    run = 2 * far * around.cell_m
    north[far:-far] = (found[2 * far :] - found[: -2 * far]) / run
    east[:, far:-far] = (found[:, 2 * far :] - found[:, : -2 * far]) / run
    known = np.isfinite(north) & np.isfinite(east)
    north, east = np.where(known, north, 0.0), np.where(known, east, 0.0)

    def mean(values: Float64) -> Float64:
        return around.mean(values, known, AROUND_M)

    x, y = mean(east), mean(north)
    xx, yy, xy = mean(east * east) - x * x, mean(north * north) - y * y, mean(east * north) - x * y
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    tilt = np.hypot(x, y)
    one_way = tilt / np.maximum(mean(np.hypot(east, north)), 1e-9)
    return np.sqrt(np.maximum(least, 0.0)), one_way, tilt


def _grown(heights: Float64, seen: Bool, may_join: Bool, cell_m: float) -> Bool:
    """Seen ground, and what it goes on to without a step."""
    step = STEEPEST * cell_m
    found = seen.copy()
    for _ in range(_steps(cell_m)):
        joined = np.zeros_like(found)
        for axis in (0, 1):
            for way in (1, -1):
                beside = np.roll(found, way, axis)
                rise = np.abs(heights - np.roll(heights, way, axis))
                joined |= beside & (rise < step)
        found |= joined & may_join
    return found


def _pits(heights: Float64, ground: Bool, covered: Bool, around: _Squares) -> Bool:
    """Cells far less deep below the tops of the crowns beside them than ground in wide openings is."""
    crowns = np.where(covered & ~ground, heights, -np.inf)
    tops = around.highest(crowns, PIT_M)
    beside = ground & np.isfinite(tops)
    depth = np.where(beside, tops - heights, 0.0)
    trees = around.mean(depth, beside & around.opened(ground, WIDE_M), TREES_M)
    pits: Bool = beside & (depth < PIT_SHARE * trees)
    return pits


@dataclass(frozen=True)
class _Squares:
    """Squares around cells of a raster; nothing is beyond the raster."""

    cell_m: float

    def mean(self, values: Float64, known: Bool, side_m: float) -> Float64:
        """Mean of the known values around each cell; 0 where none is known."""
        weights = np.ones(_side(side_m, self.cell_m))

        def total(
            of: Float64,
        ) -> Float64:  # each square by itself: running sums depend on where the raster begins
            along: Float64 = scipy.ndimage.correlate1d(of, weights, axis=1, mode="constant")
            found: Float64 = scipy.ndimage.correlate1d(along, weights, axis=0, mode="constant")
            return found

        return total(np.where(known, values, 0.0)) / np.maximum(total(known.astype(np.float64)), 1.0)

    def highest(self, values: Float64, side_m: float) -> Float64:
        """Highest value around each cell, minus infinity beyond the raster."""
        side = _side(side_m, self.cell_m)
        found: Float64 = scipy.ndimage.maximum_filter(values, side, mode="constant", cval=-np.inf)
        return found

    def closed(self, cells: Bool, side_m: float) -> Bool:
        """Cells, and openings among them that no square of this side fits into."""
        side = _side(side_m, self.cell_m)
        wide: Bool = scipy.ndimage.maximum_filter(cells, side, mode="constant")
        found: Bool = scipy.ndimage.minimum_filter(wide, side, mode="constant")
        return found

    def opened(self, cells: Bool, side_m: float) -> Bool:
        """Cells that a square of this side covers that holds nothing else."""
        side = _side(side_m, self.cell_m)
        inner: Bool = scipy.ndimage.minimum_filter(cells, side, mode="constant")
        found: Bool = scipy.ndimage.maximum_filter(inner, side, mode="constant")
        return found


def _side(metres: float, cell_m: float) -> int:
    """Cells, an odd number, on the side of a square."""
    return 2 * round(metres / cell_m / 2 - 0.25) + 1


def _far(cell_m: float) -> int:
    """Cells between which there are slopes, to either side."""
    return round(SLOPE_M / cell_m)


def _steps(cell_m: float) -> int:
    """Cells that seen ground grows."""
    return round(GROWN_M / cell_m)
