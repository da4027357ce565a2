"""Raster of the crowns of a closed canopy, where they hide the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import scipy

from ptd.frame import Scale
from ptd.matched.by_size import size_of_cells
from ptd.matched.cells import CELL_M
from ptd.matched.step import COVERED
from ptd.passes import Points
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Lattice
from tiler.core.nodata import NODATA
from tiler.core.raster import Block, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.points_near import PointsNear
from tiler.grid.records import BlockRecord
from tiler.grid.work import PointsBlock
from tiler.store import TileStore, open_store

GAP = 2
"""Half the width in cells of gaps without points that are filled like the cells around them."""
SIGHT_M = 60.0
"""Distance from a canopy within which it matters whether ground is seen."""
OPEN = NODATA + 1
"""Value of pixels with ground points. Pixels without ground points and canopy are nodata. All crowns are higher."""


@dataclass(frozen=True, kw_only=True)
class CanopyBlock(PointsBlock):
    """Arguments of `canopy_block`.

    Attributes
    ----------
    elected, labels : str
        Names in the store of the cells on which the filter worked, and of their codes.
    side : Fraction
        Side of the smaller cells in counts. Larger cells are twice as wide.
    """

    elected: str
    labels: str
    side: Fraction


def canopy_block(store_url: str, work: CanopyBlock) -> BlockRecord:
    """Write one block of the canopy. This is a `tiler.schedule.task.Work`.

    A pixel has the height of a crown if its centre lies in a cell under a canopy and no ground
    point lies in the pixel.

    Returns
    -------
    BlockRecord
        Record of the block. ``filled`` is the number of pixels with a crown.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    values, near = _crowns(store, work, spec, block)
    if near:
        seen = PointsNear(store, work.rule, spec, block).ground_per_pixel() > 0
        values[seen] = OPEN
    store.write_block(work.name, block, values)
    return BlockRecord(
        pixels=values.size,
        filled=int(np.count_nonzero(values > OPEN)),
        checksum=checksum(values),
    )


def canopy_reach_cells(side_m: float) -> int:
    """Return the distance in cells around a block within which cells can change its pixels."""
    return math.ceil(SIGHT_M / side_m) + 2 * GAP + 2


def _crowns(
    store: TileStore, work: CanopyBlock, spec: RasterSpec, block: Block
) -> tuple[npt.NDArray[np.float32], bool]:
    """Return the heights of crowns at the pixels' centres (or nodata), and whether a canopy is near the block."""
    lattice, frame = Lattice(work.side), store.meta.frame
    reach = canopy_reach_cells(float(work.side * frame.metres_xy))
    bounds = spec.block_bounds(block).pad(math.ceil(reach * work.side))
    west, south = lattice.index_of(bounds.x0) - 1, lattice.index_of(bounds.y0) - 1
    shape = lattice.index_of(bounds.y1) - south + 2, lattice.index_of(bounds.x1) - west + 2
    cells = store.elected(work.elected, bounds, work.labels)
    labels = np.zeros(len(cells), np.uint8) if cells.labels is None else cells.labels
    hidden = (labels & COVERED) > 0
    if not hidden.any():
        return np.full((block.height, block.width), NODATA, np.float32), False
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
        Lattice(2 * work.side).index(v) * 2 - first for v, first in ((y, south), (x, west))
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
    values = tops[np.ix_(pixel_rows - south, pixel_columns - west)]
    return np.where(np.isfinite(values), values, NODATA).astype(np.float32), True


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
