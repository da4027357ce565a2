"""Measures around a pixel from which `tiler.grid.sigma_model` computes its standard error."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.gridding.ground_cells import CellWindow, box_sums, cell_counts, plane_variance
from tiler.core.frame import CoordFrame
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.sigma_land import Land

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

Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]


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
    land = Land(terrain, margin, float(pixel_m), spec, block)
    cells = _Cells(_lattice(frame, spec.lattice.size), spec, block)
    ground, objects = points.ground(cells.bounds), points.objects(cells.bounds)
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


def _share(ground: npt.NDArray[np.int64], objects: npt.NDArray[np.int64], half: int) -> Float64:
    """Return the share of objects among the points in windows around cells, 0 without points."""
    n_objects = box_sums(objects, half, MARGIN)
    n = n_objects + box_sums(ground, half, MARGIN)
    share: Float64 = n_objects / np.maximum(n, 1)
    return share


class _Cells:
    """Cells of a lattice that contain the centres of a block's pixels, and `MARGIN` more cells on each side."""

    def __init__(self, lattice: Lattice, spec: RasterSpec, block: Block) -> None:
        x, _ = spec.centres(Block(block.row, block.col, 1, block.width))
        _, y = spec.centres(Block(block.row, block.col, block.height, 1))
        columns, rows = lattice.index(x[0]), lattice.index(y[:, 0])
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
        pixel_values: Float64 = cells[self._pixels]
        return pixel_values
