"""Closed canopies: raster of the crowns where they hide the ground, and the terrain below them.

Facets between the edges of a wood cut off its hills and fill its valleys. Crowns follow the terrain, though not
exactly. So there are two estimates: the terrain as it is interpolated, whose error grows with the square of the
distance to ground, and the mean height of the crowns less the height of the trees, whose error is that of the height
of the trees. The height of a pixel is their mean, weighted by the inverse of the variances. Where facets are too long
for the first, the second counts alone.

The height of the trees is measured at the edges of wide ground. If there is none within `FAR_TREES_M`, or if pixels
are wider than `EDGE_M`, the terrain stays as it is.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64
from ptd.frame import Scale
from ptd.matched.cells import CELL_M
from ptd.matched.step import COVERED, size_of_cells
from ptd.passes import Points
from tiler.core.lattice import COUNTS_PER_UNIT, Lattice
from tiler.core.points import PointBlock
from tiler.core.products import NODATA
from tiler.grid.block_surroundings import PointsNear, linear
from tiler.grid.coarse import distances, opened
from tiler.grid.steps import Counts, Position, canopy_window
from tiler.store import Steps, between_centres

GAP = 2
"""Half the width in cells of gaps without points that are filled like the cells around them."""
SIGHT_M = 60.0
"""Distance from a canopy within which it matters whether ground is seen."""
OPEN = NODATA + 1
"""Value of pixels with ground points. Pixels without ground points and canopy are nodata. All crowns are higher."""


def canopy(
    cells: PointBlock, points: PointsNear, place: Position, *, side: Fraction
) -> tuple[Float64, Counts]:
    """Return the heights of crowns where they hide the ground, and `OPEN` where ground is seen.

    A pixel has the height of a crown if its centre lies in a cell under a canopy and no ground
    point lies in the pixel.

    Parameters
    ----------
    cells : PointBlock
        Cells on which the filter worked, within `canopy_reach` of the block, with their codes as labels.
    points : PointsNear
    place : Position
    side : Fraction
        Side of the smaller cells in counts. Larger cells are twice as wide.

    Returns
    -------
    heights : float64 (height, width)
    counts : dict
        ``filled``: number of pixels with a crown.
    """
    hidden = (
        np.zeros(len(cells), np.bool_) if cells.labels is None else (cells.labels & COVERED) > 0
    )
    if not hidden.any():
        return np.full((place.block.height, place.block.width), np.nan), {"filled": 0}
    values = _crowns(cells, hidden, place, side)
    values[points.ground_per_pixel() > 0] = OPEN
    return values, {"filled": int(np.count_nonzero(values > OPEN))}


def canopy_reach(side: Fraction, metres: Fraction) -> int:
    """Return the distance in counts around a block within which cells of a side in counts can change its pixels.

    ``metres`` are the metres per count.
    """
    cells = math.ceil(SIGHT_M / float(side * metres)) + 2 * GAP + 2
    return math.ceil(cells * side)


def _crowns(cells: PointBlock, hidden: Bool, place: Position, side: Fraction) -> Float64:
    """Return the heights of crowns at the pixels' centres, NaN where there are none."""
    lattice, frame, spec, block = Lattice(side), place.frame, place.spec, place.block
    bounds = spec.block_bounds(block).pad(canopy_reach(side, frame.metres_xy))
    west, south = lattice.index_of(bounds.x0) - 1, lattice.index_of(bounds.y0) - 1
    shape = lattice.index_of(bounds.y1) - south + 2, lattice.index_of(bounds.x1) - west + 2
    wide = (
        size_of_cells(Points(cells.xyz), Scale(frame.metres_xy, frame.metres_z, frame.origin))
        > CELL_M
    )
    x, y = (cells.xyz[axis].astype(np.int64) + frame.origin[axis] for axis in (0, 1))
    rows, columns = lattice.index(y) - south, lattice.index(x) - west
    there, tops = np.zeros(shape, np.bool_), np.full(shape, np.nan)
    # The middle of a wide cell is the corner of four small ones. Rounding may put it into any
    # of the four.
    wide_rows, wide_columns = (
        Lattice(2 * side).index(v) * 2 - first for v, first in ((y, south), (x, west))
    )
    for down in (0, 1):
        for right in (0, 1):
            index = (
                np.where(wide, wide_rows + down, rows),
                np.where(wide, wide_columns + right, columns),
            )
            there[index] = True
            places = index[0][hidden], index[1][hidden]
            np.fmax.at(tops, places, cells.xyz[2][hidden] / COUNTS_PER_UNIT)
    _fill_gaps(tops, there)
    pixel_columns, pixel_rows = (lattice.index(centres) for centres in spec.axes(block))
    return tops[np.ix_(pixel_rows - south, pixel_columns - west)]


def _fill_gaps(tops: Float64, there: Bool) -> None:
    """Give gaps without points in a canopy the mean height of the crowns around them."""
    covered, square = np.isfinite(tops), np.ones((2 * GAP + 1, 2 * GAP + 1))
    gaps = ~there & scipy.ndimage.binary_closing(covered, square.astype(np.bool_))
    total, n = (
        scipy.ndimage.correlate(values, square, mode="constant")
        for values in (np.where(covered, tops, 0.0), covered.astype(np.float64))
    )
    tops[gaps] = total[gaps] / n[gaps]


TREES_MEAN_M, GROUND_MEAN_M = 8.0, 2.0
"""Standard deviations of the weights of heights in a mean: an area of several trees, and the nearest ground, so that
continued ground has no step at the edge of a wood."""
MEAN_REACH_M = 24.0
"""Distance beyond which heights do not count in a mean."""
EDGE_M = (5.0, 15.0)
"""Distances to ground between which trees are measured. Nearer crowns are lower, and farther terrain is not known."""
WIDE_M = 10.0
"""Diameter of the disks that fit into ground at which trees are measured. Smaller ground in a wood may be a crown."""
TREES_M, FAR_TREES_M = 100.0, 200.0
"""Half the sides of the squares in which the height of trees is their median: the second if the first has too few."""
MIN_TREES = 20
"""Smallest number of cells from which the height of trees is computed."""
NODE_M = 32.0
"""Distance of the nodes between which the height of trees is interpolated."""
BEND_M = 14.0
"""The error of interpolated terrain is the square of the distance to ground over the square of this, in metres: 1 m at
14 m, 9 m at 42 m. With 12 m woods that hide hills have 0.1 m less error, but a bluff of which much is seen has more."""
CONTINUED_BEND_M = 5.0
"""The same for ground that is continued to one side, as there are no facets to the other."""
MIN_TREES_ERROR_M = 0.5
"""Least error of the height of trees."""
MAX_TREES_ERROR_M = 2.5
"""Largest error of the height of trees with which crowns alone give a height."""
MAD = 1.48
"""Standard deviation of a normal distribution over its median absolute deviation."""

CROWNS_REACH_M = NODE_M + FAR_TREES_M + MEAN_REACH_M
"""Distance beyond which crowns do not change a height."""


class _Trees(NamedTuple):
    """Height of the trees around each cell and its error in metres, NaN where they are not known."""

    height: Float64
    error: Float64


def below_canopy(
    terrain: Float64, canopy: Float64, crowns: Float64, bridge: Float64, place: Position
) -> tuple[Float64, Counts]:
    """Return the terrain below a canopy, NaN where the terrain stays as it is.

    Parameters
    ----------
    terrain, canopy : float64 (height, width)
        Interpolated terrain and canopy in pixels, NaN without a value.
    crowns, bridge : float64
        Canopy and interpolated terrain in cells: those at the block and `crowns_margin` more on each side. They go on
        beyond the area of the run.
    place : Position
    """
    cells = place.sources.canopy_grid
    cell_m, unit_m = (
        float(cells.lattice.size * place.frame.metres_xy),
        place.unit_m,
    )
    window = canopy_window(place, crowns_margin(cell_m))
    below = _corrected(
        np.where(crowns > OPEN, crowns * unit_m, np.nan),
        bridge * unit_m,
        crowns == OPEN,
        cell_m,
        (window.row - cells.north, window.col + cells.west),
    )
    rows, columns = between_centres(cells, place.spec, place.block)
    steps = (rows[0] - window.row, rows[1]), (columns[0] - window.col, columns[1])
    correction, continued = (_known_linear(values, *steps) / unit_m for values in below)
    heights = np.where(np.isfinite(terrain + correction), terrain + correction, continued)
    heights[~(canopy > OPEN)] = np.nan
    return heights, {}


def crowns_margin(cell_m: float) -> int:
    """Return the margin in cells around a block within which crowns can change its heights."""
    return round(CROWNS_REACH_M / cell_m) + 2


def _corrected(
    tops: Float64, bridge: Float64, seen: Bool, cell_m: float, first: tuple[int, int]
) -> tuple[Float64, Float64]:
    """Return corrections of the interpolated terrain, and the terrain itself, as if a canopy were over all cells.

    Both are NaN where crowns do not help.

    Parameters
    ----------
    tops, bridge : float64 (height, width)
        Heights of crowns and of the interpolated terrain in metres, NaN where there are none.
    seen : bool (height, width)
        Cells with ground points.
    cell_m : float
    first : (int, int)
        Row and column of the first cell, counted from CRS coordinate 0. Rows increase to the south.
    """
    gap_m = np.minimum(distances(seen, SIGHT_M / cell_m) * cell_m, SIGHT_M)
    mean_tops = _smooth(tops, TREES_MEAN_M, cell_m)
    # Facets from the edge of a wide wood to its other side are too long, so ground is continued.
    beyond = np.isnan(bridge)
    bend_m = np.where(beyond, CONTINUED_BEND_M, BEND_M)
    near = _smooth(np.where(seen, bridge, np.nan), GROUND_MEAN_M, cell_m)
    bridge = np.where(beyond, near, bridge)
    wide = opened(seen, WIDE_M / 2 / cell_m)
    from_wide_m = distances(wide, EDGE_M[1] / cell_m) * cell_m
    is_edge = (from_wide_m >= EDGE_M[0]) & (from_wide_m <= EDGE_M[1])
    edge_trees = np.where(is_edge, tops - bridge, np.nan)
    trees = _trees(edge_trees, mean_tops - bridge, cell_m, first)
    from_crowns = mean_tops - trees.height
    bridge_variance = (gap_m / bend_m) ** 4
    weight = bridge_variance / (bridge_variance + trees.error**2)
    correction = np.where(np.isnan(tops), 0.0, weight * (from_crowns - bridge))
    correction[beyond | np.isnan(trees.height)] = np.nan
    terrain = np.where(np.isnan(bridge), from_crowns, bridge + weight * (from_crowns - bridge))
    terrain[np.isnan(trees.error) | (trees.error > MAX_TREES_ERROR_M)] = np.nan
    return correction, terrain


def _smooth(heights: Float64, deviation_m: float, cell_m: float) -> Float64:
    """Return the weighted mean of the known heights around each cell, NaN where there are none."""
    there = np.isfinite(heights)
    total, weight = (
        scipy.ndimage.gaussian_filter(
            values, deviation_m / cell_m, mode="constant", truncate=MEAN_REACH_M / deviation_m
        )
        for values in (np.where(there, heights, 0.0), there.astype(np.float64))
    )
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan)


def _trees(
    trees: Float64, mean_trees: Float64, cell_m: float, first: tuple[int, int]
) -> _Trees:
    """Return the height of trees from heights above wide ground at its edges (NaN elsewhere).

    The error is the scatter of ``mean_trees`` there, in which crowns are averaged.
    """
    step = max(1, round(NODE_M / cell_m))
    n_rows, n_columns = trees.shape
    first_row, first_column = (-(index % step) for index in first)
    node_rows = np.arange(first_row, n_rows + step, step)
    node_columns = np.arange(first_column, n_columns + step, step)
    rows, columns = np.nonzero(np.isfinite(trees) & np.isfinite(mean_trees))
    heights, means = trees[rows, columns], mean_trees[rows, columns]
    nodes = np.full((2, len(node_rows), len(node_columns)), np.nan)
    reach = FAR_TREES_M / cell_m
    firsts = np.searchsorted(rows, node_rows - reach)
    ends = np.searchsorted(rows, node_rows + reach, "right")
    for i, row in enumerate(node_rows):
        part = slice(firsts[i], ends[i])  # Rows are in order.
        for j, column in enumerate(node_columns):
            away = np.maximum(np.abs(rows[part] - row), np.abs(columns[part] - column))
            near = away <= TREES_M / cell_m
            if np.count_nonzero(near) < MIN_TREES:
                near = away <= reach
            if np.count_nonzero(near) >= MIN_TREES:
                nearby = means[part][near]
                scatter = np.median(np.abs(nearby - np.median(nearby)))
                height = np.median(heights[part][near])
                nodes[:, i, j] = height, max(MAD * scatter, MIN_TREES_ERROR_M)
    down, right = np.arange(n_rows) - first_row, np.arange(n_columns) - first_column
    height, error = (
        _known_linear(
            node, (down // step, down % step / step), (right // step, right % step / step)
        )
        for node in nodes
    )
    return _Trees(height, error)


def _known_linear(
    values: Float64,
    down: Steps,
    right: Steps,
) -> Float64:
    """Interpolate linearly between the known values, NaN where none of the four is known."""
    known = np.isfinite(values)
    total, weight = (
        linear(linear(v, *down).T, *right).T
        for v in (np.where(known, values, 0.0), known.astype(np.float64))
    )
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), np.nan)
