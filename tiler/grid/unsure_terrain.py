"""Places where the terrain is unsure: it is rough, and ground points are far.

Under plants and on steep land, no point may lie on the ground. The TIN then spans plants or a valley. Such
places do not stand up from the land around, as objects do (`tiler.grid.object_candidates`). Matching sees no ground
under plants, in shadow and beside walls.

The measure is the height above the lowest cell nearby, without the trend of the land, times the root of the distance to
the nearest ground. Places are connected cells with a large measure within a square of `SQUARE_M`, so that none is
longer. Each gets a chance from six means. All that decides on a place lies within `RIM_CELLS` of its square, and
sums are of whole numbers. So blocks do not change the result.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Indices, Int32, Int64
from ptd.gridding.ground_cells import box_sums
from tiler.grid.coarse import distances
from tiler.grid.object_candidates import MOST_CHANCE, TOUCHING, Box
from tiler.grid.sigma import LASER, MATCHED

SQUARE_M = 48.0
"""Side of the squares that cut places, which have whole cells."""
TREND_M, NEARBY_M, AROUND_M = 9.0, 5.0, 21.0
"""Sides of the windows of the trend, of the lowest cell and of the points around."""
FARTHEST_CELLS = 8
"""Distance from which ground is as good as none."""
RIM_CELLS = 17
"""Distance from a cell within which all lies that decides on its measures, in cells of at least 0.65 m."""
LEAST_AREA_M2, LEAST_SUM = 4.0, 16.0
"""Least area of a place, and least sum of the squares of its measures times the area of a cell, in m^5."""
LEAST_POINTS_M2 = 2.0
"""Least number of points around per square metre. In sparser clouds, ground is far everywhere."""
LEAST_RISE, LEAST_ROOT = 0.05, 0.1
"""Added to rises and slopes, and to roots of distances, so that they have a logarithm."""
MM = 1000.0
"""Sums are of whole millimetres."""


class Weights(NamedTuple):
    """Logarithm of the odds that a place is wrong, as a sum.

    The constants were fitted by ``python -m tests.benchmarks.unsure``. Rises, distances, slopes and areas count with
    their logarithm.

    Attributes
    ----------
    always : float
    rise : float
        For the height above the lowest cell nearby.
    gap : float
        For the root of the distance to the nearest ground.
    objects : float
        For the share of objects among the points around.
    tilt : float
        For the slope of the land. On steep land, terrain is rough where it is right, too.
    steep : float
        For the slope from cell to cell.
    area : float
        For the area.
    """

    always: float
    rise: float
    gap: float
    objects: float
    tilt: float
    steep: float
    area: float


class Search(NamedTuple):
    """Constants of the search in laser scans or in photogrammetric clouds.

    Attributes
    ----------
    least_measure : float
        Least measure of a cell of a place, in m^1.5.
    least_chance : float
        Least chance of a place that is listed.
    error : float
        Median of the root mean square error of places, as a multiple of the rise times the root of the gap.
    weights : Weights
    """

    least_measure: float
    least_chance: float
    error: float
    weights: Weights


SEARCHES = {
    LASER: Search(0.3, 0.7, 1.0, Weights(-3.15, 3.93, 5.07, -3.81, -3.2, 1.99, 1.11)),
    MATCHED: Search(0.2, 0.5, 1.25, Weights(-2.1, 3.02, 2.87, 1.21, -0.16, 0.42, 0.59)),
}
"""Searches by kind of the cloud. Other clouds are not searched."""


class Shape(NamedTuple):
    """Form of the terrain in each cell, in metres: rise above the lowest cell nearby, trend, and height."""

    rise: Float64
    trend: Float64
    heights: Float64


class Place(NamedTuple):
    """Place with its cells, their box, its first cell, and what is told of it: see `unsure_places`."""

    cells: Bool
    box: Box
    row: int
    column: int
    told: dict[str, Any]


def shape_of(heights: Float64, cell_m: float) -> Shape:
    """Return the form of the terrain of cells, heights in metres, NaN where there is none."""
    known = ~np.isnan(heights)
    mm = np.rint(np.where(known, heights, 0.0) * MM).astype(np.int64)
    half = _half(TREND_M, cell_m)
    n = _around(known.astype(np.int64), half)
    trend = np.where(n > 0, _around(mm, half) / np.maximum(n, 1), np.nan) / MM
    above = np.where(known, heights - trend, np.inf)
    lowest = scipy.ndimage.minimum_filter(
        above, 2 * _half(NEARBY_M, cell_m) + 1, mode="constant", cval=np.inf
    )
    rise = np.zeros(heights.shape)
    np.subtract(above, lowest, out=rise, where=known)
    return Shape(rise, trend, heights)


def may_be_unsure(rise: Float64, cell_m: float, search: Search) -> Bool:
    """Return a mask of the cells that can belong to a place, whatever the ground points are."""
    return _smooth(rise * (FARTHEST_CELLS * cell_m) ** 0.5) >= search.least_measure


def unsure_places(
    shape: Shape,
    ground: Int64,
    objects: Int64,
    cell_m: float,
    search: Search,
    corner: tuple[int, int] = (0, 0),
) -> list[Place]:
    """Find the places of cells.

    Parameters
    ----------
    shape : Shape
    ground, objects : int64 (rows, columns)
        Number of ground points and of others in each cell.
    cell_m : float
        Side of a cell in metres.
    search : Search
    corner : tuple of int
        Row and column of the first cell, which say where the squares begin.

    Returns
    -------
    list of Place
        Each tells its ``chance``, a typical ``error_m``, its mean ``gap_m``, the ``tilt`` of the land, and the
        share of ``objects``.
    """
    labels, squared, measures = measured(
        shape, ground, objects, cell_m, search.least_measure, corner
    )
    always, *by = search.weights
    # A matrix product may depend on the number of rows in its last bit.
    chance = scipy.special.expit(always + (measures * by).sum(axis=1))
    boxes = scipy.ndimage.find_objects(labels)
    places = []
    for i in np.flatnonzero((chance >= search.least_chance) & (squared >= LEAST_SUM)):
        cells = labels[boxes[i]] == i + 1
        row, column = boxes[i][0].start, boxes[i][1].start + int(np.argmax(cells[0]))
        rise, gap, share, tilt = measures[i, :4]
        told = {
            "chance": round(min(float(chance[i]), MOST_CHANCE), 3),
            "error_m": round(search.error * float(np.exp(rise + gap)), 2),
            "gap_m": round((float(np.exp(gap)) - LEAST_ROOT) ** 2 + cell_m / 2, 1),
            "tilt": round(float(np.exp(tilt)) - LEAST_RISE, 2),
            "objects": round(float(share), 2),
        }
        places.append(Place(cells, boxes[i], row, column, told))
    return places


def measured(
    shape: Shape,
    ground: Int64,
    objects: Int64,
    cell_m: float,
    least_measure: float,
    corner: tuple[int, int],
) -> tuple[Int32, Float64, Float64]:
    """Return labels of candidates, the sum of the squares of each, and its six measures in the order of `Weights`."""
    gap = distances(ground > 0, FARTHEST_CELLS)
    gap = np.sqrt(np.maximum(np.minimum(gap, FARTHEST_CELLS) - 0.5, 0.0) * cell_m)
    measure = _smooth(shape.rise * gap)
    # At the border of the window, cells have no neighbours. They belong to no place of a block.
    measure[[0, -1]] = measure[:, [0, -1]] = 0.0
    half = _half(AROUND_M, cell_m)
    n_objects, n_points = (_around(n, half) for n in (objects, objects + ground))
    is_dense = n_points >= LEAST_POINTS_M2 * (2 * half + 1) ** 2 * cell_m**2
    cells = (measure >= least_measure) & is_dense & ~np.isnan(shape.heights)
    labels = _labels_in_squares(cells, corner, square_cells(cell_m))
    sizes = np.bincount(labels.ravel())
    is_kept = sizes * cell_m**2 >= LEAST_AREA_M2
    is_kept[0] = False
    labels = np.where(is_kept, np.cumsum(is_kept), 0).astype(np.int32)[labels]
    at, area = np.flatnonzero(labels), sizes[is_kept]
    of = labels.ravel()[at] - 1

    def mean(values: Float64) -> Float64:
        return np.bincount(of, values, area.size) / area

    columns = (
        np.log(mean(shape.rise.ravel()[at]) + LEAST_RISE),
        np.log(mean(gap.ravel()[at]) + LEAST_ROOT),
        mean(n_objects.ravel()[at] / n_points.ravel()[at]),
        np.log(mean(_slope(shape.trend, at, cell_m)) + LEAST_RISE),
        np.log(mean(_slope(shape.heights, at, cell_m)) + LEAST_RISE),
        np.log(area * cell_m**2),
    )
    squared = mean(measure.ravel()[at] ** 2) * area * cell_m**2
    return labels, squared, np.column_stack(columns)


def square_cells(cell_m: float) -> int:
    """Return the side of the squares that cut places."""
    return int(SQUARE_M / cell_m)


def _labels_in_squares(cells: Bool, corner: tuple[int, int], side: int) -> Int32:
    """Label connected cells within each square, by labelling the squares with gaps between them."""
    at = (
        first % side + np.arange(size) for first, size in zip(corner, cells.shape, strict=True)
    )
    rows, columns = (i + i // side for i in at)
    apart = np.zeros((rows[-1] + 1, columns[-1] + 1), np.bool_)
    place = np.ix_(rows, columns)
    apart[place] = cells
    return scipy.ndimage.label(apart, TOUCHING)[0][place].astype(np.int32)


def _slope(heights: Float64, at: Indices, cell_m: float) -> Float64:
    """Return the slope at cells that do not lie at the border, given by flat indices, 0 beside unknown heights."""
    flat, columns = heights.ravel(), heights.shape[1]
    down, right = (flat[at + step] - flat[at - step] for step in (columns, 1))
    return np.nan_to_num(np.hypot(down, right)) / (2 * cell_m)


def _half(window_m: float, cell_m: float) -> int:
    return max(int(window_m / cell_m / 2), 1)


def _around(cells: Int64, half: int) -> Int64:
    return box_sums(np.pad(cells, half), half, half)


def _smooth(values: Float64) -> Float64:
    """Return the means of three by three cells."""
    return _around(np.rint(values * MM).astype(np.int64), 1) / (9 * MM)
