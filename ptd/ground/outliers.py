"""Outliers: points far from everything around them in height (multipath, birds, matching blunders)."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import CellIndex, CellTable, Int32, Int64, Xyz, find_slot
from ptd.frame import CellLattice, Scale
from ptd.kernel import kernel

MIN_NEIGHBOURS = 3
"""Points far away in height that it takes to call a point an outlier: two prove nothing."""


class _Search(NamedTuple):
    """What is looked for, in counts; see `low_outliers`.

    Attributes
    ----------
    radius, depth : float
    group : int
    both : bool
        What lies far below a point is as far from it as what lies far above; else it counts as near.
    """

    radius: float
    depth: float
    group: int
    both: bool


@kernel
def _outliers(
    points: Xyz, table: CellTable, places: tuple[Int64, Int64], reach: int, search: _Search
) -> npt.NDArray[np.bool_]:
    """Kernel of the two searches: cells are searched ring by ring, so ordinary ground is done after a few points."""
    x, y, z = points
    point_columns, point_rows = places
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
) -> npt.NDArray[np.bool_]:
    """Points that, with at most ``group - 1`` others, lie alone at the bottom of a hole.

    A point is a low outlier if at most ``group`` points within ``radius_m`` (itself included) are less than ``depth_m``
    above it or below it, and at least three are higher than that. This is TerraScan's "low points" idea for
    groups; it looks at each point's own neighbourhood alone, so neither order nor tile matter, and what lies
    ``radius_m`` inside a window is certain.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, best in row-major order of cells.
    scale : Scale
    radius_m, depth_m : float
        Metres.
    group : int
        Points; 0 finds nothing.

    Returns
    -------
    bool [n]
    """
    if x.size == 0 or group == 0:
        return np.zeros(x.size, np.bool_)
    return _search(x, y, z, scale, radius_m, depth_m, group, both=False)


def isolated_in_height(
    x: Int32, y: Int32, z: Int32, scale: Scale, radius_m: float, depth_m: float
) -> npt.NDArray[np.bool_]:
    """Points whose smallest height difference to their neighbours is too large (Chen 2023, 2.1 b).

    A point is isolated if within ``radius_m`` no other point is within ``depth_m`` of its height and at least three are
    not.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, best in row-major order of cells.
    scale : Scale
    radius_m, depth_m : float
        Metres.

    Returns
    -------
    bool [n]
    """
    if x.size == 0:
        return np.zeros(0, np.bool_)
    return _search(x, y, z, scale, radius_m, depth_m, 1, both=True)


def _search(
    x: Int32, y: Int32, z: Int32, scale: Scale, radius_m: float, depth_m: float, group: int, both: bool
) -> npt.NDArray[np.bool_]:
    index = CellIndex(x, y, CellLattice.of(1.0, scale))
    search = _Search(scale.counts(radius_m), scale.counts_z(depth_m), group, both)
    return _outliers(Xyz(x, y, z), index.table, index.places(x, y), int(np.ceil(radius_m)) + 1, search)


def search_margin(radius_m: float, group: int, cell_m: float) -> int:
    """Cells of the lattice whose lowest points are looked at that hold the radius of the search; 0 without one."""
    return math.ceil(Fraction(repr(float(radius_m))) / Fraction(repr(float(cell_m)))) if group else 0


class LowNoise:
    """Where low outliers were found: points of the same cell that are not higher are low noise as well.

    Parameters
    ----------
    x, y, z : int32 [n]
        The outliers, local counts.
    cells : CellLattice
        Of which the lowest points were looked at.
    """

    def __init__(self, x: Int32, y: Int32, z: Int32, cells: CellLattice) -> None:
        self._index = CellIndex(x, y, cells) if x.size else None
        if self._index is not None:
            self._heights = np.maximum.reduceat(z[self._index.table.order], self._index.table.starts[:-1])

    def holds(
        self, x: Int32, y: Int32, z: Int32, among: npt.NDArray[np.bool_] | None = None
    ) -> npt.NDArray[np.bool_]:
        """Whether points are low noise, and among those of a mask if there is one: bool [n]."""
        if self._index is None:
            return np.zeros(z.size, np.bool_)
        found: npt.NDArray[np.bool_] = z <= self._heights.max()  # most lie above all of them
        if among is not None:
            found &= among
        low = np.flatnonzero(found)
        cell = self._index.find(x[low], y[low])
        found[low] = (cell >= 0) & (z[low] <= self._heights[cell])
        return found
