"""Chooses the ground points that make the surface: all, or one of each cell if points are many or noisy."""

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
    """Most points of a bucket that may make the surface: one in each cell of ``thin``."""
    return points if thin is None else min(points, math.ceil(buckets.size / thin.size + 1) ** 2)


def surface_ground(store: TileStore, work: GridBlock, window: Bounds) -> tuple[Ground, Counts]:
    """Ground points read, and the coordinates of those in the window that make the TIN."""
    if work.thin is None:
        ground = read_ground(store, work.rule, window)
        return ground, ground.xyz
    # Cells that the window cuts are read whole, so that all windows choose the same point in them.
    origin = store.meta.frame.origin
    choose = _choice(work.thin, work.percent, origin)
    by_bucket = partial(_whole_cells, choose, work.thin, store.meta.bucket, origin)
    ground = read_ground(store, work.rule, work.thin.around(window), by_bucket)
    xyz = ground.xyz[:, choose(ground.xyz)]
    return ground, xyz[:, PointBlock(xyz).inside(window, origin)]


def _choice(cell: Lattice, percent: int | None, origin: tuple[int, int]) -> Callable[[Counts], Index]:
    """The function that chooses the point of each cell that makes the surface."""
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
    """The points of a bucket that may make the surface: one of each cell that it holds whole, all of the others."""
    whole = PointBlock(xyz).inside(thin.within(buckets.bounds(cell)), origin)
    inner = np.flatnonzero(whole)
    return np.append(inner[choose(xyz[:, inner])], np.flatnonzero(~whole))


def central_points(xyz: Counts, origin: tuple[int, int], lattice: Lattice) -> Index:
    """Indices of the point nearest to the centre of each cell; of equal ones the first by (x, y, z).

    The nearest to the centre, not the lowest, so that the surface is not lowered on average.

    Parameters
    ----------
    xyz : int32, shape (3, n)
        Local counts; whole cells only, as the choice needs all points of a cell.
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


def ranked_points(xyz: Counts, origin: tuple[int, int], lattice: Lattice, percent: int) -> Index:
    """Indices of the point at a percentile of the heights of each cell: 50 is the (lower) median, 0 the lowest.

    A measured point, not a mean: on a slope it lies on the surface wherever in its cell it is. Ties go by (z, x, y).

    Parameters
    ----------
    xyz, origin, lattice
        As those of `central_points`, cells of any size.
    percent : int
        Of n sorted points the one with index ``(n - 1) * percent // 100`` is taken.
    """
    x, y, ix, iy = _in_cells(xyz, origin, lattice)
    order = _sorted_in_cells(x, y, xyz[2].astype(np.int64), ix, iy)
    starts = _starts(ix[order], iy[order])
    counts = np.diff(starts, append=len(order))
    chosen: Index = order[starts + (counts - 1) * percent // 100]
    return chosen


def _sorted_in_cells(x: Int64, y: Int64, z: Int64, ix: Int64, iy: Int64) -> Index:
    """Indices of points sorted by cell, height, x and y, which is their order by (iy, ix, z, x, y)."""
    if len(x) == 0:
        return np.zeros(0, np.int64)
    col, row, low = int(ix.min()), int(iy.min()), int(z.min())
    columns, heights = int(ix.max()) - col + 1, int(z.max()) - low + 1
    if (int(iy.max()) - row + 1) * columns * heights >= 1 << 63:
        return np.lexsort((y, x, z, ix, iy))
    # One sort by one number, several times as fast as five; those alike in it are sorted once more.
    keys = ((iy - row) * columns + (ix - col)) * heights + (z - low)
    order: Index = np.argsort(keys)
    alike = np.diff(keys[order]) == 0
    tied = np.flatnonzero(np.append(alike, False) | np.append(False, alike))
    ties = order[tied]
    order[tied] = ties[np.lexsort((y[ties], x[ties], keys[ties]))]
    return order


def _in_cells(xyz: Counts, origin: tuple[int, int], lattice: Lattice) -> tuple[Int64, Int64, Int64, Int64]:
    """Absolute x and y of points, and column and row of the cell of each."""
    x, y = (xyz[axis].astype(np.int64) + origin[axis] for axis in (0, 1))
    return x, y, lattice.index(x), lattice.index(y)


def _starts(ix: Int64, iy: Int64) -> Index:
    """Where each cell begins in points that are sorted by cells."""
    differs = (np.diff(ix) != 0) | (np.diff(iy) != 0)
    return np.flatnonzero(np.append(True, differs)[: len(ix)])
