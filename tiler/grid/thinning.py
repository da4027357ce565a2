"""Choice of the ground points for the TIN: all, or one per cell if points are dense or noisy."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import PointBlock
from tiler.grid.ground import Ground, read_ground
from tiler.grid.work import GridBlock
from tiler.store import TileStore

Counts = npt.NDArray[np.int32]
Index = npt.NDArray[np.intp]
Int64 = npt.NDArray[np.int64]


def max_points_in_bucket(points: int, buckets: Lattice, thin: Lattice | None) -> int:
    """Return the largest number of points of a bucket that may be in the TIN: one per cell of ``thin``."""
    return points if thin is None else min(points, math.ceil(buckets.size / thin.size + 1) ** 2)


def surface_ground(store: TileStore, work: GridBlock, window: Bounds) -> tuple[Ground, Counts]:
    """Read the ground points of a window. Return them, and the coordinates of the points for the TIN."""
    if work.thin is None:
        ground = read_ground(store, work.rule, window)
        return ground, ground.xyz
    # Cells that the window cuts are read whole, so that the same point is chosen in them for
    # all windows.
    origin = store.meta.frame.origin
    choose = _choice(work.thin, work.percent, origin)
    by_bucket = partial(_whole_cells, choose, work.thin, store.meta.bucket, origin)
    ground = read_ground(store, work.rule, work.thin.around(window), by_bucket)
    xyz = ground.xyz[:, choose(ground.xyz)]
    return ground, xyz[:, PointBlock(xyz).inside(window, origin)]


def _choice(
    cell: Lattice, percent: int | None, origin: tuple[int, int]
) -> Callable[[Counts], Index]:
    """Return the function that chooses the point of each cell for the TIN."""
    if percent is None:
        return partial(central_points, origin=origin, lattice=cell)
    return partial(ranked_points, origin=origin, lattice=cell, percent=percent)


def _whole_cells(
    choose: Callable[[Counts], Index],
    thin: Lattice,
    buckets: Lattice,
    origin: tuple[int, int],
    cell: Cell,
    xyz: Counts,
) -> Index:
    """Return the points that may be in the TIN: one per cell that is wholly in the bucket, and all of other cells."""
    whole = PointBlock(xyz).inside(thin.within(buckets.bounds(cell)), origin)
    inner = np.flatnonzero(whole)
    return np.append(inner[choose(xyz[:, inner])], np.flatnonzero(~whole))


def central_points(xyz: Counts, origin: tuple[int, int], lattice: Lattice) -> Index:
    """Return the indices of the points nearest to the centre of each cell, ties in the order of (x, y, z).

    The nearest point does not lower the surface on average, as the lowest point would.

    Parameters
    ----------
    xyz : int32, shape (3, n)
        Local counts of points of whole cells, as the choice needs all points of a cell.
    origin : tuple of int
        Absolute counts of the local 0.
    lattice : Lattice
        Cells of at most 2**20 counts with a denominator of at most 2**9, so that squares fit int64.
    """
    x, y, ix, iy = _in_cells(xyz, origin, lattice)
    # Twice the offset from the centre, in 1 / q counts: an integer.
    dx = 2 * lattice.q * x - (2 * ix + 1) * lattice.p
    dy = 2 * lattice.q * y - (2 * iy + 1) * lattice.p
    order = np.lexsort((xyz[2], y, x, dx * dx + dy * dy, ix, iy))
    return order[_starts(ix[order], iy[order])]


def ranked_points(
    xyz: Counts, origin: tuple[int, int], lattice: Lattice, percent: int
) -> Index:
    """Return the indices of the points at a percentile of the heights of each cell.

    Percentile 50 is the (lower) median, 0 the lowest point. A measured point, unlike a mean,
    lies on the surface wherever it is in its cell. Ties are in the order of (z, x, y).

    Parameters
    ----------
    xyz, origin, lattice
        Parameters of `central_points`, with cells of any size.
    percent : int
        Percentile. Of n sorted points, the one with index ``(n - 1) * percent // 100`` is chosen.
    """
    x, y, ix, iy = _in_cells(xyz, origin, lattice)
    order = _sorted_in_cells(x, y, xyz[2].astype(np.int64), ix, iy)
    starts = _starts(ix[order], iy[order])
    counts = np.diff(starts, append=len(order))
    chosen: Index = order[starts + (counts - 1) * percent // 100]
    return chosen


def _sorted_in_cells(x: Int64, y: Int64, z: Int64, ix: Int64, iy: Int64) -> Index:
    """Return the indices of points in the order of (iy, ix, z, x, y)."""
    if len(x) == 0:
        return np.zeros(0, np.int64)
    col, row, low = int(ix.min()), int(iy.min()), int(z.min())
    columns, heights = int(ix.max()) - col + 1, int(z.max()) - low + 1
    if (int(iy.max()) - row + 1) * columns * heights >= 1 << 63:
        return np.lexsort((y, x, z, ix, iy))
    # One sort by one number is several times as fast as five. Points with equal numbers are
    # sorted once more.
    keys = ((iy - row) * columns + (ix - col)) * heights + (z - low)
    order: Index = np.argsort(keys)
    alike = np.diff(keys[order]) == 0
    tied = np.flatnonzero(np.append(alike, False) | np.append(False, alike))
    ties = order[tied]
    order[tied] = ties[np.lexsort((y[ties], x[ties], keys[ties]))]
    return order


def _in_cells(
    xyz: Counts, origin: tuple[int, int], lattice: Lattice
) -> tuple[Int64, Int64, Int64, Int64]:
    """Return the absolute x and y of points, and the column and row of their cells."""
    x, y = (xyz[axis].astype(np.int64) + origin[axis] for axis in (0, 1))
    return x, y, lattice.index(x), lattice.index(y)


def _starts(ix: Int64, iy: Int64) -> Index:
    """Return the first index of each cell in points that are sorted by cells."""
    differs = (np.diff(ix) != 0) | (np.diff(iy) != 0)
    return np.flatnonzero(np.append(True, differs)[: len(ix)])
