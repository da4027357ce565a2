"""Crowns on slopes: small surfaces of ground among objects, above the ground around them.

In a wood on a slope few pulses reach the ground. The openings then see the ground above a crown
and the crown below it at the same height, and keep the crown. The rule for roofs
(`ptd.ground.plateaus`) would find it, but on a slope some ground around is always higher. So
this module subtracts the plane of the ground around first.

Rocks look the same, but most cells around them are ground. So only surfaces among objects are
removed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.cells import Xyz
from ptd.frame import CellGrid, CellLattice, Scale
from ptd.ground.morphology import EMPTY, CellRaster
from ptd.ground.plateaus import ROOF_CELL_M, Plateaus, on_plateaus
from ptd.ground.slopes import Boxes
from ptd.kernel import as_int64, kernel

MAX_WIDTH_M, STEP_M, BELOW_SHARE = 40.0, 1.5, 0.8
"""Width of the widest surface, height difference of its neighbouring cells, and least share of
the ground around that lies below it. A wide crown may rise from the ground on its upper side."""
TREND_M, TREND_CELLS = 20.0, 12
"""Half width of the square whose ground defines a plane, and least number of its cells. If they
are fewer, or lie on a line, their mean counts."""
MIN_SLOPE = 0.2
"""Slope of the ground above which crowns are removed. Below it the roofs were found before."""
AROUND_M, OBJECTS_SHARE = 7.0, 0.5
"""Half width of the square around a crown, and least share of objects among its cells."""
SEARCHES = 2
"""Number of searches. The first ones take crowns out of the planes of the next."""

_MOMENTS = 9
"""Number of moments: n, x, y, z, xx, xy, yy, xz, yz."""


class _Planes(NamedTuple):
    """Planes of the ground around each cell of a raster: float64 [rows, columns], NaN where there is none.

    Attributes
    ----------
    height : float64
        Height at the centre of the cell in counts.
    east, north : float64
        Rise to the next column and to the next row in counts.
    """

    height: Float64
    east: Float64
    north: Float64


@kernel
def _add_row(columns: Int64, heights: Int32, row: int, sign: int) -> None:
    """Add the moments of a row's filled cells to the sums of the columns, or subtract them."""
    for c in range(heights.shape[1]):
        if heights[row, c] != EMPTY:
            z = np.int64(heights[row, c])
            moments = (1, c, row, z, c * c, c * row, row * row, c * z, row * z)
            for m in range(_MOMENTS):
                columns[c, m] += sign * moments[m]


@kernel
def _plane(s: Int64, column: int, row: int) -> tuple[float, float, float]:
    """Return the plane of the cells with moments ``s``: its height at a cell, and its rises to the east and north.

    All differences are of whole numbers and relative to the cell, so the result does not depend on where the raster
    begins.
    """
    n = s[0]
    sx, sy, sz = s[1] - column * n, s[2] - row * n, s[3]
    xx = s[4] - column * (2 * s[1] - column * n)
    xy = s[5] - column * s[2] - row * sx
    yy = s[6] - row * (2 * s[2] - row * n)
    xz, yz = s[7] - column * sz, s[8] - row * sz
    var_x, var_y, cov = n * xx - sx * sx, n * yy - sy * sy, n * xy - sx * sy
    cov_x, cov_y = float(n * xz - sx * sz), float(n * yz - sy * sz)
    det = float(var_x) * float(var_y) - float(cov) * float(cov)
    if n < TREND_CELLS or det <= 0.05 * float(var_x) * float(var_y):
        return sz / n, 0.0, 0.0
    east = (cov_x * var_y - cov_y * cov) / det
    north = (cov_y * var_x - cov_x * cov) / det
    return (sz - east * sx - north * sy) / n, east, north


@kernel
def _planes(heights: Int32, reach: int) -> _Planes:
    """Fit planes to the filled cells up to ``reach`` cells from each filled cell, along rows and along columns."""
    rows, width = heights.shape
    shape = (rows, width)
    height, east, north = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    columns, total = np.zeros((width, _MOMENTS), np.int64), np.zeros(_MOMENTS, np.int64)
    for row in range(min(reach, rows)):
        _add_row(columns, heights, row, 1)
    for row in range(rows):
        if row + reach < rows:
            _add_row(columns, heights, row + reach, 1)
        if row - reach > 0:
            _add_row(columns, heights, row - reach - 1, -1)
        total[:] = 0
        for c in range(min(reach, width)):
            total += columns[c]
        for c in range(width):
            if c + reach < width:
                total += columns[c + reach]
            if c - reach > 0:
                total -= columns[c - reach - 1]
            if heights[row, c] != EMPTY:
                height[row, c], east[row, c], north[row, c] = _plane(total, c, row)
    return _Planes(height, east, north)


def reach_m() -> float:
    """Return the distance in metres beyond which points do not change the result of `on_treetops`."""
    surfaces = _rule(Scale()).reach + 1 + math.ceil(TREND_M / ROOF_CELL_M)
    return SEARCHES * (surfaces + 1) * ROOF_CELL_M


def _rule(scale: Scale) -> Plateaus:
    """Return the rule by which a surface lies above its surroundings, once the slope is subtracted."""
    return replace(Plateaus.of(scale, MAX_WIDTH_M, STEP_M), share=BELOW_SHARE)


@kernel
def _above(
    points: Xyz, keys: Int64, ground: Bool, planes: _Planes, cells: CellGrid, rise: float
) -> tuple[Int32, Bool]:
    """Return the heights of ground points above their planes in counts, and a mask of those with steep planes.

    A plane is steep if it rises by at least ``rise`` counts per cell.
    """
    x, y, z = points
    height, east, north = planes
    above, steep = np.zeros(keys.size, np.int32), np.zeros(keys.size, np.bool_)
    half, size = 0.5 * cells.p / cells.q, cells.p / cells.q
    for k in range(keys.size):
        if not ground[k]:
            continue
        row, column = divmod(keys[k], height.shape[1])
        west, south = (column + cells.column) * size, (row + cells.row) * size
        u = (as_int64(x[k]) + cells.origin_x - west - half) / size
        v = (as_int64(y[k]) + cells.origin_y - south - half) / size
        a, b = east[row, column], north[row, column]
        above[k] = np.int32(np.rint(z[k] - (height[row, column] + a * u + b * v)))
        steep[k] = a * a + b * b >= rise * rise
    return above, steep


def on_treetops(
    points: Xyz, ground: Bool, before: Bool, cells: CellLattice, cell_m: float, scale: Scale
) -> Bool:
    """Find the ground points on crowns of slopes: bool [n].

    Parameters
    ----------
    points : Xyz
        Lowest point of each cell, in counts.
    ground, before : bool [n]
        Masks of the ground points, and of the points found on roofs before.
    cells : CellLattice
        The lattice of the points.
    cell_m : float
        Size of its cells in metres.
    scale : Scale
    """
    found = np.zeros(ground.size, np.bool_)
    wide = CellLattice.of(ROOF_CELL_M, scale)
    raster, fine = CellRaster(points.x, points.y, wide), CellRaster(points.x, points.y, cells)
    grid = wide.grid(wide.column(int(points.x.min())), wide.row(int(points.y.min())))
    rise = scale.counts_z(MIN_SLOPE * ROOF_CELL_M)
    for _ in range(SEARCHES):
        left = ground & ~found
        planes = _planes(raster.lowest(points.z, left), round(TREND_M / ROOF_CELL_M))
        above, crowns = _above(points, raster.keys, left, planes, grid, rise)
        if crowns.any():
            crowns &= on_plateaus(above, left, before | found, raster, _rule(scale))
        if crowns.any():
            crowns &= _among_objects(left, fine, max(round(AROUND_M / cell_m), 1))
        if not crowns.any():
            break
        found |= crowns
    return found


def _among_objects(ground: Bool, raster: CellRaster, around: int) -> Bool:
    """Return a mask of the points where enough cells around are not ground: bool [n]."""
    objects = raster.lowest((~ground).astype(np.int32), np.ones(ground.size, np.bool_))
    return Boxes(objects).means(around, raster.keys) >= OBJECTS_SHARE
