"""Outliers: points far from everything around them in height (multipath, birds, matching blunders)."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64
from ptd.cells import CellIndex, CellTable, Xyz, find_slot, quotient
from ptd.frame import CellGrid, CellLattice, Scale
from ptd.kernel import as_int64, kernel

MIN_NEIGHBOURS = 3
"""Least number of points far away in height around an outlier: two are not enough evidence."""


class _Search(NamedTuple):
    """Parameters of a search in counts (`low_outliers`).

    Attributes
    ----------
    radius, depth : float
        Radius in horizontal counts, and height difference in vertical counts above which a point is far away.
    group : int
        Largest number of points near an outlier, itself included.
    both : bool
        Whether points far below count as far away, like points far above. Otherwise they count as near.
    """

    radius: float
    depth: float
    group: int
    both: bool


@kernel
def _outliers(
    points: Xyz, table: CellTable, cells: tuple[Int64, Int64], reach: int, search: _Search
) -> Bool:
    """Search cells ring by ring for the neighbours of each point, so that ordinary ground needs only a few points."""
    x, y, z = points
    point_columns, point_rows = cells
    radius, depth, group, both = search
    slots, keys, starts, order, width, height = table
    out = np.zeros(x.size, np.bool_)
    limit2 = radius * radius
    for i in range(x.size):
        near = 0
        far = 0
        for ring in range(reach + 1):
            for row in range(point_rows[i] - ring, point_rows[i] + ring + 1):
                edge_row = abs(row - point_rows[i]) == ring
                step = 1 if edge_row or ring == 0 else 2 * ring
                for column in range(point_columns[i] - ring, point_columns[i] + ring + 1, step):
                    slot = find_slot(slots, keys, width, height, column, row)
                    if slot < 0:
                        continue
                    for k in range(starts[slot], starts[slot + 1]):
                        j = order[k]
                        dx, dy = float(x[j] - x[i]), float(y[j] - y[i])
                        if dx * dx + dy * dy > limit2:
                            continue
                        rise = z[j] - z[i]
                        if rise > depth or (both and rise < -depth):
                            far += 1
                        else:
                            near += 1
                if near > group:
                    break
            if near > group:
                break
        out[i] = near <= group and far >= MIN_NEIGHBOURS
    return out


def low_outliers(
    x: Int32, y: Int32, z: Int32, scale: Scale, radius_m: float, depth_m: float, group: int
) -> Bool:
    """Find points that, with at most ``group - 1`` others, lie alone at the bottom of a hole.

    A point is a low outlier if at most ``group`` points within ``radius_m``, itself included, are not more than
    ``depth_m`` above it, and at least three are higher than that. This is TerraScan's idea of "low points" for groups.
    It reads only the neighbourhood of each point, so neither order nor tiles matter, and points at least ``radius_m``
    inside a window are certified.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, best in row-major order of cells.
    scale : Scale
    radius_m, depth_m : float
        Radius and height difference in metres.
    group : int
        Largest number of points in a group; 0 finds no outliers.

    Returns
    -------
    bool [n]
    """
    if x.size == 0 or group == 0:
        return np.zeros(x.size, np.bool_)
    return _search(x, y, z, scale, radius_m, depth_m, group, both=False)


def isolated_in_height(
    x: Int32, y: Int32, z: Int32, scale: Scale, radius_m: float, depth_m: float
) -> Bool:
    """Find points whose smallest height difference to their neighbours is too large (Chen 2023, 2.1 b).

    A point is isolated if at least three other points lie within ``radius_m``, and none of those there is within
    ``depth_m`` of its height.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, best in row-major order of cells.
    scale : Scale
    radius_m, depth_m : float
        Radius and height difference in metres.

    Returns
    -------
    bool [n]
    """
    if x.size == 0:
        return np.zeros(0, np.bool_)
    return _search(x, y, z, scale, radius_m, depth_m, 1, both=True)


def _search(
    x: Int32,
    y: Int32,
    z: Int32,
    scale: Scale,
    radius_m: float,
    depth_m: float,
    group: int,
    both: bool,
) -> Bool:
    index = CellIndex(x, y, CellLattice.of(1.0, scale))
    search = _Search(scale.counts(radius_m), scale.counts_z(depth_m), group, both)
    return _outliers(
        Xyz(x, y, z), index.table, index.cell_indices(x, y), int(np.ceil(radius_m)) + 1, search
    )


def search_margin(radius_m: float, group: int, cell_m: float) -> int:
    """Return the radius of the search in cells of the lattice of lowest points, rounded up, or 0 without a search."""
    return (
        math.ceil(Fraction(repr(float(radius_m))) / Fraction(repr(float(cell_m))))
        if group
        else 0
    )


@kernel
def _at_most(
    points: Xyz, among: Bool, grid: CellGrid, table: CellTable, heights: Int32
) -> Bool:
    """Return a mask of the points of ``among`` that are at most as high as the height of their cell."""
    x, y, z = points
    p, q, ox, oy, col0, row0 = grid
    slots, keys, _starts, _order, width, height = table
    out, inverse, highest = np.zeros(z.size, np.bool_), 1.0 / p, heights.max()
    for i in range(z.size):
        # Most points are higher than all outliers.
        if not among[i] or z[i] > highest:
            continue
        column = quotient((as_int64(x[i]) + ox) * q, p, inverse) - col0
        row = quotient((as_int64(y[i]) + oy) * q, p, inverse) - row0
        slot = find_slot(slots, keys, width, height, column, row)
        out[i] = slot >= 0 and z[i] <= heights[slot]
    return out


class LowNoise:
    """Cells with low outliers: all points of a cell up to its highest outlier are low noise.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts of the outliers.
    cells : CellLattice
        Lattice whose lowest points were searched for outliers.
    """

    def __init__(self, x: Int32, y: Int32, z: Int32, cells: CellLattice) -> None:
        self._index = CellIndex(x, y, cells) if x.size else None
        if self._index is not None:
            self._heights = np.maximum.reduceat(
                z[self._index.table.order], self._index.table.starts[:-1]
            )

    def holds(self, x: Int32, y: Int32, z: Int32, among: Bool | None = None) -> Bool:
        """Return a mask of the low-noise points, restricted to the points in ``among`` if it is given: bool [n]."""
        if self._index is None:
            return np.zeros(z.size, np.bool_)
        index, among = self._index, np.ones(z.size, np.bool_) if among is None else among
        grid = index.cells.grid(index.col0, index.row0)
        return _at_most(Xyz(x, y, z), among, grid, index.table, self._heights)
