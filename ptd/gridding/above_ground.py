"""Objects above the ground: the highest return of each pixel for a surface model, and ground points at their feet.

A single high point does not count if nothing nearby supports it. Ground points next to an object that
is much higher are remnants of its walls, as image matching leaves them: without the buildings,
they would stay in the terrain as stumps.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int32, Int64
from ptd.cells import CellIndex, CellTable, Xyz, find_slot
from ptd.frame import CellLattice
from ptd.gridding.ground_cells import CellWindow, cell_number
from ptd.kernel import as_int64, kernel

NOTHING = np.iinfo(np.int32).min
"""Height of a pixel without a return."""


@kernel
def _higher(ax: int, ay: int, az: int, bx: int, by: int, bz: int) -> bool:
    """Whether return a ranks before b: higher, then lexicographically smaller in (x, y)."""
    if az != bz:
        return az > bz
    if ax != bx:
        return ax < bx
    return ay < by


@kernel
def _update(
    top: Int32,
    lowest: Int32,
    points: Xyz,
    wanted: Bool,
    limits: Float64,
    window: tuple[int, ...],
) -> None:
    x, y, z = points
    inverse = 1.0 / window[0]
    for i in range(x.size):
        if not wanted[i]:
            continue
        px, py, pz = as_int64(x[i]), as_int64(y[i]), as_int64(z[i])
        pixel = cell_number(px, py, window, inverse)
        if pixel < 0 or pz > limits[pixel]:
            continue
        lowest[pixel] = min(lowest[pixel], z[i])
        first, second = top[pixel, 0], top[pixel, 1]
        if pz == first[2] and px == first[0] and py == first[1]:
            continue  # a repeated return does not count as the second
        if _higher(px, py, pz, as_int64(first[0]), as_int64(first[1]), as_int64(first[2])):
            second[0], second[1], second[2] = first[0], first[1], first[2]
            first[0], first[1], first[2] = px, py, pz
        elif _higher(px, py, pz, as_int64(second[0]), as_int64(second[1]), as_int64(second[2])):
            second[0], second[1], second[2] = px, py, pz


class HighestReturns:
    """The lowest and the two highest returns of each pixel of a block, whatever the order in which points come.

    Parameters
    ----------
    window : CellWindow
        Pixels of the block.
    limits : float64 [rows * columns]
        Greatest height in counts of each pixel. Higher returns do not count.

    Attributes
    ----------
    top : int32 [rows * columns, 2, 3]
        x, y, z of the highest return, and of the next highest at another position or height; z is `NOTHING` without a
        return.
    lowest : int32 [rows, columns]
        Height of the lowest return, defined where there is a highest one.
    """

    def __init__(self, window: CellWindow, limits: Float64) -> None:
        self.window, self.limits = window, limits
        self.rows, self.columns = window.rows, window.columns
        self.top = np.full((self.rows * self.columns, 2, 3), NOTHING, np.int32)
        self.lowest = np.full((self.rows, self.columns), np.iinfo(np.int32).max, np.int32)

    def add(self, xyz: Int32, wanted: Bool) -> None:
        """Enter the wanted points that lie in the block.

        Parameters
        ----------
        xyz : int32 [3, n]
            Local counts.
        wanted : bool [n]
        """
        points = Xyz(*(np.ascontiguousarray(axis) for axis in xyz))
        lowest = self.lowest.reshape(-1)
        _update(self.top, lowest, points, wanted, self.limits, tuple(self.window))

    def supported(self, reach: int, spike: float) -> Int32:
        """The highest return of each pixel that is not a spike.

        A spike is a bird, a cloud or a blunder of matching. The highest return of a pixel is a spike if it is more than
        ``spike`` higher than the second return of its pixel and the highest returns of all pixels around. Then the
        second return replaces it. The second return is compared only with the pixels around; if it is a spike too, the
        pixel is empty. Two adjacent spikes support each other and stay. A pixel with no returns around it keeps its
        only return, or one of its two highest.

        Parameters
        ----------
        reach : int
            Number of pixels that are compared on each side, at least 1. Within this distance of the block's edge the
            result is right only if nothing lies beyond the edge.
        spike : float
            Counts.

        Returns
        -------
        int32 [rows, columns, 3]
            x, y, z; z is `NOTHING` for empty pixels.
        """
        first, second = self.top[:, 0], self.top[:, 1]
        heights = first[:, 2].reshape(self.rows, self.columns)
        around = np.ones((2 * reach + 1, 2 * reach + 1), np.bool_)
        around[reach, reach] = False
        beside = scipy.ndimage.maximum_filter(
            heights, footprint=around, mode="constant", cval=NOTHING
        ).ravel()
        limit = math.floor(spike)
        highest_other = np.maximum(beside, second[:, 2]).astype(np.int64)
        alone = highest_other == NOTHING
        good = alone | (first[:, 2] - highest_other <= limit)
        second_good = (beside == NOTHING) | (second[:, 2] - beside.astype(np.int64) <= limit)
        second_good &= second[:, 2] != NOTHING
        chosen = np.where(good[:, np.newaxis], first, second)
        chosen[~(good | second_good), 2] = NOTHING
        return chosen.reshape(self.rows, self.columns, 3)


@kernel
def _beside(
    ground: Xyz,
    cells: tuple[Int64, Int64],
    objects: Xyz,
    tops: Int32,
    table: CellTable,
    reach2: int,
    rise: int,
) -> Bool:
    """Return whether a point of an object lies near each ground point and is higher by at least ``rise``.

    ``cells`` are the columns and rows of the ground points. Objects are sorted by cell. ``tops`` has the greatest
    height in each cell.
    """
    x, y, z = ground
    columns, rows = cells
    ox, oy, oz = objects
    slots, keys, starts, _order, width, height = table
    out = np.zeros(x.size, np.bool_)
    for i in range(x.size):
        for cell in range(9):
            slot = find_slot(
                slots, keys, width, height, columns[i] + cell % 3 - 1, rows[i] + cell // 3 - 1
            )
            if slot < 0 or as_int64(tops[slot]) - z[i] < rise:
                continue
            for k in range(starts[slot], starts[slot + 1]):
                dx, dy = as_int64(ox[k]) - x[i], as_int64(oy[k]) - y[i]
                if as_int64(oz[k]) - z[i] >= rise and dx * dx + dy * dy <= reach2:
                    out[i] = True
                    break
            if out[i]:
                break
    return out


def near_objects(
    ground: Int32, objects: Int32, reach: Fraction, rise: int, origin: tuple[int, int]
) -> Bool:
    """Return a mask of the ground points with a point of an object within ``reach`` that is ``rise`` or more higher.

    Parameters
    ----------
    ground, objects : int32 [3, n], [3, m]
        Local counts.
    reach : Fraction
        Largest distance in plan, in horizontal counts.
    rise : int
        Least height difference in vertical counts.
    origin : tuple of int
        Absolute counts of the local 0.

    Returns
    -------
    bool [n]
    """
    if objects.shape[1] == 0 or ground.shape[1] == 0:
        return np.zeros(ground.shape[1], np.bool_)
    cells = CellLattice(max(math.ceil(reach), 1), 1, *origin)
    index = CellIndex(np.ascontiguousarray(objects[0]), np.ascontiguousarray(objects[1]), cells)
    above = Xyz(*(axis[index.table.order] for axis in objects))
    below = Xyz(*(np.ascontiguousarray(axis) for axis in ground))
    tops = np.maximum.reduceat(above.z, index.table.starts[:-1])
    cells_below = index.cell_indices(below.x, below.y)
    return _beside(
        below, cells_below, above, tops, index.table, math.floor(reach * reach), rise
    )
