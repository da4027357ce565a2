"""Where a sensor saw through: points far below other points over an area, as a laser has them under plants.

Image matching gives one surface: its points lie above each other beside walls alone, which are lines. Cells are
those of a lattice of `CELL_M` anchored at CRS coordinate 0. A cell has a *gap* if no point lies in `GAP_BINS` or more
successive bins of height, each `BIN_M` high from the cell's lowest point on, between two of its points. It is *seen
through* if so have `LEAST_OF_9` of the 3 x 3 cells around it, itself among them. Each cell belongs to the core that
holds its lowest point: counts add up for any tiles. Where nothing stands, nothing is seen through: then it tells
nothing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, cell_keys, lowest_by_key, occupied
from ptd.frame import Cells, Scale, Window
from ptd.kernel import kernel

CELL_M, BIN_M = 2.0, 1.0
GAP_BINS, LEAST_OF_9 = 2, 7
REACH_M = 3 * CELL_M
"""Around the core, all points must be there for `seen_through` to give the same with any tiles."""

Bool = npt.NDArray[np.bool_]


@kernel
def _gaps(z: Int32, slot: Int64, low: Int32, bin_counts: float) -> Bool:
    """Which cells have a gap: bool [cells]. Bins from the 64th on are one."""
    filled = np.zeros(low.size, np.uint64)
    for i in range(z.size):
        k = slot[i]
        height = min((np.int64(z[i]) - low[k]) / bin_counts, 63.0)
        filled[k] |= np.uint64(1) << np.uint64(height)
    gap = np.zeros(low.size, np.bool_)
    for k in range(low.size):
        empty = 0
        for b in range(64):
            if (filled[k] >> np.uint64(b)) & np.uint64(1):
                gap[k] |= empty >= GAP_BINS
                empty = 0
            else:
                empty += 1
    return gap


@kernel
def _seen_through(keys: Int64, gap: Bool, own: Bool, width: int) -> int:
    """How many of a core's cells are seen through; the keys are sorted, with a margin of a column at each end."""
    n = 0
    for k in range(keys.size):
        if not (own[k] and gap[k]):
            continue
        around = 0
        for row in range(-1, 2):
            j = np.searchsorted(keys, keys[k] + row * width - 1)
            while j < keys.size and keys[j] <= keys[k] + row * width + 1:
                around += gap[j]
                j += 1
        n += around >= LEAST_OF_9
    return n


def seen_through(xyz: Int32, core: Window, scale: Scale) -> dict[str, int]:
    """Cells of a core, and how many of them are seen through.

    Parameters
    ----------
    xyz : int32 [3, n]
        All points within `REACH_M` of the core, local counts, in any order; more may be there.
    core : Window
    scale : Scale

    Returns
    -------
    dict
        ``looks`` (cells of `CELL_M` with any point) and ``through``.
    """
    x, y, z = (np.ascontiguousarray(c) for c in xyz)
    if x.size == 0:
        return {"looks": 0, "through": 0}
    cells = Cells.of(CELL_M, scale)
    col0, row0 = cells.column(int(x.min())) - 1, cells.row(int(y.min()))
    width = cells.column(int(x.max())) + 2 - col0
    point_keys = cell_keys(x, y, cells.p, cells.q, cells.origin_x, cells.origin_y, col0, row0, width)
    keys, slot = occupied(point_keys, width * (cells.row(int(y.max())) - row0 + 1))
    lowest = lowest_by_key(x, y, z, slot, keys.size)
    gap = _gaps(z, slot, z[lowest], scale.counts_z(BIN_M))
    own = core.has(x[lowest], y[lowest])
    return {"looks": int(own.sum()), "through": int(_seen_through(keys, gap, own, width))}
