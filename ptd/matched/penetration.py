"""Where a sensor saw through: points far below other points over an area, as a laser has them under plants.

Image matching gives one surface: its points lie above each other beside walls alone, which are lines. Cells are
those of a lattice of `CELL_M` anchored at CRS coordinate 0. A cell has a *gap* if no point lies in `GAP_BINS` or more
successive bins of height, each `BIN_M` high from the cell's lowest point on, between two of its points. It is *seen
through* if so have `MIN_OF_9` of the 3 x 3 cells around it, itself among them. Each cell belongs to the core that
holds its lowest point: counts add up for any tiles. Where nothing stands, nothing is seen through: then it tells
nothing.

Where points are sparse such cells hold too few. So *wide* cells of `WIDE_M` are counted as well, and told apart from
walls and slopes by where the points lie: below plants points lie among those above, below a wall or a cliff beside
them. A wide cell is *mixed* if between some `GAP_M` of height without a point, no line in the plan parts the points
below, `BELOW` at least (blunders are fewer), from those above; it is seen through if so are `MIN_MIXED` of the 3 x 3
around it. Its points are `MIN_POINTS` to `MAX_POINTS`: in fewer nothing shows, and where there are more the other
cells tell.

*Overhangs* are counted in an eighth of the area, in cells about eight points wide, of all `OVERHANG_CELLS_M` those with
`HANGING_FEWEST` to `HANGING_MOST` points: a cell has one if two points at least lie below and two above `HANGING_GAP_M`
of height without a point. Lasers see below crowns and eaves; a matched cloud has next to none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, cell_keys, lowest_by_key, occupied
from ptd.frame import CellLattice, Scale, Window
from ptd.kernel import as_int64, kernel
from ptd.matched.cells import by_cell

CELL_M, BIN_M = 2.0, 1.0
GAP_BINS, MIN_OF_9 = 2, 7
WIDE_M, GAP_M, BELOW = 4.0, 2.0, 3
MIN_MIXED, MIN_POINTS, MAX_POINTS = 3, 6, 96
OVERHANG_CELLS_M = (0.5, 1.0, 2.0, 4.0)
HANGING_FEWEST, HANGING_MOST, HANGING_GAP_M = 24, 192, 1.0
REACH_M = 3 * WIDE_M
"""Around the core, all points must be there for `seen_through` to give the same with any tiles."""

COUNTS = (
    "looks",
    "through",
    "wide_looks",
    "wide_through",
    "wide_gaps",
    "overhang_looks",
    "overhangs",
)

Bool = npt.NDArray[np.bool_]


@kernel
def _gaps(z: Int32, slot: Int64, low: Int32, bin_counts: float) -> Bool:
    """Mask of the cells with a gap: bool [cells]. All bins from the 64th on count as one."""
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
    """Masks of the cells: with enough points, with a gap, and with points below the gap among those above."""
    n = starts.size - 1
    asked, gap, mixed = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for k in range(n):
        points = order[starts[k] : starts[k + 1]]
        if not MIN_POINTS <= points.size <= MAX_POINTS:
            continue
        rising = points[np.argsort(z[points], kind="mergesort")]
        asked[k] = True
        px, py = x[rising].astype(np.int64), y[rising].astype(np.int64)
        for i in range(1, rising.size):
            if as_int64(z[rising[i]]) - z[rising[i - 1]] >= gap_counts:
                gap[k] = True
                mixed[k] |= i >= BELOW and not _parted(px, py, i)
    return asked, gap, mixed


@kernel
def _hanging(z: Int32, starts: Int64, order: Int32, gap_counts: float) -> tuple[Bool, Bool]:
    """Mark the cells with as many points as it takes, and those of them with an overhang."""
    n = starts.size - 1
    asked, hanging = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for k in range(n):
        if not HANGING_FEWEST <= starts[k + 1] - starts[k] <= HANGING_MOST:
            continue
        asked[k] = True
        low = high = as_int64(z[order[starts[k]]])
        for i in order[starts[k] : starts[k + 1]]:
            low, high = min(low, as_int64(z[i])), max(high, as_int64(z[i]))
        if high - low <= gap_counts:
            continue
        rising = np.sort(z[order[starts[k] : starts[k + 1]]])
        for i in range(2, rising.size - 1):
            hanging[k] |= as_int64(rising[i]) - rising[i - 1] > gap_counts
    return asked, hanging


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
        ``wide_looks`` and ``wide_through``, and how many have a gap (``wide_gaps``); ``overhang_looks`` and
        ``overhangs``.
    """
    x, y, z = (np.ascontiguousarray(c) for c in xyz)
    if x.size == 0:
        return dict.fromkeys(COUNTS, 0)
    raster = _Raster.of(CELL_M, x, y, z, scale)
    gap = _gaps(z, raster.slot, z[raster.lowest], scale.counts_z(BIN_M))
    own = core.has(x[raster.lowest], y[raster.lowest])
    through = int(_seen_through(raster.keys, gap, own, raster.width, MIN_OF_9))
    found = dict.fromkeys(COUNTS, 0) | {"looks": int(own.sum()), "through": through}
    some = np.flatnonzero(raster.some()[raster.slot])
    found |= _of_overhangs(x[some], y[some], z[some], core, scale)
    return found | _of_wide_cells(x, y, z, core, scale) if wide_cells else found


def _of_overhangs(x: Int32, y: Int32, z: Int32, core: Window, scale: Scale) -> dict[str, int]:
    """Cells of a core of all sizes, and overhangs in them."""
    looks = overhangs = 0
    for side_m in OVERHANG_CELLS_M if x.size else ():
        raster = _Raster.of(side_m, x, y, z, scale)
        asked, hanging = _hanging(z, *by_cell(raster.slot, raster.keys.size), scale.counts_z(HANGING_GAP_M))
        own = core.has(x[raster.lowest], y[raster.lowest])
        looks += int((own & asked).sum())
        overhangs += int((own & hanging).sum())
    return {"overhang_looks": looks, "overhangs": overhangs}


@dataclass(frozen=True)
class _Raster:
    """The occupied cells of one size, with the lowest point of each.

    Attributes
    ----------
    keys : int64 [cells]
        Ascending, with a margin of a column at each end of a row.
    slot : int64 [n]
        Number of each point's cell.
    lowest : int32 [cells]
        Its index
    col0, row0, width : int
        First column and row, and columns.
    """

    keys: Int64
    slot: Int64
    lowest: Int32
    col0: int
    row0: int
    width: int

    @classmethod
    def of(cls, side_m: float, x: Int32, y: Int32, z: Int32, scale: Scale) -> Self:
        """The cells of that side, on a lattice anchored at CRS coordinate 0."""
        cells = CellLattice.of(side_m, scale)
        col0, row0 = cells.column(int(x.min())) - 1, cells.row(int(y.min()))
        width = cells.column(int(x.max())) + 2 - col0
        point_keys = cell_keys(x, y, cells.p, cells.q, cells.origin_x, cells.origin_y, col0, row0, width)
        keys, slot = occupied(point_keys, width * (cells.row(int(y.max())) - row0 + 1))
        return cls(keys, slot, lowest_by_key(x, y, z, slot, keys.size), col0, row0, width)

    def some(self) -> Bool:
        """Cells of every eighth block of two by two, evenly spread: enough to count what is common."""
        rows, columns = np.divmod(self.keys, self.width)
        chosen: Bool = ((columns + self.col0) // 2 + (rows + self.row0) // 2 * 3) % 8 == 0
        return chosen


def _of_wide_cells(x: Int32, y: Int32, z: Int32, core: Window, scale: Scale) -> dict[str, int]:
    """Wide cells of a core."""
    raster = _Raster.of(WIDE_M, x, y, z, scale)
    starts, order = by_cell(raster.slot, raster.keys.size)
    asked, gap, mixed = _mixed(x, y, z, starts, order, scale.counts_z(GAP_M))
    own = asked & core.has(x[raster.lowest], y[raster.lowest])
    through = _seen_through(raster.keys, mixed, own, raster.width, MIN_MIXED)
    return {"wide_looks": int(own.sum()), "wide_through": int(through), "wide_gaps": int((own & gap).sum())}
