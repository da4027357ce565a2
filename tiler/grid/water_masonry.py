"""Masonry at the shore, such as lock walls and piers, that was not classified as ground.

Narrow or high walls are objects for a filter, so the terrain passes through them at the level of the water. But their
tops are smooth and level over several fine cells, unlike crowns and reed. Such cells are land if they continue a top of
the same height on land, as boats do not, and if the top ends near the land, as decks do not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tiler.grid.coarse import Bools
from tiler.grid.reach import Floats

SMOOTH_M = 0.3
"""The heights of the objects in a cell of masonry differ by less than this, in metres."""
STEP_M = 0.15
"""Neighbouring cells of a top differ by less than this in height, in metres."""
MIN_NEIGHBOURS = 3
"""At least this many of the eight neighbours of a cell of masonry belong to the same top."""
INNER_NEIGHBOURS = 6
"""A cell with at least this many such neighbours is not at the edge of the top."""
EDGE_SHARE = 0.75
"""A cell at the edge of a top is land only if it has at least this share of the points of its neighbours.

It is more than half covered then, although its number of points is partly chance.
"""
MASONRY_REACH = 5
"""Masonry extends over the water by at most this many cells. A deck over a river is more than twice as long."""
BACK_REACH = 2 * MASONRY_REACH
"""A top that extends farther is not masonry up to this distance back, in cells, as a shore may be aslant to a deck."""
MASONRY_MARGIN = BACK_REACH + MASONRY_REACH + 2
"""Whether a cell is masonry depends on cells up to this distance."""


class ObjectCells(NamedTuple):
    """Objects in the cells of a window.

    Attributes
    ----------
    number : float64
        Number of points of objects in each cell.
    lowest, mean, highest : float64
        Heights of these points in metres, infinite or NaN if there are none.
    """

    number: Floats
    lowest: Floats
    mean: Floats
    highest: Floats


def smooth_tops(objects: ObjectCells, n_ground: Floats, level: Floats, min_height_m: float) -> Bools:
    """Return a mask of the cells that smooth objects cover.

    Parameters
    ----------
    objects : ObjectCells
    n_ground : float64, shape of the cells
        Number of ground points in each cell. They are fewer than the points of objects on masonry.
    level : float64, shape of the cells
        Level of the water in metres.
    min_height_m : float
        Least height of masonry above the level, in metres.
    """
    # The height of a single point never differs.
    is_smooth = (objects.number > np.maximum(n_ground, 1)) & (objects.lowest - level > min_height_m)
    is_smooth[is_smooth] = (objects.highest[is_smooth] - objects.lowest[is_smooth]) < SMOOTH_M
    return is_smooth


def masonry(land: Bools, tops: Bools, heights: Floats, n_points: Floats) -> Bools:
    """Return a mask of the cells of water that are masonry connected with land.

    Parameters
    ----------
    land : bool (h, w)
        Mask of the land, which has masonry as well.
    tops : bool (h, w)
        Result of `smooth_tops`. The outermost cells of the window are never masonry.
    heights : float64 (h, w)
        Heights of the objects in ``tops``, of the ground in other cells, NaN if there are none.
    n_points : float64 (h, w)
        Number of points in each cell.
    """
    is_candidate = tops & ~land
    is_candidate[[0, -1]] = is_candidate[:, [0, -1]] = False
    cells = np.flatnonzero(is_candidate)
    width = land.shape[1]
    steps = np.array([-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1])
    neighbours, flat, number = cells[:, None] + steps, heights.ravel(), n_points.ravel()
    same_top = np.abs(flat[neighbours] - flat[cells, None]) < STEP_M
    n_neighbours = same_top.sum(axis=1)
    is_covered = number[cells] * n_neighbours >= EDGE_SHARE * (same_top * number[neighbours]).sum(axis=1)
    is_covered |= n_neighbours >= INNER_NEIGHBOURS
    same_top &= (is_covered & (n_neighbours >= MIN_NEIGHBOURS))[:, None]

    def spread(start: Bools, n_steps: int) -> Bools:
        """Return a mask of the set cells, and of the cells that lie on the same top within some steps."""
        reached = start.copy()
        for _ in range(n_steps):
            reached[cells] |= (same_top & reached[neighbours]).any(axis=1)
        return reached

    near = spread(land.ravel(), MASONRY_REACH)
    beyond = spread(near, 1) & ~near
    is_masonry = near & ~spread(beyond, BACK_REACH) & is_candidate.ravel()
    return is_masonry.reshape(land.shape)
