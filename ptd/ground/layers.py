"""The layer above a point: the lowest thin and dense surface of points that passes above it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.cells import Xyz
from ptd.frame import Scale
from ptd.kernel import inlined, kernel
from ptd.sorting import sort

CELL_M = 1.0
"""Side of the cells in which neighbours are searched."""
REACH_CELLS = 2
"""Largest distance, in cells, of the cells with points in the disc around a point."""
EXPECTED = 18.0
"""Number of points in the disc around a point, at the density of the place."""
MIN_RADIUS_M = 0.5
MIN_DENSITY_M2 = 2.0
"""Density in points per square metre below which no layer is searched: the disc would be wider
than the relief that a plane follows."""
MIN_POINTS = 7
"""Least number of points of a layer."""
THICKNESSES_M = (0.35, 0.2)
"""Largest differences in height of the points of a layer, after the slope is taken off. The second
is tried for ground below low plants, which roughen a thicker layer."""
MAX_RMS_M = 0.1
"""Largest deviation of the points of a layer from their plane: crowns are seldom that thin."""
MIN_DEPTH_M, MIN_RMS = 0.3, 4.0
"""Least height of a layer above the point, in metres and in deviations from its plane."""
MIN_SLOPE = 0.1
"""Slope from which on a layer is searched again along it."""
EMPTY = 2**31 - 1
"""Height of the lowest point of an empty cell; that of the highest is -`EMPTY`."""
AROUND = np.array([7, 3, 2, 6, 4, 0, 1, 5])
"""Numbers of octants (`_plane`) in the order in which they lie around a point."""
MAX_EMPTY = 3
"""Largest number of empty octants in a row. With more of them, the layer lies beside the point."""


class CellFigures(NamedTuple):
    """Figures of the cells of a raster, by rows.

    Attributes
    ----------
    counts : int32 [height * width]
        Number of points.
    low, high : int32 [height * width]
        Heights of the lowest and of the highest point; `EMPTY` and -`EMPTY` without points.
    density : float64 [height * width]
        Points per square metre of the 5 x 5 cells around.
    shape : (int, int)
        Height and width.
    """

    counts: Int32
    low: Int32
    high: Int32
    density: Float64
    shape: tuple[int, int]


class Neighbourhood(NamedTuple):
    """Points sorted by cell, and the cells, as one argument of kernels.

    Attributes
    ----------
    x, y, z : int32 [n]
        Local counts, by rows of cells.
    starts : int64 [height * width + 1]
        The points of a cell have the indices ``starts[cell]`` to ``starts[cell + 1]``.
    cells : int32 [n]
        Cell of each point.
    low, high : int32 [height * width]
        Heights of the lowest and of the highest point of each cell; `EMPTY` and -`EMPTY` without points.
    density : float64 [height * width]
        Points per square metre of a cell and those around it.
    width, height : int
        Number of columns and of rows.
    metres, metres_z : float
        Metres in a horizontal and in a vertical count.
    """

    x: Int32
    y: Int32
    z: Int32
    starts: Int64
    cells: Int32
    low: Int32
    high: Int32
    density: Float64
    width: int
    height: int
    metres: float
    metres_z: float


class Layer(NamedTuple):
    """The layer above a point.

    Attributes
    ----------
    depth_m : float
        Depth of the point below the layer; 0 if there is no layer.
    density_m2 : float
        Points of the layer per square metre.
    points : int
        Number of points of the layer.
    east, north : float
        Slope of the layer, metres per metre.
    """

    depth_m: float
    density_m2: float
    points: int
    east: float
    north: float


class _Plane(NamedTuple):
    points: int
    height: float
    east: float
    north: float
    rms: float
    octants: int


@inlined
def disc_radius_m(density_m2: float, expected: float) -> float:
    """Return the radius of the disc with an expected number of points at a place with a density."""
    return max(MIN_RADIUS_M, math.sqrt(expected / (math.pi * density_m2)))


@kernel
def _plane(
    work: Float64, low: float, high: float, n: int, metres: float, metres_z: float
) -> _Plane:
    """Fit a plane to those of the first n points whose rise is from ``low`` to ``high``.

    Sums of whole counts are exact, so the order of the points does not matter.
    """
    x, y, z, rise = work[0], work[1], work[2], work[3]
    k, octants, base = 0, 0, math.inf
    for i in range(n):
        if low <= rise[i] <= high:
            base = min(base, z[i])
    sx = sy = sz = xx = yy = xy = xz = yz = zz = 0.0
    for i in range(n):
        if low <= rise[i] <= high:
            up = z[i] - base
            k += 1
            sx += x[i]
            sy += y[i]
            sz += up
            xx += x[i] * x[i]
            yy += y[i] * y[i]
            xy += x[i] * y[i]
            xz += x[i] * up
            yz += y[i] * up
            zz += up * up
            octants |= 1 << ((x[i] > 0) + 2 * (y[i] > 0) + 4 * (abs(x[i]) > abs(y[i])))
    if k < MIN_POINTS:
        return _Plane(0, 0.0, 0.0, 0.0, math.inf, 0)
    a, b, c = xx - sx * sx / k, yy - sy * sy / k, xy - sx * sy / k
    d, e = xz - sx * sz / k, yz - sy * sz / k
    determinant = a * b - c * c
    if determinant * metres**4 <= 1e-9:
        return _Plane(0, 0.0, 0.0, 0.0, math.inf, 0)
    east, north = (d * b - e * c) / determinant, (e * a - d * c) / determinant
    height = base + (sz - east * sx - north * sy) / k
    squares = max(zz - sz * sz / k - east * d - north * e, 0.0)
    rms, tilt = math.sqrt(squares / (k - 3)) * metres_z, metres_z / metres
    return _Plane(k, height * metres_z, east * tilt, north * tilt, rms, octants)


@kernel
def _surrounds(octants: int) -> bool:
    """Return whether at most `MAX_EMPTY` octants in a row are empty."""
    run = 0
    for turn in range(16):
        run = 0 if (octants >> AROUND[turn % 8]) & 1 else run + 1
        if run > MAX_EMPTY:
            return False
    return True


@inlined
def _middle(a: float, b: float, c: float) -> float:
    """Return the second largest of three numbers."""
    return max(min(a, b), min(max(a, b), c))


@inlined
def _step(heights: Int32, first: int, last: int) -> float:
    """Return the difference of two cells, 0 if one of them is empty."""
    empty = abs(heights[first]) == EMPTY or abs(heights[last]) == EMPTY
    return 0.0 if empty else float(heights[last]) - float(heights[first])


@kernel
def _slope(heights: Int32, cell: int, hood: Neighbourhood) -> tuple[float, float]:
    """Return the middle of the three slopes of the cells around a cell, to the east and to the north."""
    width, height = hood.width, hood.height
    column, row = cell % width, cell // width
    if column == 0 or row == 0 or column == width - 1 or row == height - 1:
        return 0.0, 0.0
    south, north = cell - width, cell + width
    east = _middle(
        _step(heights, south - 1, south + 1),
        _step(heights, cell - 1, cell + 1),
        _step(heights, north - 1, north + 1),
    )
    up = _middle(
        _step(heights, south - 1, north - 1),
        _step(heights, south, north),
        _step(heights, south + 1, north + 1),
    )
    scale = hood.metres_z / (2.0 * CELL_M)
    return east * scale, up * scale


@kernel
def _gather(p: int, hood: Neighbourhood, radius: float, work: Float64) -> int:
    """Fill in the positions of the points in the disc around a point, in counts from it, and return their number."""
    x, y, z, starts, cells = hood.x, hood.y, hood.z, hood.starts, hood.cells
    width, height = hood.width, hood.height
    column, row = cells[p] % width, cells[p] // width
    reach = 1 if radius <= CELL_M else REACH_CELLS
    n, limit2 = 0, (radius / hood.metres) ** 2
    for j in range(max(row - reach, 0), min(row + reach + 1, height)):
        first = starts[j * width + max(column - reach, 0)]
        for q in range(first, starts[j * width + min(column + reach, width - 1) + 1]):
            dx, dy = float(x[q] - x[p]), float(y[q] - y[p])
            if dx * dx + dy * dy <= limit2 and q != p:
                work[0, n], work[1, n], work[2, n] = dx, dy, float(z[q]) - float(z[p])
                n += 1
    return n


@kernel
def _lowest_layer(
    n: int, east: float, north: float, metres: float, metres_z: float, work: Float64
) -> _Plane:
    """Return the plane of the lowest layer above the point (0, 0, 0), after a slope is taken off; 0 points: none."""
    above = 0
    for i in range(n):
        trend = (east * work[0, i] + north * work[1, i]) * metres
        work[3, i] = work[2, i] * metres_z - trend
        if work[3, i] > MIN_DEPTH_M / 2:
            work[4, above] = work[3, i]
            above += 1
    nothing = _Plane(0, 0.0, 0.0, 0.0, math.inf, 0)
    if above < MIN_POINTS:
        return nothing
    rises, first = work[4, :above], 0
    sort(rises)
    thickest = THICKNESSES_M[0]
    while first + MIN_POINTS <= above:
        if rises[first + MIN_POINTS - 1] - rises[first] > thickest:
            first += 1
            continue
        for thickness in THICKNESSES_M:
            plane = _plane(work, rises[first], rises[first] + thickness, n, metres, metres_z)
            high = plane.height >= max(MIN_DEPTH_M, MIN_RMS * plane.rms)
            if high and plane.rms <= MAX_RMS_M and _surrounds(plane.octants):
                return plane
        # These may be the other points of a clump, with the layer above them.
        first += np.searchsorted(rises[first:], rises[first] + thickest, "right")
    return nothing


@kernel
def layer_above(p: int, hood: Neighbourhood, work: Float64, expected: float) -> Layer:
    """Return the layer above a point. There is none if the disc would be wider than `REACH_CELLS`.

    Parameters
    ----------
    p : int
        Index of the point.
    hood : Neighbourhood
    work : float64 [5, m]
        Space for the points of 5 x 5 cells.
    expected : float
        Number of points in the disc at the density of the place.
    """
    radius = disc_radius_m(hood.density[hood.cells[p]], expected)
    n = _gather(p, hood, radius, work) if radius <= REACH_CELLS * CELL_M else 0
    if n < MIN_POINTS:
        return Layer(0.0, 0.0, 0, 0.0, 0.0)
    plane = _lowest_layer(n, 0.0, 0.0, hood.metres, hood.metres_z, work)
    for heights in (hood.low, hood.high):
        if plane.points:
            break
        east, north = _slope(heights, hood.cells[p], hood)
        if abs(east) + abs(north) >= MIN_SLOPE:
            plane = _lowest_layer(n, east, north, hood.metres, hood.metres_z, work)
    area = math.pi * radius * radius
    depth = plane.height if plane.points else 0.0
    return Layer(depth, plane.points / area, plane.points, plane.east, plane.north)


@kernel
def _figures(keys: Int64, z: Int32, n_cells: int) -> tuple[Int32, Int32, Int32]:
    """Return the number of points, the lowest and the highest height of each cell."""
    counts, low = np.zeros(n_cells, np.int32), np.full(n_cells, EMPTY, np.int32)
    high = np.full(n_cells, -EMPTY, np.int32)
    for i in range(keys.size):
        key = keys[i]
        counts[key] += 1
        low[key] = min(low[key], z[i])
        high[key] = max(high[key], z[i])
    return counts, low, high


def box_sums(values: Int32, side: int) -> Int32:
    """Return the sums of square boxes around the cells of a raster. Cells outside it are 0."""
    ones = np.ones(side, np.int32)
    rows = scipy.ndimage.convolve1d(values, ones, axis=0, mode="constant")
    return scipy.ndimage.convolve1d(rows, ones, axis=1, mode="constant")


def cell_figures(keys: Int64, z: Int32, shape: tuple[int, int]) -> CellFigures | None:
    """Return the figures of the cells of a raster from the cells and heights of points: int64 [n], int32 [n].

    Return None if no density can reach `MIN_DENSITY_M2`, as no cell has so many points.
    """
    counts, low, high = _figures(keys, z, shape[0] * shape[1])
    if counts.max() < MIN_DENSITY_M2 * CELL_M**2:
        return None
    number = counts.reshape(shape)
    filled = box_sums((number > 0).astype(np.int32), 5).ravel() * CELL_M**2
    density = box_sums(number, 5).ravel() / np.maximum(filled, 1.0)
    # An empty cell has no density, whatever lies around it.
    return CellFigures(counts, low, high, np.where(counts > 0, density, 0.0), shape)


@kernel
def _sort_points(
    points: Xyz, keys: Int64, counts: Int32, wanted: Bool
) -> tuple[Int32, Xyz, Int32, Int64]:
    """Sort the points of wanted cells by cell: their indices, positions, cells, and the first of each cell."""
    starts = np.zeros(counts.size + 1, np.int64)
    for cell in range(counts.size):
        starts[cell + 1] = starts[cell] + (counts[cell] if wanted[cell] else 0)
    at, n = starts[:-1].copy(), starts[-1]
    order, cells = np.empty(n, np.int32), np.empty(n, np.int32)
    x, y, z = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32)
    for i in range(keys.size):
        cell = keys[i]
        if wanted[cell]:
            k = at[cell]
            order[k], cells[k] = i, cell
            x[k], y[k], z[k] = points.x[i], points.y[i], points.z[i]
            at[cell] += 1
    return order, Xyz(x, y, z), cells, starts


def sorted_by_cell(
    points: Xyz, keys: Int64, wanted: Bool, figures: CellFigures, scale: Scale
) -> tuple[Int32, Neighbourhood]:
    """Sort the points of wanted cells by cell.

    Parameters
    ----------
    points : Xyz
    keys : int64 [n]
        Cell of each point.
    wanted : bool [height * width]
        Mask of the cells.
    figures : CellFigures
    scale : Scale

    Returns
    -------
    order : int32 [m]
        Indices of the sorted points.
    hood : Neighbourhood
    """
    order, xyz, cells, starts = _sort_points(points, keys, figures.counts, wanted)
    height, width = figures.shape
    return order, Neighbourhood(
        *xyz, starts, cells, figures.low, figures.high, figures.density, width, height,
        float(scale.metres_xy), float(scale.metres_z),
    )  # fmt: skip
