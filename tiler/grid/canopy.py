"""Raster of the crowns of a closed canopy, where they hide the ground."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import scipy

from ptd.frame import Scale
from ptd.matched.cells import CELL_M
from ptd.matched.step import COVERED, size_of_cells
from ptd.passes import Points
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Lattice
from tiler.core.nodata import NODATA
from tiler.core.points import PointBlock
from tiler.core.raster import Block, RasterSpec
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.steps import Counts, Position

Bools = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]

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


def _crowns(cells: PointBlock, hidden: Bools, place: Position, side: Fraction) -> Float64:
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
    pixel_rows, pixel_columns = (lattice.index(centres) for centres in _centres(spec, block))
    values: Float64 = tops[np.ix_(pixel_rows - south, pixel_columns - west)]
    return values


def _fill_gaps(tops: npt.NDArray[np.float64], there: npt.NDArray[np.bool_]) -> None:
    """Give gaps without points in a canopy the mean height of the crowns around them."""
    covered, square = np.isfinite(tops), np.ones((2 * GAP + 1, 2 * GAP + 1))
    gaps = ~there & scipy.ndimage.binary_closing(covered, square.astype(np.bool_))
    total, n = (
        scipy.ndimage.correlate(values, square, mode="constant")
        for values in (np.where(covered, tops, 0.0), covered.astype(np.float64))
    )
    tops[gaps] = total[gaps] / n[gaps]


def _centres(
    spec: RasterSpec, block: Block
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the centres of a block's rows and columns in absolute counts, rounded down."""
    p, q = spec.lattice.p, 2 * spec.lattice.q
    rows = spec.north - 1 - block.row - np.arange(block.height, dtype=np.int64)
    columns = spec.west + block.col + np.arange(block.width, dtype=np.int64)
    return ((2 * rows + 1) * p) // q, ((2 * columns + 1) * p) // q
