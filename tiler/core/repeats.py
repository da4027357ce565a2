"""Points at the same position: which of them represents the others, and where a bucket stores it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.classes import NOISE, REPEATED_FLAG, UNCLASSIFIED, UNSEEN_FLAGS
from tiler.core.frame import CoordFrame
from tiler.core.lattice import Lattice
from tiler.core.points import PointBlock

Rows = npt.NDArray[np.intp]


def preference(
    block: PointBlock, participating: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.generic], ...]:
    """Return sort keys that put the point that represents its position first, major key first.

    A point that takes part in filtering comes first, then one that the run sees, then one whose
    class names something other than noise, in the order of the classes. Other attributes follow.
    So the choice depends on the files, by the last key, only if all attributes are equal.

    Parameters
    ----------
    block : PointBlock
    participating : bool, shape (n,)
        Mask of the points that take part in filtering.
    """
    keys: list[npt.NDArray[np.generic]] = [~participating]
    if block.flags is not None:
        keys.append((block.flags & UNSEEN_FLAGS) > 0)
    if block.classification is not None:
        unnamed = block.classification <= UNCLASSIFIED
        noise = np.isin(block.classification, NOISE)
        keys += [unnamed + 2 * noise.astype(np.uint8), block.classification]
    if block.flags is not None:
        keys.append(block.flags)
    for column in (block.returns, block.rgb, block.origin):
        keys += [] if column is None else list(np.atleast_2d(column))
    return tuple(keys)


def representatives(
    block: PointBlock, n_candidates: int, fine: Lattice, frame: CoordFrame
) -> tuple[Rows, Rows]:
    """Return the rows of the repeated points of a bucket, and the row of the point that represents each.

    Repeated points follow their representative in the order of the store, unless it is a
    candidate. All candidates come first, in the order of their fine cells.

    Parameters
    ----------
    block : PointBlock
        All points of a bucket in stored order, with their flags.
    n_candidates : int
        Number of candidates of the bucket.
    fine : Lattice
        Lattice of the cells with one candidate each.
    frame : CoordFrame
    """
    if block.flags is None:
        raise ValueError("block: flags is None; read the column")
    is_repeated = (block.flags & REPEATED_FLAG) > 0
    repeated = np.flatnonzero(is_repeated)
    if not len(repeated):
        return repeated, repeated
    rows = np.arange(len(block))
    rows[repeated] = 0
    chosen = np.maximum.accumulate(rows)[repeated]
    differs: npt.NDArray[np.bool_] = (block.xyz[:, repeated] != block.xyz[:, chosen]).any(
        axis=0
    )
    if differs.any():
        candidates = np.arange(n_candidates)
        cells = _cell_numbers(
            block.xyz[:, np.concatenate((candidates, repeated[differs]))], fine, frame
        )
        chosen[differs] = np.searchsorted(cells[:n_candidates], cells[n_candidates:])
    return repeated, chosen


def _cell_numbers(
    xyz: npt.NDArray[np.int32], fine: Lattice, frame: CoordFrame
) -> npt.NDArray[np.int64]:
    """Return the number of each point's fine cell, counted row by row from the south-west."""
    column = fine.index(xyz[0].astype(np.int64) + frame.origin[0])
    row = fine.index(xyz[1].astype(np.int64) + frame.origin[1])
    column -= column.min()
    numbers: npt.NDArray[np.int64] = (row - row.min()) * (column.max() + 1) + column
    return numbers
