"""Seeds of a town in image matching: facades from the density of projected points, roads beside them, no podiums.

Source: Dong 2017 (004), section 3.1 and equations 1 and 3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64
from ptd.cells import CellIndex, CellTable, Xyz, slot_of
from ptd.frame import CellLattice, Scale
from ptd.ground.slopes import MOMENTS, add_point, fit_plane
from ptd.kernel import kernel

BLOCK = 1
"""Number of cells to each side of a seed's cell in which its surroundings have to be flat."""

MIN_BLOCK_POINTS = 6
"""Fewest points around a seed from which its flatness can be judged."""

CHANCE = 5.0
"""Standard deviations (Poisson) by which a facade's cell holds more points than flat ground."""


class FacadeRule(NamedTuple):
    """Limits that define facades and the roads beside them.

    Attributes
    ----------
    straight, diagonal : int
        Cells from a facade to a road, along the axes of the lattice and along its diagonals.
    min_drop : float
        Least height of the other side above the road, vertical counts.
    variation : float
        Largest noise around a seed's plane, horizontal counts.
    z_ratio : float
        Horizontal counts in one vertical count.
    """

    straight: int
    diagonal: int
    min_drop: float
    variation: float
    z_ratio: float


def density_of(points_by_count: Mapping[int, int], cell_area_m2: float) -> float:
    """Points per square metre of flat ground: the median over occupied cells.

    Parameters
    ----------
    points_by_count : mapping
        Number of points in a cell -> number of points in all such cells. Points are counted by their own tiles, so
        cells that the border of a tile cuts need no owner.
    cell_area_m2 : float
    """
    cells = {count: points // count for count, points in sorted(points_by_count.items())}
    half, seen = (sum(cells.values()) + 1) // 2, 0
    for count, n in cells.items():
        seen += n
        if seen >= half:
            return count / cell_area_m2
    return 0.0


def facade_threshold(
    density_m2: float, height_m: float, cell_m: float, glass_factor: float
) -> float:
    """Points of a cell that a facade crosses, ``(DEN h g + DEN g^2) c`` (004, equation 3).

    The equation is printed without DEN in its second term. Both terms are areas (of the facade,
    of the ground) times points per area. The factor c accounts for glass, which is not matched
    (section 3.3.2). Ours: the threshold is at least the mean of a cell of flat ground plus
    `CHANCE` standard deviations. Otherwise all cells of a sparse cloud would be facades.
    """
    flat = density_m2 * cell_m * cell_m
    facade = glass_factor * (density_m2 * height_m * cell_m + flat)
    return max(facade, flat + CHANCE * math.sqrt(flat))


@kernel
def _median_point(x: Int32, y: Int32, z: Int32, order: Int64, first: int, last: int) -> int:
    """Return the point of the (lower) median height of a cell, with points of equal height ordered by (x, y)."""
    heights = np.empty(last - first, np.int32)
    for k in range(first, last):
        heights[k - first] = z[order[k]]
    heights.sort()
    middle = heights[(heights.size - 1) // 2]
    best = -1
    for k in range(first, last):
        i = order[k]
        if z[i] == middle and (
            best < 0 or x[i] < x[best] or (x[i] == x[best] and y[i] < y[best])
        ):
            best = i
    return int(best)


@kernel
def _clearance2(table: CellTable, facade: Bool, column: int, row: int, reach: int) -> int:
    """Squared distance in cells to the nearest facade cell within `reach`, or (reach + 1)^2 without one."""
    nearest = (reach + 1) * (reach + 1)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            slot = slot_of(table, column + dx, row + dy)
            if slot >= 0 and facade[slot]:
                nearest = min(nearest, dx * dx + dy * dy)
    return nearest


@kernel
def _road_points(
    x: Int32, y: Int32, z: Int32, table: CellTable, facade: Bool, rule: FacadeRule
) -> Int32:
    """The median point of the road cell of each facade cell, -1 where there is none: int32 [cells]."""
    keys, starts, width = table.keys, table.starts, table.width
    median = np.full(keys.size, -2, np.int32)
    chosen = np.full(keys.size, -1, np.int32)
    steps = np.array([[1, 0], [0, 1], [1, 1], [1, -1]])
    ends = np.empty(2, np.int64)
    for s in range(keys.size):
        if not facade[s]:
            continue
        row, column = keys[s] // width, keys[s] % width
        farthest = -1
        for d in range(4):
            size = rule.diagonal
            if d < 2:
                size = rule.straight
            dx, dy = size * steps[d, 0], size * steps[d, 1]
            for side in range(2):
                sign = 1 - 2 * side
                ends[side] = slot_of(table, column + sign * dx, row + sign * dy)
                if ends[side] >= 0 and median[ends[side]] == -2:
                    e = ends[side]
                    median[e] = _median_point(x, y, z, table.order, starts[e], starts[e + 1])
            if ends[0] < 0 or ends[1] < 0:
                continue
            z0, z1 = z[median[ends[0]]], z[median[ends[1]]]
            lower = int(z0 >= z1)
            road = ends[lower]
            if abs(float(z0) - float(z1)) < rule.min_drop or facade[road]:
                continue
            sign = 1 - 2 * lower
            clear = _clearance2(
                table, facade, column + sign * dx, row + sign * dy, rule.straight
            )
            here = median[road]
            if clear > farthest or (clear == farthest and z[here] < z[chosen[s]]):
                farthest = clear
                chosen[s] = here
    return chosen


@kernel
def _variation(
    x: Int32,
    y: Int32,
    z: Int32,
    table: CellTable,
    column: int,
    row: int,
    origin: int,
    z_ratio: float,
) -> float:
    """Return the root mean square of the residuals of a plane through a block of cells, or inf without a plane.

    Sums are of integers, relative to a point of the block, so the order of the points changes
    no bit.
    """
    s = np.zeros(MOMENTS, np.int64)
    for r in range(row - BLOCK, row + BLOCK + 1):
        for c in range(column - BLOCK, column + BLOCK + 1):
            slot = slot_of(table, c, r)
            if slot < 0:
                continue
            for k in range(table.starts[slot], table.starts[slot + 1]):
                i = table.order[k]
                dx, dy = np.int64(x[i]) - x[origin], np.int64(y[i]) - y[origin]
                add_point(s, dx, dy, np.int64(z[i]) - z[origin])
    if s[0] < MIN_BLOCK_POINTS:
        return math.inf
    a, b, _, squares = fit_plane(s, z_ratio)
    if squares < 0.0:
        return math.inf
    return math.sqrt(squares / (s[0] - 3) / (1.0 + a * a + b * b))


@kernel
def _flat(
    points: Xyz, table: CellTable, seeds: Int32, cells: tuple[Int64, Int64], rule: FacadeRule
) -> Bool:
    x, y, z = points
    columns, rows = cells
    out = np.zeros(seeds.size, np.bool_)
    for k in range(seeds.size):
        out[k] = (
            _variation(x, y, z, table, columns[k], rows[k], seeds[k], rule.z_ratio)
            < rule.variation
        )
    return out


class Facades:
    """The cells of a window that hold a facade.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts of all points except vegetation; at least one.
    cells : CellLattice
    min_points : float
        Threshold of `facade_threshold`.
    """

    def __init__(
        self, x: Int32, y: Int32, z: Int32, cells: CellLattice, min_points: float
    ) -> None:
        self.x, self.y, self.z = x, y, z
        self.index = CellIndex(x, y, cells)
        self.holds = np.diff(self.index.table.starts) > min_points

    def points(self) -> Int64:
        """Indices of the points in facade cells."""
        i = self.index.table
        parts = [i.order[i.starts[s] : i.starts[s + 1]] for s in np.flatnonzero(self.holds)]
        return np.concatenate([np.zeros(0, np.int64), *parts])

    def seeds(self, rule: FacadeRule) -> Int32:
        """Find the points on roads next to facades (004, 3.1, step 3): int32 [m], indices by cell of facade.

        Four lines cross a facade cell, along the axes and diagonals of the lattice, with a cell
        at the same distance on both sides. The lower of these two cells is the road. The line
        whose road is farthest from all facade cells counts, because it is most nearly
        perpendicular to the facade. Of equally far roads the lower one counts. The seed is the
        point of median height in its cell, as the lowest point is a blunder or at the lower end
        of the noise. It is dropped unless the points around it lie on a plane within the noise.
        """
        x, y, z, table = self.x, self.y, self.z, self.index.table
        road_points = _road_points(x, y, z, table, self.holds, rule)
        road_points = road_points[road_points >= 0]
        road_points = road_points[np.sort(np.unique(road_points, return_index=True)[1])]
        kept: Int32 = road_points[
            _flat(
                Xyz(x, y, z),
                table,
                road_points,
                self.index.cell_indices(x[road_points], y[road_points]),
                rule,
            )
        ]
        return kept


NOISE_QUANTILE = 1.65
"""One-sided 95 % quantile in equation 1 for a difference of two heights, which varies by
sqrt(2) sigma."""


@kernel
def _too_high(
    points: Xyz,
    table: CellTable,
    cells: tuple[Int64, Int64],
    radius: float,
    slope: float,
    noise: float,
    z_ratio: float,
) -> Bool:
    x, y, z = points
    columns, rows = cells
    out = np.zeros(x.size, np.bool_)
    for i in range(x.size):
        for row in range(rows[i] - 1, rows[i] + 2):
            for column in range(columns[i] - 1, columns[i] + 2):
                slot = slot_of(table, column, row)
                if slot < 0:
                    continue
                for k in range(table.starts[slot], table.starts[slot + 1]):
                    j = table.order[k]
                    dx, dy = float(x[j] - x[i]), float(y[j] - y[i])
                    apart = math.sqrt(dx * dx + dy * dy)
                    above = (float(z[i]) - float(z[j])) * z_ratio
                    if apart <= radius and above > slope * apart + noise:
                        out[i] = True
    return out


def on_podium(
    x: Int32, y: Int32, z: Int32, scale: Scale, radius_m: float, slope: float, sigma_m: float
) -> Bool:
    """Seeds that lie on a podium or a lower roof: too high above another seed nearby (004, 3.1, step 4).

    The paper keeps the lower of any two seeds in a neighbourhood, which would leave only the lowest seed on a hillside.
    Here the upper seed also has to be higher than ground can be at its distance d by the paper's equation 1,
    ``0.3 d + 1.65 sqrt(2) sigma``. All seeds are judged against all and dropped together, so order does not matter.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts of seeds.
    radius_m : float
        Radius of the neighbourhood, metres.
    slope : float
        Largest slope of ground, metres per metre.
    sigma_m : float

    Returns
    -------
    bool [n]
    """
    if x.size == 0:
        return np.zeros(0, np.bool_)
    index = CellIndex(x, y, CellLattice.of(radius_m, scale))
    noise = NOISE_QUANTILE * math.sqrt(2.0) * scale.counts(sigma_m)
    cells, radius = index.cell_indices(x, y), scale.counts(radius_m)
    return _too_high(Xyz(x, y, z), index.table, cells, radius, slope, noise, scale.z_ratio)
