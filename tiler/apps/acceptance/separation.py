"""Separation of swaths: differences of their heights in cells of even surfaces, which are ground and flat roofs.

A cell of a swath is even if a plane through the mean heights of its 3 x 3 neighbours fits, is not steep, and explains
the heights of the cell. Plants, edges of roofs and parked cars are not even. The difference of two swaths is that of
their heights at the centre of the cell, so that it does not depend on where in the cell their points lie.

Repeatability is the precision within a swath: the spread of heights in such cells around the plane of the cell. Each
cell has its own plane, so a slope does not count. The figure of a swath is robust: that of its median cell, so that low
plants and gravel in some cells do not decide it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ptd.arrays import Bool, Float64, Indices, Int64, UInt8
from tiler.apps.acceptance.counts import (
    OFFSET_STEPS,
    SIDE_BITS,
    STEPS_PER_METRE,
    Cells,
    Keys,
    decoded,
)
from tiler.apps.difference_statistics import Spread, spread
from tiler.apps.results import SwathPair
from tiler.core.words import listed

MIN_POINTS = 3
"""Least number of points of a swath in a cell."""
MIN_NEIGHBOURS = 6
"""Least number of cells, of 3 x 3, that define the plane."""
MAX_SLOPE_DEGREES = 10
"""Steepest ground that is compared (USGS Lidar Base Specification, interswath accuracy)."""
MAX_ROUGH_M = 0.1
"""Largest standard deviation of the heights of a cell from the plane, and of the 3 x 3 cells. Plants have more, and the
noise of a scanner less."""
MIN_PAIR_CELLS = 30
"""Number of cells from which a pair of swaths is judged by itself. Smaller pairs are judged together."""
MIN_DIFFERENT_M, DIFFERENT_NMADS = 0.5, 5
"""A cell has different surfaces if its difference is further from the median of the pair than both: this length, and
this number of normalised median absolute deviations (NMAD)."""
MAX_DIFFERENT_SHARE = 0.02
"""Largest share of a pair's cells that is left out for different surfaces. If more are that far, they are an error."""
FAULTS = (
    f"steeper than {MAX_SLOPE_DEGREES} degrees",
    "rough",
    f"with fewer than {MIN_NEIGHBOURS} of 3 x 3 neighbours",
    f"with fewer than {MIN_POINTS} points",
)
"""Reasons why a cell is not compared, from 1 on. If those of two swaths differ, the later one counts."""
NO_OVERLAP = "no overlap of swaths, so nothing to compare"

BYTES_PER_HEIGHT_CELL = 280
"""Memory that `separate_swaths` and `find_surfaces` need per cell of a swath, if most are shared by two swaths."""
BYTES_PER_COMPARISON = 100
"""Memory per pair of cells of one swath and all later ones."""
MAX_NAMES = 5
"""Number of pairs that a remark or note names."""
MIN_CELL_POINTS = 8
"""Least number of points of a swath in a cell. A plane takes three degrees of freedom."""
MAX_LIMIT_M = 0.08
"""Largest limit in metres: cells with a larger spread are not even, so the figures of rougher swaths do not grow."""
MIN_CELLS = 30
"""Least number of cells of a swath, and of an area where it is worst."""
AREA_CELLS = 16
"""Side in cells of the areas of which the worst is named."""
_MAX_CORRELATION = 0.99
"""Largest squared correlation of x and y. Points on one scan line define no plane."""
_BLOCK_CELLS = 1 << 16
"""Number of cells whose planes are fitted together."""
_CELL_MASK = np.uint64((1 << 2 * SIDE_BITS) - 1)
_PLANE_PARAMETERS = 3

Faults = UInt8


@dataclass(frozen=True)
class Separation:
    """Differences of swaths.

    Attributes
    ----------
    side, side_m : float
        Side of the cells in units of the CRS, and in metres.
    pairs : list of SwathPair
        All pairs that share cells: the largest mean difference first, those without a compared cell last.
    judged : list of str and Spread
        Name and statistics in metres of each pair with at least `MIN_PAIR_CELLS`, and of all smaller ones together.
    faults : list of int
        Number of shared cells of pairs that were not compared, by `FAULTS`.
    first, second : int64, shape (n,)
        Point source ids of the swaths with the largest absolute difference in each compared cell.
    x, y : float64, shape (n,)
        Centres of the cells in units of the CRS.
    difference_m : float64, shape (n,)
        Height of the second swath minus that of the first.
    """

    side: float
    side_m: float
    pairs: list[SwathPair]
    judged: list[tuple[str, Spread]]
    faults: list[int]
    first: Int64
    second: Int64
    x: Float64
    y: Float64
    difference_m: Float64

    @property
    def uncompared(self) -> list[str]:
        """Names of the pairs that share cells, but none that can be compared."""
        return [pair_name(pair) for pair in self.pairs if not pair["cells"]]


def separate_swaths(
    keys: Keys,
    sums: Int64,
    cells: Cells,
    metres: float,
    memory: float,
    surfaces: tuple[Float64, Faults] | None = None,
) -> Separation | str:
    """Compare the heights of all swaths that share cells, or return why they cannot be compared.

    Parameters
    ----------
    keys : uint64, shape (n,)
        Keys of ``cells.of_heights``, sorted.
    sums : int64, shape (n, `N_SUMS`)
        Their `Cells.height_sums`.
    cells : Cells
        Cells of the first returns.
    metres : float
        Metres per unit of the CRS.
    memory : float
        Bytes that may be used.
    surfaces : (float64, uint8), shape (n,) each, optional
        `find_surfaces` of these cells.
    """
    if reason := too_large(keys.size, memory):
        return reason
    shared = _shared(keys)
    if not shared.size:
        return NO_OVERLAP
    source, column, row = decoded(keys[shared])
    is_new = np.r_[True, (column[1:] != column[:-1]) | (row[1:] != row[:-1])]
    cell = np.cumsum(is_new) - 1
    ends = np.append(np.flatnonzero(is_new)[1:], cell.size)
    n_later = ends[cell] - np.arange(cell.size) - 1
    needed = keys.size * BYTES_PER_HEIGHT_CELL
    needed += int(np.bincount(source, n_later).max()) * BYTES_PER_COMPARISON
    if needed > memory:
        return _too_large(needed)
    lattice = cells.of_heights
    height_m, fault = surfaces or find_surfaces(keys, sums, lattice.side * metres)
    comparison = _Comparison(
        source,
        np.asarray((column + lattice.column + 0.5) * lattice.side, np.float64),
        np.asarray((row + lattice.row + 0.5) * lattice.side, np.float64),
        cell,
        height_m[shared],
        fault[shared],
    )
    for first, second in _pairs(source, n_later):
        comparison.add(first, second)
    return comparison.result(lattice.side, metres)


def too_large(n_cells: int, memory: float) -> str:
    """Return why cells of swaths cannot be examined, or an empty text if they can."""
    needed = n_cells * BYTES_PER_HEIGHT_CELL
    return _too_large(needed) if needed > memory else ""


def _too_large(needed: float) -> str:
    return (
        f"too many cells of swaths for the memory of a process ({needed / 1e9:,.1f} GB are needed); give more with "
        "--memory, or parts of the survey"
    )


def share_cells(keys: Keys) -> bool:
    """Return whether a cell has several swaths."""
    return bool(_shared(keys).size)


def _shared(keys: Keys) -> Indices:
    """Return the positions of the keys whose cell has several swaths, ordered by cell and swath."""
    cell = keys & _CELL_MASK
    order = np.argsort(cell, kind="stable")
    cell = cell[order]
    same = np.r_[False, cell[1:] == cell[:-1], False]
    shared: Indices = order[(same[1:] | same[:-1])[: cell.size]]
    return shared


def _pairs(source: Int64, n_later: Int64) -> Iterator[tuple[Indices, Indices]]:
    """Yield the positions of the first and the second swath of each pair in the cells that they share.

    ``n_later`` is the number of later swaths in the same cell, which follow. Only the pairs of one first swath are in
    memory at a time.
    """
    order = np.argsort(source, kind="stable")
    starts = np.flatnonzero(np.diff(source[order])) + 1
    for of_swath in np.split(order, starts):
        n = n_later[of_swath]
        first = np.repeat(of_swath, n)
        second = first + 1 + np.arange(first.size) - np.repeat(np.cumsum(n) - n, n)
        by_second = np.argsort(source[second], kind="stable")
        first, second = first[by_second], second[by_second]
        ends = np.flatnonzero(np.diff(source[second])) + 1
        if first.size:
            yield from zip(np.split(first, ends), np.split(second, ends), strict=True)


class _Comparison:
    """Statistics of the pairs of swaths that were compared so far. Arrays are those of the shared cells of swaths."""

    def __init__(
        self,
        source: Int64,
        x: Float64,
        y: Float64,
        cell: Indices,
        height_m: Float64,
        fault: Faults,
    ) -> None:
        self._source, self._x, self._y, self._cell = source, x, y, cell
        self._height_m, self._fault = height_m, fault
        self._faults = np.zeros(1 + len(FAULTS), np.int64)
        self._pairs: list[SwathPair] = []
        self._judged: list[tuple[str, Spread]] = []
        self._small: list[tuple[str, Float64]] = []
        n_cells = int(cell[-1]) + 1
        self._largest_m = np.full(n_cells, np.nan)
        self._of_largest = np.zeros((2, n_cells), np.intp)

    def add(self, first: Indices, second: Indices) -> None:
        """Add the cells that two swaths share."""
        fault = np.maximum(self._fault[first], self._fault[second])
        self._faults += np.bincount(fault, minlength=self._faults.size)
        x, y = float(self._x[first].mean()), float(self._y[first].mean())
        a, b = int(self._source[first[0]]), int(self._source[second[0]])
        n_shared = first.size
        first, second = first[fault == 0], second[fault == 0]
        difference = self._height_m[second] - self._height_m[first]
        figures, n_different = _figures(difference)
        pair: SwathPair = {
            "first": a,
            "second": b,
            "shared_cells": n_shared,
            "cells": difference.size,
            "different_surfaces": n_different,
            "mean_m": figures["bias"],
            "rms_m": figures["rmse"],
            "p95_m": figures["p95_abs"],
            "x": x,
            "y": y,
        }
        self._pairs.append(pair)
        if is_judged(pair):
            self._judged.append((f"point source {pair_name(pair)}", figures))
        elif difference.size:
            self._small.append((pair_name(pair), difference))
        cell = self._cell[first]
        is_larger = ~(np.abs(difference) <= np.abs(self._largest_m[cell]))
        cell = cell[is_larger]
        self._largest_m[cell] = difference[is_larger]
        self._of_largest[:, cell] = first[is_larger], second[is_larger]

    def result(self, side: float, metres: float) -> Separation:
        """Return the differences of all pairs, in cells with a side in units of the CRS."""
        judged = self._judged
        if self._small:
            names = listed([name for name, _ in self._small], MAX_NAMES)
            name = f"all pairs with fewer than {MIN_PAIR_CELLS} cells ({names})"
            of_small = spread(np.concatenate([difference for _, difference in self._small]))
            judged = [*judged, (name, of_small)]
        known = ~np.isnan(self._largest_m)
        first, second = self._of_largest[:, known]
        return Separation(
            side,
            side * metres,
            sorted(self._pairs, key=_order_of_pair),
            judged,
            self._faults[1:].tolist(),
            self._source[first],
            self._source[second],
            self._x[first],
            self._y[first],
            self._largest_m[known],
        )


def pair_name(pair: SwathPair) -> str:
    """Return the point source ids of a pair in the order of the subtraction."""
    return f"{pair['second']} - {pair['first']}"


def is_judged(pair: SwathPair) -> bool:
    """Return whether a pair has enough cells to be judged by itself."""
    return pair["cells"] - pair["different_surfaces"] >= MIN_PAIR_CELLS


def _order_of_pair(pair: SwathPair) -> tuple[float, int, int, int]:
    size_m = -1.0 if pair["mean_m"] is None else abs(pair["mean_m"])
    return -size_m, -pair["shared_cells"], pair["first"], pair["second"]


def _figures(difference: Float64) -> tuple[Spread, int]:
    """Return the statistics of a pair without the few cells with different surfaces, and the number of these cells."""
    figures = spread(difference)
    if figures["median"] is None or figures["nmad"] is None:
        return figures, 0
    limit_m = max(MIN_DIFFERENT_M, DIFFERENT_NMADS * figures["nmad"])
    is_far = np.abs(difference - figures["median"]) > limit_m
    if not 0 < is_far.mean() <= MAX_DIFFERENT_SHARE:
        return figures, 0
    return spread(difference[~is_far]), int(is_far.sum())


def find_surfaces(keys: Keys, sums: Int64, side_m: float) -> tuple[Float64, Faults]:
    """Return the heights in metres at the centres of cells, and why they are not even (`FAULTS`), 0 if they are.

    Parameters
    ----------
    keys : uint64, shape (n,)
        Keys of the cells of heights, sorted.
    sums : int64, shape (n, `N_SUMS`)
        Their `Cells.height_sums`.
    side_m : float
        Side of the cells in metres.
    """
    n = sums[:, 0].astype(np.float64)
    means = tuple(
        sums[:, axis] / n / steps - shift
        for axis, steps, shift in (
            (3, OFFSET_STEPS, 0.5),
            (4, OFFSET_STEPS, 0.5),
            (1, STEPS_PER_METRE, 0),
        )
    )
    has_points = sums[:, 0] >= MIN_POINTS
    height_m, fault = np.empty(keys.size), np.empty(keys.size, np.uint8)
    steepest = (math.tan(math.radians(MAX_SLOPE_DEGREES)) * side_m) ** 2
    for start in range(0, keys.size, _BLOCK_CELLS):
        block = slice(start, min(start + _BLOCK_CELLS, keys.size))
        slope_x, slope_y, deviation = _planes(keys, block, means, has_points)
        squared_slope = slope_x**2 + slope_y**2
        # A plane spreads the heights of points all over a cell of side 1 with a twelfth of its squared slope.
        rough = _variance(sums[block]) - squared_slope / 12
        faults = (
            ~has_points[block],
            np.isinf(deviation),
            deviation > MAX_ROUGH_M,
            squared_slope > steepest,
            rough > MAX_ROUGH_M**2,
        )
        # Few points on a slope have a variance that differs from the twelfth, so steep cells may seem rough.
        fault[block] = np.select(faults, (4, 3, 2, 1, 2), 0)
        x, y, z = (mean[block] for mean in means)
        height_m[block] = z - slope_x * x - slope_y * y
    return height_m, fault


def _variance(sums: Int64) -> Float64:
    """Return the variance of the heights of cells in square metres.

    The sum of squares is moved to the rounded mean. Sums of squares beyond 2**63 wrap around, and the difference wraps
    back, so it is right unless tens of thousands of heights in a cell are kilometres apart.
    """
    n, total, squares = sums[:, 0], sums[:, 1], sums[:, 2]
    middle = np.rint(total / n).astype(np.int64)
    moved = (squares - 2 * middle * total + n * middle**2).astype(np.uint64)
    variance: Float64 = (moved / n - (total / n - middle) ** 2) / STEPS_PER_METRE**2
    return variance


def _planes(
    keys: Keys, block: slice, means: tuple[Float64, ...], has_points: Bool
) -> tuple[Float64, Float64, Float64]:
    """Fit planes to the means of 3 x 3 cells around the cells of a block by least squares.

    Return their slopes along x and y in metres per cell, and the standard deviation of the means from them. It is
    infinite if too few cells define the plane.
    """
    middle = means[2][block]
    n = np.zeros(middle.size)
    total = np.zeros((3, middle.size))
    products = np.zeros((3, 3, middle.size))
    for rows, columns, near, is_there in _neighbours(keys, block):
        is_there &= has_points[near]
        x, y, z = (mean[near] for mean in means)
        position = np.stack((x + columns, y + rows, z - middle)) * is_there
        n += is_there
        total += position
        products += position[:, None] * position[None]
    with np.errstate(divide="ignore", invalid="ignore"):
        # Without points around, n is 0 and all figures are NaN.
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = products - total[:, None] * total[None] / n
        determinant = xx * yy - xy**2
        slope_x = (xz * yy - yz * xy) / determinant
        slope_y = (yz * xx - xz * xy) / determinant
        squares = np.maximum(zz - slope_x * xz - slope_y * yz, 0.0)
        deviation = np.sqrt(squares / (n - _PLANE_PARAMETERS))
    is_plane = (n >= MIN_NEIGHBOURS) & (determinant > 0)
    return (
        np.where(is_plane, slope_x, 0.0),
        np.where(is_plane, slope_y, 0.0),
        np.where(is_plane, deviation, np.inf),
    )


def _neighbours(keys: Keys, block: slice) -> Iterator[tuple[int, int, Indices, Bool]]:
    """Yield the row and column of each of 3 x 3 neighbours, their positions in the sorted keys, and which exist.

    Cells at the edge of the lattice have neighbours of another row or swath, but no survey reaches there.
    """
    for rows in (-1, 0, 1):
        wanted = (keys[block].astype(np.int64) + (rows << SIDE_BITS) - 1).astype(np.uint64)
        # The neighbours of a row follow each other.
        at = np.searchsorted(keys, wanted)
        for columns in (-1, 0, 1):
            near = np.minimum(at, keys.size - 1)
            is_there = keys[near] == wanted
            at = at + is_there
            wanted = wanted + np.uint64(1)
            yield rows, columns, near, is_there


@dataclass(frozen=True)
class Precision:
    """Repeatability of a swath.

    Attributes
    ----------
    source : int
        Point source id.
    sigma_m : float
        Standard deviation of heights in metres.
    cells : int
        Number of cells.
    worst_m : float
        Standard deviation in the worst area of `AREA_CELLS`.
    x, y : float
        Middle of this area in units of the CRS.
    """

    source: int
    sigma_m: float
    cells: int
    worst_m: float
    x: float
    y: float


def repeatability(
    keys: Keys, sums: Int64, fault: UInt8, lattice: Cells
) -> tuple[list[Precision], list[int]]:
    """Return the repeatability of the swaths with at least `MIN_CELLS` even cells, the worst first, and the others.

    The others are the point source ids of the swaths with at least `MIN_CELLS` cells of which too few are even, or have
    enough points.

    Parameters
    ----------
    keys : uint64, shape (n,)
        Keys of ``lattice``, sorted.
    sums : int64, shape (n, `N_SUMS`)
        Their `Cells.height_sums`.
    fault : uint8, shape (n,)
        0 for even cells.
    lattice : Cells
        Cells of heights.
    """
    sources, n_cells = np.unique(decoded(keys)[0], return_counts=True)
    usable = np.flatnonzero((fault == 0) & (sums[:, 0] >= MIN_CELL_POINTS))
    variance = _variances(sums[usable])
    is_plane = ~np.isnan(variance)
    variance = variance[is_plane]
    if not variance.size:
        return [], sources[n_cells >= MIN_CELLS].tolist()
    source, column, row = decoded(keys[usable[is_plane]])
    x, y = (column + lattice.column) // AREA_CELLS, (row + lattice.row) // AREA_CELLS
    order = np.lexsort((variance, x, y, source))
    source, x, y, variance = source[order], x[order], y[order], variance[order]
    new_swath = np.r_[True, source[1:] != source[:-1]]
    new_area = new_swath | np.r_[True, (x[1:] != x[:-1]) | (y[1:] != y[:-1])]
    areas = np.flatnonzero(new_area)
    n_of_area = np.diff(areas, append=source.size)
    # The middle of the sorted variances of each area.
    middle = (variance[areas + (n_of_area - 1) // 2] + variance[areas + n_of_area // 2]) / 2
    found = []
    starts = np.flatnonzero(new_swath)
    for start, end in zip(starts, [*starts[1:], source.size], strict=True):
        if end - start < MIN_CELLS:
            continue
        first, last = np.searchsorted(areas, (start, end))
        of_swath = slice(first, last)
        # A small swath may have no area with so many cells.
        least = min(MIN_CELLS, int(n_of_area[of_swath].max()))
        worst = first + int(
            np.argmax(np.where(n_of_area[of_swath] < least, -1, middle[of_swath]))
        )
        at = areas[worst]
        found.append(
            Precision(
                int(source[start]),
                float(np.sqrt(np.median(variance[start:end]))),
                int(end - start),
                float(np.sqrt(middle[worst])),
                float((x[at] + 0.5) * AREA_CELLS * lattice.side),
                float((y[at] + 0.5) * AREA_CELLS * lattice.side),
            )
        )
    measured = [swath.source for swath in found]
    others = sources[(n_cells >= MIN_CELLS) & ~np.isin(sources, measured)]
    return sorted(found, key=lambda swath: (-swath.sigma_m, swath.source)), others.tolist()


def _variances(sums: Int64) -> Float64:
    """Return the variance of heights around the plane of each cell in square metres, NaN without a plane.

    The median of these variances is that of the heights: the median of a variance of few points is below its mean by
    the cube of 1 - 2 / 9 per degree of freedom (Wilson and Hilferty 1931, PNAS).
    """
    n, z, zz, x, y, xx, yy, xy, xz, yz = sums.T
    # Products that wrap around wrap back in the differences.
    xx, yy, zz = n * xx - x * x, n * yy - y * y, n * zz - z * z
    xy, xz, yz = n * xy - x * y, n * xz - x * z, n * yz - y * z
    xx, yy, zz, xy, xz, yz = (moment.astype(np.float64) for moment in (xx, yy, zz, xy, xz, yz))
    determinant = xx * yy - xy**2
    is_plane = determinant > (1 - _MAX_CORRELATION) * xx * yy
    with np.errstate(divide="ignore", invalid="ignore"):
        explained = (xz**2 * yy - 2 * xz * yz * xy + yz**2 * xx) / determinant
    squares = np.maximum(zz - explained, 0.0) / n
    freedom = n - _PLANE_PARAMETERS
    variance = squares / freedom / (1 - 2 / (9 * freedom)) ** 3 / STEPS_PER_METRE**2
    return np.where(is_plane, variance, np.nan)
