"""Raster of the standard error of heights, from measures around a pixel: a sum of variances, each with a constant.

The constants are fitted by ``python -m tests.benchmarks.sigma_constants`` to scenes whose terrain is known. Their
accuracy on scenes that were left out of the fit is in ``docs/benchmarks.md``. LiDAR and photogrammetric clouds have
different constants. For a cloud of unknown source the larger variance counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from ptd.arrays import Bool, Float64, Floating, Int64
from ptd.gridding.ground_cells import CellWindow, box_sums, cell_counts, plane_variance
from ptd.gridding.shape import gradients
from tiler.core.lattice import Bounds, CoordFrame, Lattice
from tiler.core.products import CANOPY, COVERED_SHARE, EDGES_M, FILLED, GROUPS, WATER
from tiler.core.raster import Block, RasterSpec
from tiler.core.results import SigmaGroup, SigmaResult
from tiler.grid.block_surroundings import PixelCells, PointsNear, linear
from tiler.grid.canopy import BEND_M
from tiler.grid.steps import Counts

LAND_CELL_M = 3.4
"""Side of the cells whose means represent the terrain. A median of 5 x 5 of them covers 17
m."""
HALF = 2
"""Number of cells on each side of the middle cell in the window of the median."""
RIM = HALF + 1
"""Margin around a block in cells."""


def land_margin(pixel_m: float) -> int:
    """Return the margin in pixels around a block that `_Land` needs."""
    return _side(pixel_m) * (RIM + 1)


def _side(pixel_m: float) -> int:
    """Return the side of a cell in pixels."""
    return max(1, round(LAND_CELL_M / pixel_m))


class _Land:
    """Heights of a block and its margin, and their means over cells of whole pixels."""

    def __init__(
        self, heights: Float64, margin: int, pixel_m: float, spec: RasterSpec, block: Block
    ) -> None:
        """Prepare the heights of a block and of ``margin`` pixels around it, NaN without a height."""
        self._cells = PixelCells(spec, block, _side(pixel_m), RIM)
        window = self._cells.window
        top, left = window.row - block.row + margin, window.col - block.col + margin
        self._heights = heights[top : top + window.height, left : left + window.width]
        self._means = self._cells.means(self._heights, ~np.isnan(self._heights))

    def known(self) -> Bool:
        """Return a mask of the block's pixels that have a height."""
        return ~np.isnan(self._heights[np.ix_(self._cells.rows, self._cells.columns)])

    def slope(self, pixel: float) -> Float64:
        """Return the slope of the cells' means at the block's pixels (rise over run).

        The side of a pixel, ``pixel``, is in units of the heights.
        """
        cells = self._cells
        east, north = gradients(self._means, pixel * cells.side)
        steep = np.sqrt(east * east + north * north)
        pixel_slope = steep[
            np.ix_(cells.rows // cells.side - 1, cells.columns // cells.side - 1)
        ]
        return np.nan_to_num(pixel_slope)

    def off_trend(self) -> Float64:
        """Return the absolute deviation of the block's heights from the median of the cells around.

        Medians are interpolated linearly between the middles of cells.
        """
        around = np.lib.stride_tricks.sliding_window_view(
            self._means, (2 * HALF + 1, 2 * HALF + 1)
        )
        ordered = np.sort(around.reshape(*around.shape[:2], -1), axis=-1)  # NaN is last
        n = np.count_nonzero(~np.isnan(ordered), axis=-1)[..., np.newaxis]
        low = np.take_along_axis(ordered, np.maximum((n - 1) // 2, 0), -1)[..., 0]
        high = np.take_along_axis(ordered, np.minimum(n // 2, ordered.shape[-1] - 1), -1)[
            ..., 0
        ]
        cells = self._cells
        rows, columns = cells.between(cells.rows, HALF), cells.between(cells.columns, HALF)
        trend = linear(linear((low + high) / 2, *rows).T, *columns)
        heights = self._heights[np.ix_(cells.rows, cells.columns)]
        return np.nan_to_num(np.abs(heights - trend.T))


CELL_M = Fraction(1)
"""Side of the cells in which points are counted, or half a pixel if that is wider."""
PLANE_HALVES = (2, 5, 10, 20)
"""Half widths in cells of the windows in which a plane is fitted to the ground."""
NEAR, AROUND = 3, 10
"""Half widths in cells of the windows in which objects are counted."""
MARGIN = max(PLANE_HALVES)
"""Margin around a block in cells."""
FIRST_REACH_M = Fraction(10)
"""Radius of the first search for ground, as few pixels need a larger one."""


class Measures(NamedTuple):
    """Measures of the pixels of a block, each float64 (height, width).

    Attributes
    ----------
    roughness : metres
        Standard deviation of the ground about a plane within 2.5 m, or within up to 20 m if there are fewer than six
        points; 0 if there are too few even then.
    distance : metres
        Plan distance from the pixel's centre to the nearest ground point.
    slope : rise over run
        Slope of the terrain over about 10 m.
    off_trend : metres
        Absolute deviation from the median of the terrain in a window 17 m wide.
    near_objects, around_objects : share
        Share of objects among the points within 3.5 and 10.5 m.
    """

    roughness: Float64
    distance: Float64
    slope: Float64
    off_trend: Float64
    near_objects: Float64
    around_objects: Float64


def measures_of(points: PointsNear, terrain: Float64, margin: int, cap: Fraction) -> Measures:
    """Compute the measures of a block's pixels. Measures of pixels without a height are not meaningful.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height + 2 * margin, width + 2 * margin)
        Heights of the block and of pixels around it, NaN without a height.
    margin : int
        At least `land_margin`.
    cap : Fraction
        Largest distance to ground in counts. Larger distances count as this one.
    """
    spec, block, frame = points.spec, points.block, points.frame
    unit_m, count_m = float(frame.units.vertical), float(frame.metres_z)
    pixel_m = spec.lattice.size * frame.metres_xy
    land = _Land(terrain, margin, float(pixel_m), spec, block)
    cells = _Cells(_lattice(frame, spec.lattice.size), spec, block)
    ground, objects = points.ground_and_objects(cells.bounds)
    window = cells.window(frame.origin)
    variance = plane_variance(ground, window, PLANE_HALVES)
    counts = cell_counts(ground, window), cell_counts(objects, window)
    first = min(frame.counts(FIRST_REACH_M), cap)
    distance = points.distance_to(ground, first)
    if first < cap and np.isinf(distance[land.known()]).any():
        distance = points.ground_distance(cap)
    return Measures(
        roughness=cells.at_pixels(np.sqrt(np.nan_to_num(variance)) * count_m),
        distance=np.minimum(distance, float(cap)) * float(frame.metres_xy),
        slope=land.slope(float(pixel_m / frame.units.vertical)),
        off_trend=land.off_trend() * unit_m,
        near_objects=cells.at_pixels(_share(*counts, NEAR)),
        around_objects=cells.at_pixels(_share(*counts, AROUND)),
    )


def reach_of(frame: CoordFrame, pixel: Fraction, cap: Fraction) -> int:
    """Return the distance in counts around a block within which points can change its measures.

    Parameters ``pixel`` and ``cap`` are in counts.
    """
    return math.ceil(max(cap, (MARGIN + 1) * _lattice(frame, pixel).size)) + 1


def _lattice(frame: CoordFrame, pixel: Fraction) -> Lattice:
    return Lattice(max(frame.counts(CELL_M), pixel / 2))


def _share(ground: Int64, objects: Int64, half: int) -> Float64:
    """Return the share of objects among the points in windows around cells, 0 without points."""
    n_objects = box_sums(objects, half, MARGIN)
    n = n_objects + box_sums(ground, half, MARGIN)
    share: Float64 = n_objects / np.maximum(n, 1)
    return share


class _Cells:
    """Cells of a lattice that contain the centres of a block's pixels, and `MARGIN` more cells on each side."""

    def __init__(self, lattice: Lattice, spec: RasterSpec, block: Block) -> None:
        x, y = spec.axes(block)
        columns, rows = lattice.index(x), lattice.index(y)
        self._lattice = lattice
        self._west, self._north = int(columns[0]) - MARGIN, int(rows[0]) + MARGIN
        self._height = int(rows[0] - rows[-1]) + 1 + 2 * MARGIN
        self._width = int(columns[-1] - columns[0]) + 1 + 2 * MARGIN
        self._pixels = np.ix_(rows[0] - rows, columns - columns[0])

    @property
    def bounds(self) -> Bounds:
        """Bounds of all cells in counts."""
        first = self._lattice.first
        south, east = self._north - self._height + 1, self._west + self._width
        return Bounds(first(self._west), first(south), first(east), first(self._north + 1))

    def window(self, origin: tuple[int, int]) -> CellWindow:
        """Return the cells in the form that kernels need."""
        lattice = self._lattice
        return CellWindow(
            lattice.p, lattice.q, self._west, self._north, self._height, self._width, *origin
        )

    def at_pixels(self, cells: Float64) -> Float64:
        """Return the values of cells, without their margin, at the block's pixels."""
        return cells[self._pixels]


LASER, MATCHED = "lidar", "dim"
"""Kinds of clouds, as methods name them (`ptd.passes.RunHints`)."""
GAP_M = 0.5
"""Distance below which a ground point counts as if it were in the pixel."""

MAX_TREND_M = 10.0
"""Upper limit of the gap in the term `Weights.trend_gap`, as the window of the trend reaches
only 8.5 m."""
FLOOR_M2 = 0.02**2
"""Least variance: strips, grids and geoids differ by some centimetres, which is not in any
measure."""
LINEAR = 0.5
"""Mean variance at a random position in a triangle whose corners have noise of variance 1."""


@dataclass(frozen=True)
class Weights:
    """Factors of the terms of the variance (see `terms`).

    Attributes
    ----------
    always, canopy, water : m2
    roughness, trend_objects : no unit
    gap_roughness, trend_gap : 1/m
    gap_slope, gap_objects : m
    """

    always: float
    roughness: float
    gap_roughness: float
    gap_slope: float
    gap_objects: float
    trend_objects: float
    trend_gap: float
    canopy: float
    water: float


WEIGHTS: Mapping[str, Weights] = {
    LASER: Weights(
        always=FLOOR_M2,
        roughness=LINEAR,
        gap_roughness=0.609,
        gap_slope=0.0,
        gap_objects=0.0587,
        trend_objects=0.429,
        trend_gap=0.286,
        canopy=0.0,
        water=0.0466,
    ),
    MATCHED: Weights(
        always=FLOOR_M2,
        roughness=0.905,
        gap_roughness=0.0266,
        gap_slope=0.379,
        gap_objects=0.00361,
        trend_objects=0.523,
        trend_gap=0.881,
        canopy=0.345,
        water=0.0466,
    ),
}
"""Weights by kind of cloud, fitted by ``tests/benchmarks/sigma_constants.py``."""


def terms(found: Measures, mask: Floating) -> dict[str, Float64]:
    """Return the terms of the variance by the names of `Weights`, without their weights.

    In water, gaps and objects do not count, as its level comes from the shores.
    """
    wet = mask == WATER
    gap = np.where(wet, 0.0, np.maximum(found.distance - GAP_M, 0.0))
    objects = np.where(wet, 0.0, found.around_objects)
    rough, off = found.roughness**2, found.off_trend**2
    return {
        "always": np.ones_like(gap),
        "roughness": rough,
        "gap_roughness": gap * rough,
        "gap_slope": gap * found.slope,
        "gap_objects": gap * objects,
        "trend_objects": off * objects,
        "trend_gap": off * np.minimum(gap, MAX_TREND_M),
        "canopy": (mask == CANOPY).astype(np.float64),
        "water": wet.astype(np.float64),
    }


def standard_error_m(found: Measures, mask: Floating, kind: str | None) -> Float64:
    """Return the standard error of heights in metres.

    Parameters
    ----------
    found : Measures
    mask : float, the shape of the measures
        Values of the mask.
    kind : str or None
        Source of the cloud: `LASER`, `MATCHED`, or None if it is not known.
    """
    parts = terms(found, mask)
    variances = [
        sum(weight * parts[term] for term, weight in asdict(weights).items())
        for name, weights in WEIGHTS.items()
        if kind in (name, None)
    ]
    sigma: Float64 = np.sqrt(np.maximum.reduce(variances))
    return sigma


def sigma(
    points: PointsNear,
    terrain: Float64,
    mask: Float64,
    kind: str | None,
    below: Float64 | None = None,
    *,
    margin: int,
    cap: Fraction,
) -> tuple[Float64, Counts]:
    """Return the standard error of the heights in vertical units.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height + 2 * margin, width + 2 * margin)
        Delivered heights of the block and around it.
    mask : float64 (height, width)
    kind : str or None
        Source of the cloud as methods name it (`ptd.passes.RunHints`); None if it is not known.
    below : float64 (height, width), optional
        Terrain below a canopy, if it is made. There, ground farther than `BEND_M` counts as if it were as near as this.
    margin : int
    cap : Fraction
        Largest distance to ground in counts. Larger distances count as this one.

    Returns
    -------
    errors : float64 (height, width)
    counts : dict
        ``groups``: number of pixels and sum of squares in mm2 by group (`tiler.core.products.GROUPS`).
        ``histogram``: number of pixels by the classes of `tiler.core.products.EDGES_M`, by group.
    """
    height, width = mask.shape
    there = ~np.isnan(terrain[margin : margin + height, margin : margin + width])
    if not there.any():
        return np.full(there.shape, np.nan), {"groups": {}, "histogram": {}}
    measures = measures_of(points, terrain, margin, cap)
    if below is not None:
        limit_m = np.where(np.isnan(below), np.inf, BEND_M)
        measures = measures._replace(distance=np.minimum(measures.distance, limit_m))
    sigma_m = standard_error_m(measures, mask, kind)
    groups = {name: sigma_m[pixels] for name, pixels in _groups(measures, mask, there).items()}
    values = np.where(there, sigma_m / float(points.frame.units.vertical), np.nan)
    return values, {
        "groups": {name: _squares(errors) for name, errors in groups.items()},
        "histogram": {name: _histogram(errors) for name, errors in groups.items()},
    }


def _groups(found: Measures, mask: Float64, there: Bool) -> dict[str, Bool]:
    """Return masks of the pixels of open ground, covered ground and water, by group."""
    wet = there & (mask == WATER)
    covered = (found.near_objects >= COVERED_SHARE) | (mask == CANOPY) | (mask == FILLED)
    covered &= there & ~wet
    return dict(zip(GROUPS, (there & ~wet & ~covered, covered, wet), strict=True))


def _squares(sigma_m: Float64) -> list[int]:
    """Return the number of pixels, and the sum of squares in mm2."""
    return [sigma_m.size, int(np.rint((1000 * sigma_m) ** 2).astype(np.int64).sum())]


def _histogram(sigma_m: Float64) -> list[int]:
    """Count the pixels between consecutive `EDGES_M`. The first and last bin include all values beyond the ends."""
    bins = np.searchsorted(EDGES_M[1:-1], sigma_m, side="right")
    counts: list[int] = np.bincount(bins, minlength=len(EDGES_M) - 1).tolist()
    return counts


def sigma_result(kind: str | None, counts: Sequence[Mapping[str, Any]]) -> SigmaResult:
    """Return the summary of the standard error from the counts of its blocks.

    ``kind`` is the kind of cloud whose constants were used, or None for the larger error of both kinds.
    """
    groups = {name: _group(name, counts) for name in GROUPS}
    return SigmaResult(kind, list(EDGES_M), **groups)


def _group(name: str, counts: Sequence[Mapping[str, Any]]) -> SigmaGroup:
    """Return the pixels, the expected RMSE and the histogram of a group of ground."""
    there = [of_block for of_block in counts if name in of_block["groups"]]
    pixels, squares = (sum(of_block["groups"][name][i] for of_block in there) for i in (0, 1))
    histogram = [0] * (len(EDGES_M) - 1)
    for of_block in there:
        histogram = [a + b for a, b in zip(histogram, of_block["histogram"][name], strict=True)]
    rmse_m = round(sqrt(squares / pixels) / 1000, 4) if pixels else None
    return SigmaGroup(pixels, rmse_m, histogram)
