"""Work on a window in blocks, so that rasters do not grow with its extent."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ptd.cells import Int32, Int64
from ptd.frame import CellLattice
from ptd.ground.morphology import Bool

SIDE_CELLS = 2048
"""Side of a block, without what lies around it within reach."""


def blocks(
    x: Int32, y: Int32, cells: CellLattice, reach: int, side: int | None = None
) -> Iterator[tuple[Int64, Bool]]:
    """Points in square blocks of cells, each with all points within ``reach`` cells of the block.

    So no raster is larger than a block, however far apart the points are; what depends on nothing beyond the reach is
    the same in any blocks.

    Parameters
    ----------
    x, y : int32 [n]
        Local counts, by rows of cells (as `ptd.cells.lowest_per_cell` gives them).
    cells : CellLattice
    reach : int
    side : int, optional
        Cells along a side of a block; `SIDE_CELLS` if left out.

    Yields
    ------
    index : int64 [m]
    inner : bool [m]
        Which of them belong to the block; each point to one.
    """
    if x.size == 0:
        return
    side = SIDE_CELLS if side is None else side
    columns, rows = cells.places(x, y)
    columns -= columns.min()
    rows -= rows[0]
    if columns.max() < side + 2 * reach and rows[-1] < side + 2 * reach:
        yield np.arange(x.size), np.ones(x.size, np.bool_)
        return
    for south in range(0, int(rows[-1]) + 1, side):
        first, last = np.searchsorted(rows, (south - reach, south + side + reach))
        band, own_rows = columns[first:last], rows[first:last] // side == south // side
        for west in np.unique(band[own_rows] // side) * side:
            index = np.flatnonzero((band >= west - reach) & (band < west + side + reach))
            yield index + first, own_rows[index] & (band[index] // side == west // side)
