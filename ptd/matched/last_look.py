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
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64, quotient
from ptd.frame import CellGrid, CellLattice, Scale
from ptd.ground.labelling import GROUND, UNCLASSIFIED
from ptd.kernel import as_int64, kernel
from ptd.matched.cell_features import CELL_FEATURES, HIGH_MM, Around
from ptd.matched.cells import by_cell
from ptd.matched.decision_trees import UNIT, DecisionTrees, scores
from ptd.passes import UInt8

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

Float64 = npt.NDArray[np.float64]


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
    """Return the column and row of each point in a grid."""
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
