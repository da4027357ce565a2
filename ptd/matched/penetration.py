"""Where a sensor saw through: points far below other points over an area, as a laser has them under plants.

Image matching gives one surface: its points lie above each other beside walls alone, which are lines. Cells are
those of a lattice of `CELL_M` anchored at CRS coordinate 0. A cell has a *gap* if no point lies in `GAP_BINS` or more
successive bins of height, each `BIN_M` high from the cell's lowest point on, between two of its points. It is *seen
through* if so have `LEAST_OF_9` of the 3 x 3 cells around it, itself among them. Each cell belongs to the core that
holds its lowest point: counts add up for any tiles. Where nothing stands, nothing is seen through: then it tells
nothing.

Where points are sparse such cells hold too few. So *wide* cells of `WIDE_M` are counted as well, and told apart from
walls and slopes by where the points lie: below plants points lie among those above, below a wall or a cliff beside
them. A wide cell is *mixed* if between some `GAP_M` of height without a point, no line in the plan parts the points
below, `BELOW` at least (blunders are fewer), from those above; it is seen through if so are `LEAST_MIXED` of the 3 x 3
around it. Its points are `FEWEST` to `MOST`: in fewer nothing shows, and where there are more the other cells tell.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, cell_keys, lowest_by_key, occupied
from ptd.frame import Cells, Scale, Window
from ptd.kernel import kernel, wide
from ptd.matched.cells import by_cell

CELL_M, BIN_M = 2.0, 1.0
GAP_BINS, LEAST_OF_9 = 2, 7
WIDE_M, GAP_M, BELOW = 4.0, 2.0, 3
LEAST_MIXED, FEWEST, MOST = 3, 6, 96
REACH_M = 3 * WIDE_M
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
def _parted(x: Int64, y: Int64, below: int) -> bool:
    """Whether a line in one of eight directions has so many first points on one side and the others on the other."""
    for east, north in ((1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)):
        lower = east * x[:below] + north * y[:below]
        upper = east * x[below:] + north * y[below:]
        if lower.max() <= upper.min() or upper.max() <= lower.min():
            return True
    return False


@kernel
def _mixed(
    x: Int32, y: Int32, z: Int32, starts: Int64, order: Int32, gap_counts: float
) -> tuple[Bool, Bool, Bool]:
    """Which cells have as many points as it takes, which of these a gap, and points below it among those above."""
    n = starts.size - 1
    asked, gap, mixed = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for k in range(n):
        points = order[starts[k] : starts[k + 1]]
        if not FEWEST <= points.size <= MOST:
            continue
        rising = points[np.argsort(z[points], kind="mergesort")]
        asked[k] = True
        px, py = x[rising].astype(np.int64), y[rising].astype(np.int64)
        for i in range(1, rising.size):
            if wide(z[rising[i]]) - z[rising[i - 1]] >= gap_counts:
                gap[k] = True
                mixed[k] |= i >= BELOW and not _parted(px, py, i)
    return asked, gap, mixed


@kernel
def _seen_through(keys: Int64, gap: Bool, own: Bool, width: int, least: int) -> int:
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
        n += around >= least
    return n


def seen_through(xyz: Int32, core: Window, scale: Scale, wide_cells: bool = True) -> dict[str, int]:
    """Cells of a core, and how many of them are seen through.

    Parameters
    ----------
    xyz : int32 [3, n]
        All points within `REACH_M` of the core, local counts, in any order; more may be there.
    core : Window
    scale : Scale
    wide_cells : bool
        Count in wide cells, too; else there are none, and nothing is seen through in them.

    Returns
    -------
    dict
        ``looks`` (cells of `CELL_M` with any point) and ``through``; of wide cells with as many points as it takes
        ``wide_looks`` and ``wide_through``, and how many have a gap (``wide_gaps``).
    """
    x, y, z = (np.ascontiguousarray(c) for c in xyz)
    nothing = dict.fromkeys(("looks", "through", "wide_looks", "wide_through", "wide_gaps"), 0)
    if x.size == 0:
        return nothing
    cells = Cells.of(CELL_M, scale)
    col0, row0 = cells.column(int(x.min())) - 1, cells.row(int(y.min()))
    width = cells.column(int(x.max())) + 2 - col0
    point_keys = cell_keys(x, y, cells.p, cells.q, cells.origin_x, cells.origin_y, col0, row0, width)
    keys, slot = occupied(point_keys, width * (cells.row(int(y.max())) - row0 + 1))
    lowest = lowest_by_key(x, y, z, slot, keys.size)
    gap = _gaps(z, slot, z[lowest], scale.counts_z(BIN_M))
    own = core.has(x[lowest], y[lowest])
    through = int(_seen_through(keys, gap, own, width, LEAST_OF_9))
    found = nothing | {"looks": int(own.sum()), "through": through}
    return found | _of_wide_cells(x, y, z, core, scale) if wide_cells else found


def _of_wide_cells(x: Int32, y: Int32, z: Int32, core: Window, scale: Scale) -> dict[str, int]:
    """Wide cells of a core."""
    cells = Cells.of(WIDE_M, scale)
    col0, row0 = cells.column(int(x.min())) - 1, cells.row(int(y.min()))
    width, rows = cells.column(int(x.max())) + 2 - col0, cells.row(int(y.max())) - row0 + 1
    point_keys = cell_keys(x, y, cells.p, cells.q, cells.origin_x, cells.origin_y, col0, row0, width)
    keys, slot = occupied(point_keys, width * rows)
    asked, gap, mixed = _mixed(x, y, z, *by_cell(slot, keys.size), scale.counts_z(GAP_M))
    lowest = lowest_by_key(x, y, z, slot, keys.size)
    own = asked & core.has(x[lowest], y[lowest])
    through = _seen_through(keys, mixed, own, width, LEAST_MIXED)
    return {"wide_looks": int(own.sum()), "wide_through": int(through), "wide_gaps": int((own & gap).sum())}
