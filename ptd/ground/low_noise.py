"""Low noise of laser scans: points below a dense, thin layer of others (multipath, mirrored facades, blunders).

Ground is seen where nothing dense lies right above it, or it is seen again nearby. Neither holds for noise. The rules,
and scenes in which they fail, are in ``docs/filters.md``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.cells import Xyz, cell_keys, is_lower
from ptd.frame import CellLattice, Scale
from ptd.ground.layers import (
    CELL_M,
    EMPTY,
    EXPECTED,
    MIN_DENSITY_M2,
    MIN_DEPTH_M,
    MIN_SLOPE,
    REACH_CELLS,
    Layer,
    Neighbourhood,
    box_sums,
    cell_figures,
    disc_radius_m,
    layer_above,
    sorted_by_cell,
)
from ptd.ground.morphology import BLOCK_CELLS, blocks
from ptd.kernel import inlined, kernel
from ptd.sorting import sort_by

LEVEL_M, LEVEL_CELLS = 2.0, 3
"""Least radius of the level of a point, which is the points as high as it, and the largest radius in
cells, so that a level reaches no farther cell."""
SPARSE = 20.0
"""A level is thin if its layer has at least this many times as many points per area."""
SURE_POINTS, SHALLOW_M = 18, 2.5
"""Least number of points of a layer, and its greatest height above a point, that prove noise at a
thin level. No roof and no crown lies so low."""
WIDE_M, WIDE_CELLS = 5.0, 5
"""Radius of a wide level, and the farthest cell of it. The ground below a forest, a roof or a bridge
is seen again within it, noise is not."""
CLUMP_POINTS, CLUMP_SHARE, WIDE_SHARE = 8, 0.02, 0.005
"""A level is a clump if neither it nor the wide level has more than max(min(8, n / 50), n / 200) points,
where n is the number of points that the layer has in the wide radius."""
WIDER_EXPECTED, WIDER_POINTS = 36.0, 9
"""Number of points in a wider disc, and the least number of points of a layer in it. It is tried if
the first disc has no layer, as only a part of the points among plants is ground. All but clumps
needs more evidence than such a layer."""
FULL = 0.5
"""Mean share of all points that lie in the layers above the points of a wide level. From it on, the
level is noise. It is 0.2 below the edge of a bridge, as the ground goes on beside it, 0.45 below a
greenhouse, and 0.84 below a street."""
FEW = 200
"""Number of points up to which each point of a level is looked at, for the sake of time."""
LOWER = 0.4
"""Least share of the pairs of cells around a tested cell that lie `MIN_DEPTH_M` higher."""
ROUNDS = 4
"""Number of times that the search goes on in the cells beside noise. So it enters planes of 20 m
width from both sides."""
REACH_M = (LEVEL_CELLS * ROUNDS + WIDE_CELLS + REACH_CELLS) * CELL_M
"""Distance beyond which points do not decide whether a point is noise."""
NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns from a cell to one of each pair of cells beside it."""


@kernel
def _between(low: Int32, cell: int, down: int, right: int, shape: tuple[int, int]) -> float:
    """Return the mean lowest height of a cell and its mirror image, of one if the other is empty, or NaN."""
    rows, columns = shape
    row, column = cell // columns, cell % columns
    n, total = 0, 0.0
    for side in (-1, 1):
        j, i = row + side * down, column + side * right
        if 0 <= j < rows and 0 <= i < columns and low[j * columns + i] != EMPTY:
            n += 1
            total += low[j * columns + i]
    return total / n if n else math.nan


@kernel
def _is_low(low: Int32, cell: int, shape: tuple[int, int], depth: float) -> bool:
    """Return whether a cell lies a depth below the middle of many pairs of cells around it.

    Pairs take off any slope.
    """
    pairs = higher = 0
    for down in range(3):
        for right in range(-2 if down else 1, 3):
            middle = _between(low, cell, down, right, shape)
            pairs += not math.isnan(middle)
            higher += middle >= low[cell] + depth
    return higher >= LOWER * pairs


@kernel
def _first_cells(low: Int32, deep: Bool, shape: tuple[int, int], depth: float) -> Bool:
    """Return the cells that are tested first: those that are low, and the lowest ones in all directions."""
    first = np.zeros(low.size, np.bool_)
    for cell in range(low.size):
        if not deep[cell]:
            continue
        lowest = True
        for down, right in NEIGHBOURS:
            if _between(low, cell, down, right, shape) < low[cell]:
                lowest = False
                break
        first[cell] = lowest and _is_low(low, cell, shape, depth)
    return first


@inlined
def _level_radius_m(density_m2: float) -> float:
    """Return the radius of the levels of a place with a density."""
    return min(max(LEVEL_M, 2.0 * disc_radius_m(density_m2, EXPECTED)), LEVEL_CELLS * CELL_M)


@kernel
def _level(
    p: int, layer: Layer, tolerance_m: float, radius_m: float, hood: Neighbourhood, level: Int64
) -> int:
    """Return the number of points within a radius that are as high as a point along its layer.

    Their indices are written to ``level`` as far as it has room.
    """
    x, y, z, starts, cells = hood.x, hood.y, hood.z, hood.starts, hood.cells
    width, metres, metres_z = hood.width, hood.metres, hood.metres_z
    reach, n = math.ceil(radius_m / CELL_M), 0
    column, row = cells[p] % width, cells[p] // width
    west, east = max(column - reach, 0), min(column + reach, width - 1)
    for j in range(max(row - reach, 0), min(row + reach + 1, hood.height)):
        for q in range(starts[j * width + west], starts[j * width + east + 1]):
            dx, dy = (x[q] - x[p]) * metres, (y[q] - y[p]) * metres
            rise = (z[q] - z[p]) * metres_z - layer.east * dx - layer.north * dy
            if abs(rise) <= tolerance_m and dx * dx + dy * dy <= radius_m * radius_m:
                if n < level.size:
                    level[n] = q
                n += 1
    return n


@kernel
def _is_clump(p: int, layer: Layer, points: int, hood: Neighbourhood, none: Int64) -> bool:
    """Return whether a level with a number of points is all that is as high as a point far around."""
    expected = layer.density_m2 * math.pi * WIDE_M * WIDE_M
    few = max(min(float(CLUMP_POINTS), CLUMP_SHARE * expected), WIDE_SHARE * expected)
    if points > few:
        return False
    return _level(p, layer, min(1.0, layer.depth_m / 4.0), WIDE_M, hood, none) <= few


@kernel
def _is_lowest(p: int, hood: Neighbourhood) -> bool:
    """Return whether at most `CLUMP_POINTS` of the cells within `WIDE_CELLS` hold points as low as a point."""
    top, n = hood.z[p] + MIN_DEPTH_M / hood.metres_z, 0
    column, row = hood.cells[p] % hood.width, hood.cells[p] // hood.width
    for j in range(max(row - WIDE_CELLS, 0), min(row + WIDE_CELLS + 1, hood.height)):
        for i in range(max(column - WIDE_CELLS, 0), min(column + WIDE_CELLS + 1, hood.width)):
            n += hood.low[j * hood.width + i] <= top
            if n > CLUMP_POINTS:
                return False
    return True


@kernel
def _is_covered(level: Int64, hood: Neighbourhood, shares: Int32, work: Float64) -> bool:
    """Return whether the layers above the points of a level hold the share `FULL` of all points on average.

    On levels of more than `FEW` points, the lowest point of each cell stands for all of its points. ``shares`` keeps
    the share of each point in thousandths, -1 before it is computed.
    """
    lacking, last = round(1000 * (1.0 - FULL)) * level.size, 0
    for first in range(level.size):
        if first < last:
            continue
        lowest, last = level[first], first + 1
        while level.size > FEW and last < level.size:
            if hood.cells[level[last]] != hood.cells[lowest]:
                break
            if is_lower(hood.x, hood.y, hood.z, level[last], lowest):
                lowest = level[last]
            last += 1
        if shares[lowest] < 0:
            layer = layer_above(lowest, hood, work, EXPECTED)
            share = layer.density_m2 / hood.density[hood.cells[lowest]]
            shares[lowest] = round(1000 * min(share, 1.0))
        lacking -= (1000 - shares[lowest]) * (last - first)
        if lacking < 0:
            return False
    return True


@kernel
def _reach_beside(cell: int, hood: Neighbourhood, reached: Bool) -> None:
    """Mark the low cells beside a cell."""
    shape = hood.height, hood.width
    row, column = cell // hood.width, cell % hood.width
    for j in range(max(row - 1, 0), min(row + 2, hood.height)):
        for i in range(max(column - 1, 0), min(column + 2, hood.width)):
            other = j * hood.width + i
            if other != cell and _is_low(hood.low, other, shape, MIN_DEPTH_M / hood.metres_z):
                reached[other] = True


class _Space(NamedTuple):
    """Arrays that the tests of a round share: shares of `_is_covered`, work of `layer_above`, points of two levels."""

    shares: Int32
    work: Float64
    level: Int64
    wide: Int64


NO_NOISE, ALONE = 0, -1
"""Results of `_noise_at`. Of the level of a point alone, other points may be ground."""


@kernel
def _noise_at(p: int, hood: Neighbourhood, space: _Space) -> int:
    """Return `NO_NOISE` or `ALONE` for a point, or the number of points of its level if all of it is noise."""
    shares, work, level, wide = space
    layer = layer_above(p, hood, work, EXPECTED)
    wider = layer.points == 0
    if wider:
        if not _is_lowest(p, hood):
            return NO_NOISE
        layer = layer_above(p, hood, work, WIDER_EXPECTED)
        if layer.points < WIDER_POINTS:
            return NO_NOISE
    density = hood.density[hood.cells[p]]
    radius = _level_radius_m(density)
    tolerance = min(MIN_DEPTH_M, layer.depth_m / 2.0)
    n = n_thin = _level(p, layer, tolerance, radius, hood, level)
    # A roof slopes, but the ground below it and beside it need not.
    tilted = abs(layer.east) + abs(layer.north) >= MIN_SLOPE
    flat = Layer(layer.depth_m, layer.density_m2, layer.points, 0.0, 0.0)
    if layer.depth_m >= SHALLOW_M and tilted:
        n_thin = max(n, _level(p, flat, tolerance, radius, hood, wide[:0]))
    sure = not wider and layer.points >= SURE_POINTS and layer.depth_m < SHALLOW_M
    if sure and layer.density_m2 * math.pi * radius * radius >= SPARSE * n_thin:
        return ALONE
    if _is_clump(p, layer, n_thin, hood, wide[:0]):
        return n
    if wider or layer.density_m2 < FULL / 2 * density:
        return NO_NOISE
    n_wide = _level(p, layer, tolerance, WIDE_M, hood, wide)
    if not _is_covered(wide[:n_wide], hood, shares, work):
        return NO_NOISE
    n_wide = _level(p, flat, tolerance, WIDE_M, hood, wide) if tilted else 0
    return n if _is_covered(wide[:n_wide], hood, shares, work) else NO_NOISE


@kernel
def _search(hood: Neighbourhood, todo: Int64, known: Bool, room: int) -> tuple[Bool, Bool]:
    """Test the points of cells from the lowest one on, up to the first that is not noise.

    ``known`` is the noise of earlier rounds, and ``room`` the largest number of points of a level or disc. Return the
    mask of noise, and that of the cells to which the search goes on. What is found in a round does not affect other
    tests of the round, so the order of cells does not matter.
    """
    noise, reached = known.copy(), np.zeros(hood.low.size, np.bool_)
    order = np.empty(room, np.int64)
    space = _Space(
        np.full(known.size, -1, np.int32),
        np.empty((5, room)),
        np.empty(room, np.int64),
        np.empty(room, np.int64),
    )
    for cell in todo:
        first, end, highest = hood.starts[cell], hood.starts[cell + 1], EMPTY
        rising = order[: end - first]
        for k in range(rising.size):
            rising[k] = first + k
        sort_by(rising, hood.z)
        for p in rising:
            if hood.z[p] > highest:
                break
            if known[p]:
                continue
            found = _noise_at(p, hood, space)
            if found == NO_NOISE:
                highest = hood.z[p]  # Points of the same height are tested too, in any order.
            if found != NO_NOISE:
                noise[p] = True
                _reach_beside(cell, hood, reached)
            for q in space.level[: max(found, 0)]:
                noise[q] = True
                reached[hood.cells[q]] = True
    return noise, reached


def _in_raster(points: Xyz, scale: Scale) -> Bool:
    """Return the noise among points whose extent is small enough for rasters."""
    x, y, z = points
    cells = CellLattice.of(CELL_M, scale)
    col0, row0, width, height = cells.extent(x, y)
    keys, shape = cell_keys(x, y, cells, col0, row0, width), (height, width)
    figures, depth = cell_figures(keys, z, shape), scale.counts_z(MIN_DEPTH_M)
    noise = np.zeros(x.size, np.bool_)
    if figures is None:
        return noise
    above = scipy.ndimage.maximum_filter(figures.high.reshape(shape), 3).ravel()
    deep = (figures.density >= MIN_DENSITY_M2) & (figures.low <= above - depth)
    todo = _first_cells(figures.low, deep, shape, depth)
    room = int(box_sums(figures.counts.reshape(shape), 2 * WIDE_CELLS + 1).max())
    for _ in range(ROUNDS):
        if not todo.any():
            break
        near = 2 * (WIDE_CELLS + REACH_CELLS) + 1
        wanted = scipy.ndimage.maximum_filter(todo.reshape(shape), near).ravel()
        order, hood = sorted_by_cell(points, keys, wanted, figures, scale)
        noise[order], reached = _search(hood, np.flatnonzero(todo), noise[order], room)
        todo = reached & deep
    return noise


def low_noise(points: Xyz, scale: Scale) -> Bool:
    """Find the points that lie below a dense layer of others and are no ground.

    Points with less than `MIN_DENSITY_M2` around them are never noise. Points farther than `REACH_M` away do not
    matter, nor does the order of the points.

    Parameters
    ----------
    points : Xyz
        Local counts of all points, in any order; fastest by rows of cells.
    scale : Scale

    Returns
    -------
    bool [n]
        Mask of the noise.
    """
    noise = np.zeros(points.x.size, np.bool_)
    if noise.size == 0:
        return noise
    cells = CellLattice.of(CELL_M, scale)
    widest = BLOCK_CELLS * scale.counts(CELL_M)
    if max(np.ptp(points.x.astype(np.int64)), np.ptp(points.y.astype(np.int64))) < widest:
        return _in_raster(points, scale)
    rows = cells.cell_indices(points.x, points.y)[1]
    order = np.argsort(rows, kind="stable")
    x, y, z = (axis[order] for axis in points)
    for index, inner in blocks(x, y, cells, math.ceil(REACH_M / CELL_M)):
        found = _in_raster(Xyz(x[index], y[index], z[index]), scale)
        noise[order[index[inner]]] = found[inner]
    return noise
