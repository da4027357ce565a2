"""Counts of cells that a sensor penetrates: points lie far below other points, as under plants in a LiDAR cloud.

Image matching gives one surface. Its points lie above each other only next to walls, which are
lines in the plan. In an area where nothing stands, no sensor penetrates a cell, so the counts
show nothing there. Each cell belongs to the core with its lowest point, so the counts of tiles
add up. There are three kinds of cells:

- *Cells* have a size of `CELL_M`, on a lattice anchored at CRS coordinate 0. A cell has a *gap* if at least `GAP_BINS`
  successive bins of height between two of its points are empty. Bins are `BIN_M` high and begin at the cell's lowest
  point. A cell is *seen through* if it and at least `MIN_OF_9` of the 3 x 3 cells around it have a gap, itself
  counted.
- *Wide cells* have a size of `WIDE_M`, because smaller cells contain too few points in sparse clouds. In the plan,
  points below plants lie among the points of the plants, and points below a wall or a cliff lie next to them. A wide
  cell is *mixed*
  if it has a gap of `GAP_M` in height, and no line in the plan separates the points below the gap from those above it.
  At least `BELOW` points must lie below, because blunders are fewer. A wide cell is seen through if it and at least
  `MIN_MIXED` of the 3 x 3 cells around it are mixed. It has `MIN_POINTS` to `MAX_POINTS` points: fewer show nothing,
  and with more points cells of `CELL_M` suffice.
- Cells with *overhangs* are counted in an eighth of the area. Lattices of all sizes in `OVERHANG_CELLS_M` are tried,
  and cells with `HANGING_FEWEST` to `HANGING_MOST` points, about 8 x 8, count. A cell has an overhang if at least two
  points lie below and two above a gap of `HANGING_GAP_M` in height. Lasers see below crowns and eaves, and
  photogrammetric clouds have hardly any overhangs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from ptd.arrays import Bool, Int32, Int64
from ptd.cells import cell_keys, lowest_by_key, occupied
from ptd.frame import CellLattice, Scale, Window
from ptd.kernel import as_int64, kernel
from ptd.matched.cells import by_cell
from ptd.sorting import sort_by

CELL_M, BIN_M = 2.0, 1.0
GAP_BINS, MIN_OF_9 = 2, 7
WIDE_M, GAP_M, BELOW = 4.0, 2.0, 3
MIN_MIXED, MIN_POINTS, MAX_POINTS = 3, 6, 96
OVERHANG_CELLS_M = (0.5, 1.0, 2.0, 4.0)
HANGING_FEWEST, HANGING_MOST, HANGING_GAP_M = 24, 192, 1.0
REACH_M = 3 * WIDE_M
"""Margin around the core within which `seen_through` needs all points to give the same counts
with any tiles."""

COUNTS = (
    "looks",
    "through",
    "wide_looks",
    "wide_through",
    "wide_gaps",
    "overhang_looks",
    "overhangs",
)


@kernel
def _gaps(z: Int32, slot: Int64, low: Int32, bin_counts: float) -> Bool:
    """Return a mask of the cells with a gap: bool [cells]. All bins from the 64th on count as one."""
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
def _parted(x: Int64, y: Int64, below: int, n: int) -> bool:
    """Return whether a line in one of eight directions separates the first ``below`` points from the others."""
    for east, north in ((1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)):
        lowest = first = east * x[0] + north * y[0]
        last = highest = east * x[below] + north * y[below]
        for i in range(below):
            at = east * x[i] + north * y[i]
            lowest, first = min(lowest, at), max(first, at)
        for i in range(below, n):
            at = east * x[i] + north * y[i]
            last, highest = min(last, at), max(highest, at)
        if first <= last or highest <= lowest:
            return True
    return False


@kernel
def _mixed(
    x: Int32, y: Int32, z: Int32, starts: Int64, order: Int32, gap_counts: float
) -> tuple[Bool, Bool, Bool]:
    """Return masks of the wide cells with the right number of points, of those with a gap, and of mixed cells."""
    n = starts.size - 1
    asked, gap, mixed = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    px, py = np.empty(MAX_POINTS, np.int64), np.empty(MAX_POINTS, np.int64)
    for k in range(n):
        if not MIN_POINTS <= starts[k + 1] - starts[k] <= MAX_POINTS:
            continue
        asked[k] = True
        rising = order[starts[k] : starts[k + 1]].copy()
        sort_by(rising, z)
        for i in range(rising.size):
            px[i], py[i] = x[rising[i]], y[rising[i]]
        for i in range(1, rising.size):
            if as_int64(z[rising[i]]) - z[rising[i - 1]] >= gap_counts:
                gap[k] = True
                mixed[k] |= i >= BELOW and not _parted(px, py, i, rising.size)
    return asked, gap, mixed


@kernel
def _hanging(z: Int32, starts: Int64, order: Int32, gap_counts: float) -> tuple[Bool, Bool]:
    """Return masks of the cells with the right number of points, and of those with an overhang."""
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
        rising = order[starts[k] : starts[k + 1]].copy()
        sort_by(rising, z)
        for i in range(2, rising.size - 1):
            hanging[k] |= as_int64(z[rising[i]]) - z[rising[i - 1]] > gap_counts
    return asked, hanging


@kernel
def _seen_through(keys: Int64, gap: Bool, in_core: Bool, width: int, least: int) -> int:
    """Count the cells of a core that are seen through.

    The keys are sorted. They belong to a raster with an empty column at each end of its rows.
    """
    n = 0
    for k in range(keys.size):
        if not (in_core[k] and gap[k]):
            continue
        around = 0
        for row in range(-1, 2):
            j = np.searchsorted(keys, keys[k] + row * width - 1)
            while j < keys.size and keys[j] <= keys[k] + row * width + 1:
                around += gap[j]
                j += 1
        n += around >= least
    return n


def seen_through(
    xyz: Int32, core: Window, scale: Scale, wide_cells: bool = True
) -> dict[str, int]:
    """Count the cells of a core, and those that are seen through.

    Parameters
    ----------
    xyz : int32 [3, n]
        Local counts of all points within `REACH_M` of the core, in any order. Further points do not matter.
    core : Window
    scale : Scale
    wide_cells : bool
        Whether wide cells are counted; otherwise their counts are 0.

    Returns
    -------
    dict
        Number of cells by name. ``looks``: cells of `CELL_M` with points; ``through``: those that are seen through.
        ``wide_looks``: wide cells with the right number of points; ``wide_through``: those that are seen through;
        ``wide_gaps``: those with a gap. ``overhang_looks``: cells that may have an overhang; ``overhangs``: those that
        have one.
    """
    x, y, z = (np.ascontiguousarray(c) for c in xyz)
    if x.size == 0:
        return dict.fromkeys(COUNTS, 0)
    raster = _Raster.of(CELL_M, x, y, z, scale)
    gap = _gaps(z, raster.slot, z[raster.lowest], scale.counts_z(BIN_M))
    is_in_core = core.contains(x[raster.lowest], y[raster.lowest])
    through = int(_seen_through(raster.keys, gap, is_in_core, raster.width, MIN_OF_9))
    counts = dict.fromkeys(COUNTS, 0) | {"looks": int(is_in_core.sum()), "through": through}
    some = np.flatnonzero(raster.some()[raster.slot])
    counts |= _of_overhangs(x[some], y[some], z[some], core, scale)
    return counts | _of_wide_cells(x, y, z, core, scale) if wide_cells else counts


def _of_overhangs(x: Int32, y: Int32, z: Int32, core: Window, scale: Scale) -> dict[str, int]:
    """Count the cells of all sizes in a core, and those with an overhang."""
    n_cells = n_overhangs = 0
    for size_m in OVERHANG_CELLS_M if x.size else ():
        raster = _Raster.of(size_m, x, y, z, scale)
        asked, hanging = _hanging(
            z, *by_cell(raster.slot, raster.keys.size), scale.counts_z(HANGING_GAP_M)
        )
        is_in_core = core.contains(x[raster.lowest], y[raster.lowest])
        n_cells += int((is_in_core & asked).sum())
        n_overhangs += int((is_in_core & hanging).sum())
    return {"overhang_looks": n_cells, "overhangs": n_overhangs}


@dataclass(frozen=True)
class _Raster:
    """The occupied cells of one size, with the lowest point of each.

    Attributes
    ----------
    keys : int64 [cells]
        Indices of the cells in a raster, ascending. It has an empty row or column on each side.
    slot : int64 [n]
        Number of each point's cell.
    lowest : int32 [cells]
        Index of each cell's lowest point.
    col0, row0, width : int
        First column and row of the raster, and its number of columns.
    """

    keys: Int64
    slot: Int64
    lowest: Int32
    col0: int
    row0: int
    width: int

    @classmethod
    def of(cls, size_m: float, x: Int32, y: Int32, z: Int32, scale: Scale) -> Self:
        """Find the occupied cells of a size in metres, on a lattice anchored at CRS coordinate 0."""
        cells = CellLattice.of(size_m, scale)
        col0, row0, width, height = cells.extent(x, y, 1)
        keys, slot = occupied(cell_keys(x, y, cells, col0, row0, width), width * height)
        return cls(keys, slot, lowest_by_key(x, y, z, slot, keys.size), col0, row0, width)

    def some(self) -> Bool:
        """Return a mask of every eighth block of 2 x 2 cells, evenly spread: enough to count frequent features."""
        rows, columns = np.divmod(self.keys, self.width)
        chosen: Bool = ((columns + self.col0) // 2 + (rows + self.row0) // 2 * 3) % 8 == 0
        return chosen


def _of_wide_cells(x: Int32, y: Int32, z: Int32, core: Window, scale: Scale) -> dict[str, int]:
    """Count the wide cells of a core, those that are seen through, and those with a gap."""
    raster = _Raster.of(WIDE_M, x, y, z, scale)
    starts, order = by_cell(raster.slot, raster.keys.size)
    asked, gap, mixed = _mixed(x, y, z, starts, order, scale.counts_z(GAP_M))
    asked_in_core = asked & core.contains(x[raster.lowest], y[raster.lowest])
    through = _seen_through(raster.keys, mixed, asked_in_core, raster.width, MIN_MIXED)
    return {
        "wide_looks": int(asked_in_core.sum()),
        "wide_through": int(through),
        "wide_gaps": int((asked_in_core & gap).sum()),
    }
