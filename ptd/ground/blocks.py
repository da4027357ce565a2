"""Division of a window into blocks, so that rasters do not grow with its extent."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ptd.cells import Int32, Int64
from ptd.frame import CellLattice
from ptd.ground.morphology import Bool

BLOCK_CELLS = 2048
"""Side of a block in cells, without the margin around it."""


def blocks(
    x: Int32, y: Int32, cells: CellLattice, reach: int, size: int | None = None
) -> Iterator[tuple[Int64, Bool]]:
    """Divide points into square blocks of cells, each with all points within ``reach`` cells of the block.

    No raster is larger than a block with its margin, however far apart the points are. A result
    that depends only on points within the margin is the same for any blocks.

    Parameters
    ----------
    x, y : int32 [n]
        Local counts, by rows of cells (as `ptd.cells.lowest_per_cell` gives them).
    cells : CellLattice
    reach : int
        Margin around a block in cells.
    size : int, optional
        Number of cells along a side of a block; `BLOCK_CELLS` by default.

    Yields
    ------
    index : int64 [m]
        Indices of the points of a block and its margin.
    inner : bool [m]
        Mask of the points that belong to the block. Each point belongs to one block.
    """
    if x.size == 0:
        return
    size = BLOCK_CELLS if size is None else size
    columns, rows = cells.cell_indices(x, y)
    columns -= columns.min()
    rows -= rows[0]
    if columns.max() < size + 2 * reach and rows[-1] < size + 2 * reach:
        yield np.arange(x.size), np.ones(x.size, np.bool_)
        return
    for south in range(0, int(rows[-1]) + 1, size):
        first, last = np.searchsorted(rows, (south - reach, south + size + reach))
        band, own_rows = columns[first:last], rows[first:last] // size == south // size
        for west in np.unique(band[own_rows] // size) * size:
            index = np.flatnonzero((band >= west - reach) & (band < west + size + reach))
            yield index + first, own_rows[index] & (band[index] // size == west // size)
