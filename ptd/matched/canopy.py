"""Closed canopy of photogrammetric clouds: areas where crowns hide the ground or were classified as ground.

Images show no ground below closed crowns. Two properties of the points distinguish crowns from
other surfaces:

- The ground surface is *wavy* where it climbed onto crowns. In most of the surroundings,
  residuals of planes over 9 m are some decimetres, and its slopes scatter in every direction. A
  fold, a dam or a cliff bends one way only, steep terrain falls one way only, and lava and
  grass leave smaller residuals. Crowns are bounded: over 25 m the surface is not much rougher.
  The surface consists of the crowns, so little stands above it. The surface next to trees on a
  steep slope bends as well, but these trees stand above it.
- Cells are *tall* if they stand above the ground that was found. Of tall cells, those that are
  rough over 5 m may be crowns. Halls are not rough. Adjacent roofs are rough, but many of their
  cells lie in one plane with their neighbours.

The canopy is the area that wavy and tall cells cover together, with small openings filled. A square must fit into it: a
smaller one if half of it is wavy, a larger one otherwise, because gardens and gables are rough, too. In the canopy,
crowns that were classified as ground are not ground. Ground seen next to and between them stays as far as it continues
without a step. Pits in crowns do not stay: they are far shallower than the trees are high. The height of trees is
measured where the ground at their foot is visible. When these crowns are removed, the surface may still run over
others, so `pits` is called again for it. Every sum ends at a fixed distance, so cells farther than `reach_cells` do
not change the result.

Colours are not used, because a store contains them only for the few methods that need them.
``docs/filters.md`` reports what colours would add, and which canopies are found and missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int64
from ptd.gridding.ground_cells import box_sums
from ptd.matched.crowns import residuals
from ptd.matched.surface import Surface

UNIT = 2.0**-20
"""Unit of the values whose means are computed."""

AROUND_M = 25.0
"""Side of the squares in which shares and the scatter of slopes are computed: they contain
several crowns."""
WAVE_WINDOW_M, MIN_WAVE_RESIDUAL_M = 9.0, 0.3
"""Side of the windows of planes over several crowns, and the residual above which a surface is
rough over them. Noise and grass leave smaller residuals, and mostly rocks do, too."""
TEXTURE_M, TEXTURE = 5.0, 0.3
"""Side of the windows of planes over a crown, and the residual above which a tall cell may be a
crown."""
TALL_M = 1.0
"""Minimum height of a crown above the ground. Lower plants do not hide the ground."""
SLOPE_M = 2.0
"""Distance, to both sides, of the cells between which slopes are computed."""
ROUGH_SHARE, SCATTER, ONE_WAY = 0.6, 0.17, 0.8
"""Limits of a wavy surface: share of rough cells around, scatter of slopes, and evenness of their direction.

The share is larger than `ROUGH_SHARE`. The standard deviation of the slopes, in the direction
in which they scatter least, is larger than `SCATTER`. The length of the mean slope is less than
`ONE_WAY` times the mean length.
"""
BOUNDED = 0.3
"""Ratio of residuals of planes over `WAVE_WINDOW_M` to those over `AROUND_M` that crowns
exceed, because they are bounded. On bare slopes, ridges and rocks the residuals continue to
grow with the window."""
OVER, TILT = 2.0, 1.1
"""Ratio of the residuals of all cells to those of the surface, and ratio of the scatter of slopes to their mean.

A surface that runs over crowns consists of them, so all cells are less than `OVER` times as
rough as the surface. Cells are rougher where plants stand above a surface that they drag up.
The condition applies only where slopes scatter by at most `TILT` times their mean: steep ground
bends in many ways next to what stands on it.
"""
CLOSED_M = 7.0
"""Side of openings that are part of a canopy."""
WAVY_SQUARE_M, WAVY_SHARE, TALL_SIZE_M = 24.0, 0.5, 40.0
"""Side of the squares that fit into a canopy of wavy cells, the share of wavy cells that they
need, and side of the squares that fit into any other canopy."""
PLANE_CELLS, PLANE_M, PLANE_SHARE = 3, 0.15, 0.25
"""Limits of roofs: cells on a side of the windows of planes, largest residual of a plane, and share of planes.

Tall cells are roofs if more than this share of those in a square of `TALL_SIZE_M` is planes.
Crowns have hardly any.
"""
GROWN_M, STEEPEST = 8.0, 0.3
"""Distance in metres to which seen ground continues into a canopy of wavy cells, and its
largest slope from cell to cell."""


AMID_M, AMID, CROWDED = 41.0, 0.3, 0.3
"""Side of the squares around a pit of which a canopy covers more than `AMID`, and smallest share of
crowns in the square of `PIT_M`."""
PIT_M, WIDE_M, PIT_SHARE = 15.0, 6.0, 0.5
"""Sides of two squares, and part of the height of trees below which an opening is a pit and not ground.

The depth of the surface is measured from the highest crown in the first square. A wide opening is
one into which the second square fits. The mean depth of the ground in wide openings is the height of
the trees. The largest depth would not do: it may be that of ground at the foot of a cliff.
"""
TREES_M, LAND = 140.0, 0.25
"""Side of the squares in which the height of trees is the mean depth of land, and share of wide openings in the square
of `AMID_M` from which on they are land. In the middle of a wood crowns may look like wide openings, but seldom like
land. As they may, the height of trees farther away counts if it is larger."""


class Canopy(NamedTuple):
    """Masks of the cells that crowns cover.

    Attributes
    ----------
    covered : bool [rows, columns]
        Cells of a closed canopy and of small openings in it.
    crowns : bool [rows, columns]
        Cells to remove: pits, and all cells of a canopy that the surface climbed except visible ground.
    land_depths : float64 [rows, columns]
        Depths of land below the crowns around it in metres, NaN elsewhere. Pits may be among it, so that the radii of
        both do not add up.
    """

    covered: Bool
    crowns: Bool
    land_depths: Float64


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells beyond which heights do not change `canopy`, for a given surface."""
    wavy = 2 * (_odd_cells(AROUND_M, cell_m) // 2)
    shape = 2 * (_odd_cells(CLOSED_M, cell_m) // 2 + _odd_cells(TALL_SIZE_M, cell_m) // 2)
    return wavy + shape + _steps(cell_m) + pit_reach_cells(cell_m, 1)


def pit_reach_cells(cell_m: float, rounds: int) -> int:
    """Return the distance in cells beyond which cells do not change `pits`, for a given surface."""
    wide, trees, crowns, amid = (
        _odd_cells(size_m, cell_m) // 2 for size_m in (WIDE_M, TREES_M, PIT_M, AMID_M)
    )
    return trees + max(crowns, amid + 2 * wide) + (rounds - 1) * crowns


def canopy(heights: Float64, surface: Surface, ground: Bool, cell_m: float) -> Canopy:
    """Find the cells in which a closed canopy hides the ground.

    Parameters
    ----------
    heights : float64 [rows, columns]
        Heights of all cells in metres; NaN elsewhere.
    surface : Surface
        Ground surface, computed as if there were no canopy.
    ground : bool [rows, columns]
        Cells near the surface.
    cell_m : float
        Size of the cells in metres.
    """
    there, around = np.isfinite(heights), _Squares(cell_m)
    known_surface = np.where(there & np.isfinite(surface.narrowing), surface.height, np.nan)
    wavy = _wavy(heights, known_surface, around)
    # true where the surface is NaN, too
    tall = there & ~ground & ~(heights - surface.height < TALL_M)
    closed = around.closed(wavy | tall & _rough(heights, cell_m), CLOSED_M)
    half = around.mean(wavy.astype(np.float64), there, WAVY_SQUARE_M) > WAVY_SHARE
    climbed = there & around.opened(closed, WAVY_SQUARE_M) & half
    wide = there & around.opened(closed, TALL_SIZE_M)
    if wide.any():  # not where many of the tall cells lie in one plane with their neighbours
        plane = tall & (residuals(heights, PLANE_CELLS) < PLANE_M)
        wide &= ~(around.mean(plane.astype(np.float64), tall, TALL_SIZE_M) > PLANE_SHARE)
    seen = _grown(heights, ground & ~wide & ~climbed & ~wavy, ground & climbed, cell_m)
    covered, crowns = (wide | climbed) & ~seen, climbed & ~seen
    left = ground & ~crowns
    depth = _depths(heights, surface.height, covered & there & ~left, around)
    _, land = _openings(left, there, around)
    found = pits(heights, surface.height, left, covered, cell_m, 1)
    return Canopy(covered, crowns | found, np.where(land, depth, np.nan))


def pits(
    heights: Float64,
    surface: Float64,
    ground: Bool,
    covered: Bool,
    cell_m: float,
    rounds: int,
    far_trees: Float64 | float = 0.0,
) -> Bool:
    """Return the cells amid a canopy where the surface is far less deep below crowns than the ground in openings.

    Parameters
    ----------
    heights : float64 [rows, columns]
        Heights of all cells in metres; NaN elsewhere.
    surface : float64 [rows, columns]
        Heights of the ground surface in metres.
    ground : bool [rows, columns]
        Cells near the surface.
    covered : bool [rows, columns]
        Cells that the canopy covers.
    cell_m : float
        Size of the cells in metres.
    rounds : int
        The pits of a round are crowns in the next one, so an area of crowns is found from its edge inwards.
    far_trees : float64 [rows, columns] or float
        Height of the trees in metres at land farther away, 0 where it is not known.
    """
    found = np.zeros_like(ground)
    if not covered.any():
        return found
    there, around = np.isfinite(heights), _Squares(cell_m)
    is_amid = there & (around.mean(covered.astype(np.float64), there, AMID_M) > AMID)
    crowns = covered & there & ~ground
    depth = _depths(heights, surface, crowns, around)
    wide, land = _openings(ground, there, around)
    trees = around.mean(depth, land & np.isfinite(depth), TREES_M)
    trees = np.maximum(trees, far_trees)
    near_openings = around.mean(depth, wide & np.isfinite(depth), TREES_M)
    least = PIT_SHARE * np.where(trees > 0, trees, near_openings)
    found |= is_amid & (depth < least)
    for _ in range(rounds - 1):
        depth = _depths(heights, surface, crowns | found, around)
        found |= is_amid & (depth < least)
    return found


def _openings(ground: Bool, there: Bool, around: _Squares) -> tuple[Bool, Bool]:
    """Return the wide openings, and those of them that are land."""
    wide = ground & around.opened(ground, WIDE_M)
    return wide, wide & (around.mean(wide.astype(np.float64), there, AMID_M) > LAND)


def may_be(heights: Float64, cell_m: float) -> Bool:
    """Return the cells that a canopy may cover, whatever the surface is: those that squares of rough cells cover."""
    around = _Squares(cell_m)
    rough = _rough_around(residuals(heights, _odd_cells(WAVE_WINDOW_M, cell_m)), around)
    closed = around.closed(rough | _rough(heights, cell_m), CLOSED_M)
    half = (
        around.mean(rough.astype(np.float64), np.isfinite(heights), WAVY_SQUARE_M) > WAVY_SHARE
    )
    return around.opened(closed, WAVY_SQUARE_M) & half | around.opened(closed, TALL_SIZE_M)


def _rough(heights: Float64, cell_m: float) -> Bool:
    """Return the cells around which heights differ as much as in a crown."""
    return residuals(heights, _odd_cells(TEXTURE_M, cell_m)) > TEXTURE


def _rough_around(residual: Float64, around: _Squares) -> Bool:
    """Return the cells with more than `ROUGH_SHARE` rough cells around, from residuals over several crowns."""
    known = np.isfinite(residual)
    return known & (
        around.mean((residual > MIN_WAVE_RESIDUAL_M).astype(np.float64), known, AROUND_M)
        > ROUGH_SHARE
    )


def _wavy(heights: Float64, found: Float64, around: _Squares) -> Bool:
    """Return the cells around which the ground surface (`found`) runs over crowns."""
    surface_residual, height_residual = (
        residuals(v, _odd_cells(WAVE_WINDOW_M, around.cell_m)) for v in (found, heights)
    )
    wavy = _rough_around(surface_residual, around) & _rough_around(height_residual, around)
    if not wavy.any():  # Nearly all rasters end here; the rest is most of the work.
        return wavy
    scatter, one_way, tilt = _slopes(found, around)
    wavy &= (scatter > SCATTER) & (one_way < ONE_WAY)
    mean_residual = _mean_around(surface_residual, around)
    bounded = mean_residual > BOUNDED * _mean_around(
        residuals(found, _odd_cells(AROUND_M, around.cell_m)), around
    )
    little_above = _mean_around(height_residual, around) < OVER * mean_residual
    return wavy & bounded & (little_above | (scatter > TILT * tilt))


def _mean_around(residual: Float64, around: _Squares) -> Float64:
    return around.mean(residual, np.isfinite(residual), AROUND_M)


def _slopes(found: Float64, around: _Squares) -> tuple[Float64, Float64, Float64]:
    """Describe the slopes around each cell.

    Returns the standard deviation of the slopes in the direction in which they scatter least,
    the length of the mean slope as a fraction of the mean length, and the length of the mean
    slope.
    """
    far = round(SLOPE_M / around.cell_m)  # to either side
    north, east = np.full(found.shape, np.nan), np.full(found.shape, np.nan)
    run = 2 * far * around.cell_m
    north[far:-far] = (found[2 * far :] - found[: -2 * far]) / run
    east[:, far:-far] = (found[:, 2 * far :] - found[:, : -2 * far]) / run
    known = np.isfinite(north) & np.isfinite(east)
    north, east = np.where(known, north, 0.0), np.where(known, east, 0.0)

    def mean(values: Float64) -> Float64:
        return around.mean(values, known, AROUND_M)

    x, y = mean(east), mean(north)
    xx, yy, xy = (
        mean(east * east) - x * x,
        mean(north * north) - y * y,
        mean(east * north) - x * y,
    )
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    tilt = np.hypot(x, y)
    one_way = tilt / np.maximum(mean(np.hypot(east, north)), 1e-9)
    return np.sqrt(np.maximum(least, 0.0)), one_way, tilt


def _grown(heights: Float64, seen: Bool, may_join: Bool, cell_m: float) -> Bool:
    """Return the seen ground and the cells of `may_join` to which it continues without a step."""
    step = STEEPEST * cell_m
    reached = seen.copy()
    for _ in range(_steps(cell_m)):
        joined = np.zeros_like(reached)
        for axis in (0, 1):
            for way in (1, -1):
                beside = np.roll(reached, way, axis)
                rise = np.abs(heights - np.roll(heights, way, axis))
                joined |= beside & (rise < step)
        reached |= joined & may_join
    return reached


def _depths(heights: Float64, surface: Float64, crowns: Bool, around: _Squares) -> Float64:
    """Return the depths of the surface below the highest crown around, NaN where crowns are few."""
    share = around.mean(crowns.astype(np.float64), np.isfinite(heights), PIT_M)
    tops = around.highest(np.where(crowns, heights, -np.inf), PIT_M)
    return np.where(share > CROWDED, tops - surface, np.nan)


@dataclass(frozen=True)
class _Squares:
    """Filters over squares around the cells of a raster, with no cells beyond the raster."""

    cell_m: float

    def mean(self, values: Float64, known: Bool, size_m: float) -> Float64:
        """Return the mean of the known values around each cell, or 0 where none is known.

        Values are rounded to `UNIT`, as running sums of whole numbers are the same wherever the raster begins.
        """
        size = _odd_cells(size_m, self.cell_m)
        total = _sums(np.rint(np.where(known, values, 0.0) / UNIT).astype(np.int64), size)
        return total * UNIT / np.maximum(_sums(known.astype(np.int64), size), 1)

    def highest(self, values: Float64, size_m: float) -> Float64:
        """Return the highest value around each cell, with minus infinity beyond the raster."""
        size = _odd_cells(size_m, self.cell_m)
        return scipy.ndimage.maximum_filter(values, size, mode="constant", cval=-np.inf)

    def closed(self, cells: Bool, size_m: float) -> Bool:
        """Return the cells and the openings among them into which no square of this side fits (closing)."""
        size = _odd_cells(size_m, self.cell_m)
        wide: Bool = scipy.ndimage.maximum_filter(cells, size, mode="constant")
        return scipy.ndimage.minimum_filter(wide, size, mode="constant")

    def opened(self, cells: Bool, size_m: float) -> Bool:
        """Return the cells that are covered by squares of this side that contain no other cells (opening)."""
        size = _odd_cells(size_m, self.cell_m)
        inner: Bool = scipy.ndimage.minimum_filter(cells, size, mode="constant")
        return scipy.ndimage.maximum_filter(inner, size, mode="constant")


def _sums(whole: Int64, size: int) -> Int64:
    """Return the sums over squares of an odd number of cells around each cell."""
    half = size // 2
    return box_sums(np.pad(whole, half), half, half)


def _odd_cells(metres: float, cell_m: float) -> int:
    """Return the number of cells on the side of a square, an odd number."""
    return 2 * round(metres / cell_m / 2 - 0.25) + 1


def _steps(cell_m: float) -> int:
    """Return the distance in cells to which seen ground grows."""
    return round(GROWN_M / cell_m)
