"""The last look at each point of a photogrammetric cloud: decision trees check its label.

The label by the surface compares one height with one threshold. The last look also reads the
heights of the neighbours: how many of them are ground, how they scatter, how far the point lies
above their ground, and how many stand just above. It reads the cells of the surface up to 10 m
away as well. Decision trees turn these features into the log-odds of ground. A script fitted
them to scenes with known labels (``tests/benchmarks/last_look_weights.py``). Rules limit the
changes:

- Low noise stays. A point that is not ground stays so if it lies farther than `MAX_DISTANCE_M`
  from the surface.
- A label changes only if the odds against it are large enough (`CHANGE_ODDS`).
- No label changes if all points around are ground, or none is.

Features are whole numbers in millimetres or thousandths. They follow from sums of whole numbers
over windows of limited size on a lattice that is anchored at 0, so neither tiles nor the order
of points change any result. A window is the smallest one with `MIN_POINTS` points, so it
follows the density of the place.

Decision trees compare whole numbers too, so they decide the same on each machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.arrays import Bool, Float64, Int32, Int64, UInt8
from ptd.cells import quotient
from ptd.frame import CellGrid, CellLattice, Scale
from ptd.gridding.ground_cells import box_sums
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.kernel import as_int64, kernel
from ptd.matched.cells import by_cell

HIGH_MM = 1000
"""Height above the surface up to which low plants are distinguished from what is certainly not
ground."""


@dataclass(frozen=True)
class Around:
    """Features of the cells of a surface and their surroundings.

    Attributes
    ----------
    features : int32 [cells, 1 + len(CELL_FEATURES)]
        Features by rows of cells. The first is the largest distance of ground from the surface, in millimetres.
    columns : int
        Number of cells in a row.
    """

    features: Int32
    columns: int


CELL_FEATURES = (
    "noise", "slope", "bend_2", "bend_5", "bend_10", "low_5", "low_10", "high_5", "high_10", "ground_5",
)  # fmt: skip
"""Features of a cell. The first five are noise and slope of the surface, and its height above
its mean within 2, 5 and 10 m. The others are the shares of low plants and of higher objects
among the cells within 5 and 10 m, and of ground within 5 m."""
CELL_REACH_M = 10.0
"""Distance beyond which cells do not change these features."""
STEEPEST = 5.0
"""Limit at which slopes are cut off."""


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells, including a point's own, beyond which the surface does not change its label."""
    return math.ceil(CELL_REACH_M / cell_m) + 1


def around_cells(
    heights_m: Float64,
    there: Bool,
    ground_m: Float64,
    sigma_m: Float64,
    band_m: Float64,
    cell_m: float,
) -> Around:
    """Compute the features of each cell.

    Parameters
    ----------
    heights_m : float64 [rows, columns]
        Heights of the cells in metres.
    there : bool [rows, columns]
        Mask of the cells that have a height.
    ground_m : float64 [rows, columns]
        Height of the surface in metres, NaN where unknown.
    sigma_m, band_m : float64 [rows, columns]
        Noise, and largest distance of ground from the surface, in metres.
    cell_m : float
        Size of the cells in metres.
    """
    known = there & ~np.isnan(ground_m)
    surface = np.where(np.isnan(ground_m), 0, np.rint(1000 * np.nan_to_num(ground_m))).astype(
        np.int64
    )
    residual = np.where(known, np.rint(1000 * heights_m) - surface, 0).astype(np.int64)
    band = np.maximum(np.rint(1000 * np.nan_to_num(band_m)), 1).astype(np.int64)

    def share(which: Bool, metres: float) -> Int64:
        r = round(metres / cell_m)
        return 1000 * _boxes(which, r) // np.maximum(_boxes(known, r), 1)

    def bend(metres: float) -> Int64:
        r = round(metres / cell_m)
        near = np.maximum(_boxes(known, r), 1)
        bend_mm: Int64 = np.clip(
            surface - _boxes(np.where(known, surface, 0), r) // near, -30_000, 30_000
        )
        return bend_mm

    low = known & (residual > band) & (residual < HIGH_MM)
    high = known & (residual >= HIGH_MM)
    ground = known & (np.abs(residual) < band)
    north, east = np.gradient(ground_m, cell_m)
    slope = np.where(
        known, np.nan_to_num(np.rint(1000 * np.minimum(np.hypot(north, east), STEEPEST))), 0
    )
    features = (
        band, np.rint(1000 * sigma_m), slope, bend(2.0), bend(5.0), bend(CELL_REACH_M), share(low, 5.0),
        share(low, CELL_REACH_M), share(high, 5.0), share(high, CELL_REACH_M), share(ground, 5.0),
    )  # fmt: skip
    return Around(
        np.stack(features, axis=-1).reshape(-1, len(features)).astype(np.int32), there.shape[1]
    )


def _boxes(values: npt.NDArray[np.generic], r: int) -> Int64:
    """Return sums over the squares with 2 r + 1 cells on a side, with values of 0 beyond the raster."""
    return box_sums(np.pad(values.astype(np.int64), r), r, r)


UNIT = 2**16
"""Fixed-point scale: leaves are log-odds multiplied by this number."""
DEPTH = 3
"""Number of questions between the root of a decision tree and each leaf."""
NODES, LEAVES = 2**DEPTH - 1, 2**DEPTH


class DecisionTrees(NamedTuple):
    """Decision trees whose sum is the log-odds multiplied by `UNIT`.

    Attributes
    ----------
    feature, threshold : int32 [trees * NODES]
        Feature and threshold of each node. After node n of a tree comes node 2 n + 1 if the feature is at most the
        threshold, else node 2 n + 2.
    leaf : int32 [trees * LEAVES]
        Log-odds of the leaves, which are the nodes from `NODES` on.
    """

    feature: Int32
    threshold: Int32
    leaf: Int32


@cache
def last_look_trees() -> DecisionTrees:
    """Read the decision trees of `ptd.matched.last_look` from the file next to this module."""
    with files(__package__).joinpath("last_look.npz").open("rb") as file, np.load(file) as kept:
        return DecisionTrees(*(kept[name].astype(np.int32) for name in DecisionTrees._fields))


@kernel
def scores(features: Int32, trees: DecisionTrees) -> Int32:
    """Return the sum of the leaves of each point, from its row of features: int32 [n].

    All seven questions of a tree are evaluated, for several points at a time. Without branches
    this is faster than evaluating the three that matter.
    """
    feature, threshold, leaf = trees
    columns = features.T.copy()
    sums = np.zeros(features.shape[0], np.int32)
    for t in range(leaf.size // LEAVES):
        f, limit, value = feature[t * NODES :], threshold[t * NODES :], leaf[t * LEAVES :]
        x0, x1, x2, x3 = columns[f[0]], columns[f[1]], columns[f[2]], columns[f[3]]
        x4, x5, x6 = columns[f[4]], columns[f[5]], columns[f[6]]
        t0, t1, t2, t3, t4, t5, t6 = (
            limit[0],
            limit[1],
            limit[2],
            limit[3],
            limit[4],
            limit[5],
            limit[6],
        )
        v0, v1, v2, v3, v4, v5, v6, v7 = (
            value[0],
            value[1],
            value[2],
            value[3],
            value[4],
            value[5],
            value[6],
            value[7],
        )
        for k in range(sums.size):
            a, b, c = x0[k] <= t0, x1[k] <= t1, x2[k] <= t2
            d, e, g, h = x3[k] <= t3, x4[k] <= t4, x5[k] <= t5, x6[k] <= t6
            first, second = v0 if d else v1, v2 if e else v3
            third, fourth = v4 if g else v5, v6 if h else v7
            below, beyond = first if b else second, third if c else fourth
            sums[k] += below if a else beyond
    return sums


CELL_M = 0.25
"""Size of the cells in which points are counted."""
MIN_POINTS, WIDEST = 20, 5
"""Least number of points in a window, and largest r. A window is a square with 2 r + 1 cells on
a side, where r is the smallest number that gives enough points."""
REACH_M = (2 * WIDEST + 1) * CELL_M
"""Distance from a point within which the wider window, with 4 r + 1 cells on a side, ends."""
MAX_DISTANCE_M = 0.5
"""Distance from the surface within which a point that is not ground can become ground."""
CHANGE_ODDS = 1.5
"""Minimum odds against a label for a change of the label."""
CLEAR_MM = 2000
"""Limit at which heights above and below the surface are cut off, because trees and roofs need
not be distinguished."""
LOW_MM = 200
"""Height above the surface from which low plants are counted, up to `HIGH_MM`."""

PART, BLOCK = 16, 8
"""Cells on a side of a part, which is at least as wide as `REACH_M`, and parts on a side of a
block. Only one block is in memory."""
COUNT, ON_GROUND, SUM, SQUARES, GROUND_SUM, LOW, HIGH, SUMS = range(8)
"""Indices of the sums per cell, and their number: points, ground points, heights, squared
heights, heights of ground points, low plants, higher points."""
POINT_FEATURES = ("height", "deviation", "in_bands")
WINDOW_FEATURES = (
    "ground", "mean", "spread", "above_ground", "wide_ground", "wide_mean", "wide_spread", "wide_above_ground",
    "low", "high",
)  # fmt: skip
"""Features of the window, of the wider window, and of plants in the window. The height of the
point above the mean of the ground points in a window is `NO_GROUND_MM` if there are none."""
NO_GROUND_MM = 2 * CLEAR_MM
"""Height that no difference of two heights exceeds."""
NOT_OF_CELLS = len(POINT_FEATURES) + len(WINDOW_FEATURES)
FEATURES = (*POINT_FEATURES, *WINDOW_FEATURES, *CELL_FEATURES)
"""Features of a point in their order. Those of its cell are the last."""


@dataclass(frozen=True)
class Heights:
    """Points and their heights above the surface.

    Attributes
    ----------
    x, y : int32 [n]
        Local counts.
    own, voted : int32 [n]
        Height above the surface in millimetres, as measured and after the neighbours' vote; `CLEAR_MM` where there is
        no surface.
    labels : uint8 [n]
        ASPRS classes from the surface alone.
    """

    x: Int32
    y: Int32
    own: Int32
    voted: Int32
    labels: UInt8

    @classmethod
    def of(
        cls, x: Int32, y: Int32, above_m: Float64, voted_m: Float64, labels: UInt8
    ) -> Heights:
        """Convert heights in metres, which are NaN where there is no surface."""
        return cls(x, y, _millimetres(above_m), _millimetres(voted_m), labels)


class _Points(NamedTuple):
    """Column and row of each point's cell, and fields of the `Heights`, as an argument of kernels."""

    column: Int32
    row: Int32
    own: Int32
    voted: Int32
    labels: UInt8


@kernel
def _millimetres(metres: Float64) -> Int32:
    """Return heights in whole millimetres, cut off at `CLEAR_MM`, which also stands for NaN."""
    millimetres = np.empty(metres.size, np.int32)
    for k in range(metres.size):
        cut = (
            min(max(1000.0 * metres[k], -CLEAR_MM), CLEAR_MM)
            if metres[k] == metres[k]
            else CLEAR_MM
        )
        millimetres[k] = np.int32(np.rint(cut))
    return millimetres


@kernel
def _summed(index: Int32, points: _Points, first: tuple[int, int], size: int) -> Int64:
    """Return the sums of a block's points over all cells to the south-west: int64 [7, size + 1, size + 1].

    The first cell has the column and row ``first``.
    """
    column, row, _own, voted, labels = points
    west, south = first
    sums = np.zeros((SUMS, size + 1, size + 1), np.int64)
    for k in index:
        i, j, v = row[k] - south + 1, column[k] - west + 1, np.int64(voted[k])
        sums[COUNT, i, j] += 1
        sums[SUM, i, j] += v
        sums[SQUARES, i, j] += v * v
        if labels[k] == GROUND:
            sums[ON_GROUND, i, j] += 1
            sums[GROUND_SUM, i, j] += v
        sums[LOW, i, j] += LOW_MM < v < HIGH_MM
        sums[HIGH, i, j] += v >= HIGH_MM
    for q in range(SUMS):
        for i in range(1, size + 1):
            along = 0
            for j in range(1, size + 1):
                along += sums[q, i, j]
                sums[q, i, j] = along + sums[q, i - 1, j]
    return sums


@kernel
def _within(sums: Int64, q: int, i: int, j: int, r: int) -> int:
    """Return a sum over the square with 2 r + 1 cells on a side around the cell in row i, column j."""
    return int(
        sums[q, i + r + 1, j + r + 1]
        - sums[q, i - r, j + r + 1]
        - sums[q, i + r + 1, j - r]
        + sums[q, i - r, j - r]
    )


@kernel
def _describe(sums: Int64, i: int, j: int, r: int, voted: int, found: Int32) -> None:
    """Write the features of a window with at least one point into `found`. The point itself has the height `voted`."""
    n, of_ground = _within(sums, COUNT, i, j, r), _within(sums, ON_GROUND, i, j, r)
    mean = _within(sums, SUM, i, j, r) / n
    found[0] = 1000 * of_ground // n
    found[1] = math.floor(mean)
    found[2] = math.floor(
        math.sqrt(max(_within(sums, SQUARES, i, j, r) / n - mean * mean, 0.0))
    )
    found[3] = NO_GROUND_MM
    if of_ground > 0:
        found[3] = math.floor(voted - _within(sums, GROUND_SUM, i, j, r) / of_ground)


@kernel
def _features(
    index: Int32,
    points: _Points,
    sums: Int64,
    first: tuple[int, int],
    cell: Int32,
    around: Int32,
) -> tuple[Int32, Int32]:
    """Return the indices of the points that may change, and their features: int32 [m], int32 [m, features].

    ``sums`` begin at the cell with the column and row ``first``. ``cell`` is the index of each point's cell of the
    surface, ``around`` the features of these cells.
    """
    column, row, own, voted, labels = points
    west, south = first
    chosen, n = np.empty(index.size, np.int32), 0
    features = np.empty((index.size, NOT_OF_CELLS + around.shape[1] - 1), np.int32)
    for k in index:
        ground = labels[k] == GROUND
        if not (
            ground or (labels[k] == UNCLASSIFIED and abs(voted[k]) < 1000 * MAX_DISTANCE_M)
        ):
            continue
        i, j, r = row[k] - south, column[k] - west, 1
        while r < WIDEST and _within(sums, COUNT, i, j, r) < MIN_POINTS:
            r += 1
        of_ground = _within(sums, ON_GROUND, i, j, 2 * r)
        if of_ground == (_within(sums, COUNT, i, j, 2 * r) if ground else 0):
            continue
        f, near = features[n], around[cell[k]]
        f[0], f[1] = voted[k], own[k] - voted[k]
        f[2] = math.floor(1000.0 * voted[k] / near[0])
        _describe(sums, i, j, r, voted[k], f[3:7])
        _describe(sums, i, j, 2 * r, voted[k], f[7:11])
        f[11] = 1000 * _within(sums, LOW, i, j, r) // _within(sums, COUNT, i, j, r)
        f[12] = 1000 * _within(sums, HIGH, i, j, r) // _within(sums, COUNT, i, j, r)
        f[NOT_OF_CELLS:] = near[1:]
        chosen[n] = k
        n += 1
    return chosen[:n], features[:n]


def features_by_block(
    heights: Heights, cell: Int32, around: Around, scale: Scale
) -> Iterator[tuple[Int32, Int32]]:
    """Yield the indices of points that may change (int32 [m]) and their features (int32 [m, features]) per block.

    Parameters
    ----------
    heights : Heights
        Heights of at least one point.
    cell : int32 [n]
        Row of each point in `Around.features`; any number where there is no surface.
    around : Around
    scale : Scale
    """
    cells = CellLattice.of(CELL_M, scale)
    x, y = heights.x, heights.y
    west, south = (
        (first // PART - 1) * PART
        for first in (cells.column(int(x.min())), cells.row(int(y.min())))
    )
    columns, rows = (
        (last - first) // PART + 2
        for last, first in (
            (cells.column(int(x.max())), west),
            (cells.row(int(y.max())), south),
        )
    )
    column, row = _columns_and_rows(x, y, cells.grid(west, south))
    points = _Points(column, row, heights.own, heights.voted, heights.labels)
    starts, order = by_cell(
        row.astype(np.int64) // PART * columns + column // PART, columns * rows
    )
    for i in range(1, rows - 1, BLOCK):
        for j in range(1, columns - 1, BLOCK):
            inside = _of_parts(
                starts,
                order,
                columns,
                (i, min(i + BLOCK, rows - 1)),
                (j, min(j + BLOCK, columns - 1)),
            )
            if inside.size == 0:
                continue
            near = _of_parts(
                starts,
                order,
                columns,
                (i - 1, min(i + BLOCK + 1, rows)),
                (j - 1, min(j + BLOCK + 1, columns)),
            )
            first = (j - 1) * PART, (i - 1) * PART
            sums = _summed(near, points, first, (BLOCK + 2) * PART)
            yield _features(inside, points, sums, first, cell, around.features)


@kernel
def _columns_and_rows(x: Int32, y: Int32, grid: CellGrid) -> tuple[Int32, Int32]:
    p, q, ox, oy, west, south = grid
    column, row, inverse = np.empty(x.size, np.int32), np.empty(x.size, np.int32), 1.0 / p
    for k in range(x.size):
        column[k] = quotient((as_int64(x[k]) + ox) * q, p, inverse) - west
        row[k] = quotient((as_int64(y[k]) + oy) * q, p, inverse) - south
    return column, row


def _of_parts(
    starts: Int64, order: Int32, columns: int, rows: tuple[int, int], across: tuple[int, int]
) -> Int32:
    """Return the indices of the points of the parts in half-open ranges of rows and columns."""
    lines = [
        order[starts[i * columns + across[0]] : starts[i * columns + across[1]]]
        for i in range(*rows)
    ]
    return np.concatenate(lines)


def relabelled(
    heights: Heights, cell: Int32, around: Around, scale: Scale, trees: DecisionTrees
) -> UInt8:
    """Return the labels after the last look. `features_by_block` describes the parameters."""
    labels = heights.labels.copy()
    if labels.size == 0:
        return labels
    for index, features in features_by_block(heights, cell, around, scale):
        labels[index] = decided(heights.labels[index], scores(features, trees))
    return labels


def decided(labels: UInt8, score: Int32) -> UInt8:
    """Return labels of points that may change, from labels by the surface and scores of decision trees: uint8 [n]."""
    enough = round(UNIT * math.log(CHANGE_ODDS))
    required_score = np.where(labels == GROUND, -enough, enough)
    return np.where(score >= required_score, GROUND, UNCLASSIFIED).astype(np.uint8)
