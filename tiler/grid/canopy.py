"""Raster of the pixels in which a closed canopy hides the ground."""

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
from tiler.core.lattice import Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.density import ground_counts
from tiler.grid.records import BlockRecord
from tiler.grid.work import PointsBlock
from tiler.store import TileStore, open_store

GAP = 2
"""Half the width in cells of gaps without points that are filled like the cells around them."""
CANOPY_AROUND = 2 * GAP + 2
"""Margin around a block in cells that influences its pixels."""


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

    A pixel is 1 if its centre lies in a cell under a canopy and no ground point lies in the
    pixel, else 0.

    Returns
    -------
    BlockRecord
        Record of the block. ``filled`` is the number of pixels with a 1.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    hidden = _covered(store, work, spec, block)
    if hidden.any():
        hidden &= ground_counts(store, work.rule, spec, block) == 0
    values = hidden.astype(np.float32)
    store.write_block(work.name, block, values)
    return BlockRecord(
        pixels=values.size, filled=int(np.count_nonzero(hidden)), checksum=checksum(values)
    )


def _covered(
    store: TileStore, work: CanopyBlock, spec: RasterSpec, block: Block
) -> npt.NDArray[np.bool_]:
    """Return a mask of the pixels whose centres lie in cells under a canopy."""
    lattice = Lattice(work.side)
    bounds = spec.block_bounds(block).pad(math.ceil(CANOPY_AROUND * work.side))
    west, south = lattice.index_of(bounds.x0) - 1, lattice.index_of(bounds.y0) - 1
    shape = lattice.index_of(bounds.y1) - south + 2, lattice.index_of(bounds.x1) - west + 2
    cells = store.elected(work.elected, bounds, work.labels)
    frame = store.meta.frame
    wide = (
        size_of_cells(Points(cells.xyz), Scale(frame.metres_xy, frame.metres_z, frame.origin))
        > CELL_M
    )
    labels = np.zeros(len(cells), np.uint8) if cells.labels is None else cells.labels
    x, y = (cells.xyz[axis].astype(np.int64) + frame.origin[axis] for axis in (0, 1))
    rows, columns = lattice.index(y) - south, lattice.index(x) - west
    hidden = (labels & COVERED) > 0
    there, covered = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
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
            covered[index[0][hidden], index[1][hidden]] = True
    covered |= ~there & scipy.ndimage.binary_closing(
        covered, np.ones((2 * GAP + 1, 2 * GAP + 1), np.bool_)
    )
    pixel_rows, pixel_columns = (lattice.index(centres) for centres in _centres(spec, block))
    covered_pixels: npt.NDArray[np.bool_] = covered[
        np.ix_(pixel_rows - south, pixel_columns - west)
    ]
    return covered_pixels


def _centres(
    spec: RasterSpec, block: Block
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the centres of a block's rows and columns in absolute counts, rounded down."""
    p, q = spec.lattice.p, 2 * spec.lattice.q
    rows = spec.north - 1 - block.row - np.arange(block.height, dtype=np.int64)
    columns = spec.west + block.col + np.arange(block.width, dtype=np.int64)
    return ((2 * rows + 1) * p) // q, ((2 * columns + 1) * p) // q
