"""Progressive morphological opening of a minimum raster, which finds cells of objects (Chen 2023, 2.2).

Empty cells of the raster are filled from their neighbours first (2.2 A).

The paper opens the surface with growing square windows, and each opening starts from the result
of the last one. An opening with a square after one with a smaller square equals the opening of
the first surface with the larger square, because a square is a union of smaller ones. So each
surface here is an opening of the first one, and only cells within one window's width decide on
a cell, however many windows there are.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Int32, Int64
from ptd.frame import CellLattice, Window
from ptd.ground.morphology import EMPTY, blocks
from ptd.kernel import kernel


@kernel
def _neighbours_of(
    heights: Int32, row: int, column: int, layers: Int32, k: int
) -> tuple[Any, Any, Any]:
    """Sum, number and minimum of the 8-neighbours in layers before k."""
    total, n, lowest = np.int64(0), np.int64(0), np.int64(EMPTY)
    for r in range(max(row - 1, 0), min(row + 2, heights.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, heights.shape[1])):
            if 0 <= layers[r, c] < k:
                total += heights[r, c]
                n += 1
                lowest = min(lowest, np.int64(heights[r, c]))
    return total, n, lowest


@kernel
def _queue_around(layers: Int32, row: int, column: int, k: int, queue: Int64, n: int) -> int:
    """Put empty 8-neighbours that are not queued yet into layer k, and return the new length of the queue."""
    for r in range(max(row - 1, 0), min(row + 2, layers.shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, layers.shape[1])):
            if layers[r, c] < 0:
                layers[r, c] = k
                queue[n] = r * layers.shape[1] + c
                n += 1
    return n


@kernel
def _grow(heights: Int32, layers: Int32, queue: Int64, mean_layers: int, last: int) -> None:
    width = heights.shape[1]
    end = 0
    for row in range(heights.shape[0]):
        for column in range(width):
            if layers[row, column] == 0:
                end = _queue_around(layers, row, column, 1, queue, end)
    start = 0
    for k in range(1, last + 1):
        stop = end
        for i in range(start, stop):
            row, column = queue[i] // width, queue[i] % width
            total, n, lowest = _neighbours_of(heights, row, column, layers, k)
            heights[row, column] = lowest
            if k <= mean_layers:
                heights[row, column] = total // n
            if k < last:
                end = _queue_around(layers, row, column, k + 1, queue, end)
        start = stop


def fill_empty(heights: Int32, mean_layers: int, last: int) -> tuple[Int32, Int32]:
    """Fill empty cells layer by layer around the filled ones.

    In the first layers a cell takes the mean of its filled 8-neighbours, rounded down to a
    count. In later layers it takes the height of the nearest filled cell. Distance is the
    larger of the differences in row and column; among equally near cells the lowest counts. The
    paper gives cells beyond its interpolation the height 0, a pit that no opening closes.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Counts; `ptd.ground.morphology.EMPTY` where there is none.
    mean_layers : int
        Number of layers that are interpolated.
    last : int
        Number of layers that are filled. Cells farther from filled ones stay empty.

    Returns
    -------
    filled : int32 [rows, columns]
    layers : int32 [rows, columns]
        Distance of a cell from the cells that had heights, -1 where it is still empty. The height of a cell depends on
        no cell farther away than this.
    """
    filled = np.array(heights, np.int32, order="C")
    layers = np.where(filled == EMPTY, -1, 0).astype(np.int32)
    _grow(filled, layers, np.empty(int((layers < 0).sum()), np.int64), mean_layers, last)
    layers[filled == EMPTY] = -1
    return filled, layers


BLOCK_CELLS = 512
"""Side of the blocks in which rasters are processed, so that memory does not grow with the
extent."""


def window_widths(initial: int, exponential: bool, building_cells: Fraction) -> list[int]:
    """Widths of the windows in cells, all odd.

    Parameters
    ----------
    initial : int
        W_0 of equations 1 and 2; at least 2 if `exponential`.
    exponential : bool
        ``W_k = 2 W_0^k + 1`` (equation 2) instead of ``W_k = 2 k W_0 + 1`` (equation 1); k = 1, 2, ...
    building_cells : Fraction
        The largest building in cells. The last window is the smallest odd one wider than that, and at least three
        cells; it replaces wider windows of the series.
    """
    last = max(int(building_cells) + 1, 3)
    last += 1 - last % 2
    widths, k = [1], 0
    while widths[-1] < last:
        k += 1
        half = initial**k if exponential else k * initial
        widths.append(min(2 * half + 1, last))
    return widths[1:]


def height_thresholds(
    widths: list[int], slope: float, cell_m: float, initial_m: float, largest_m: float
) -> list[float]:
    """Largest drop of ground in the opening with each window, metres (equation 3).

    ``h_k = h_0`` for ``W_k <= 3``, otherwise ``s (W_k - W_{k-1}) c + h_0``, and at most ``h_max``. The width before
    the first window is 1 cell.

    Parameters
    ----------
    widths : list of int
        W_k in cells.
    slope : float
        s, rise over run.
    cell_m, initial_m, largest_m : float
        c, h_0 and h_max.
    """
    drops = []
    for previous_width, width in zip([1, *widths], widths, strict=False):
        drop = initial_m
        if width > 3:
            drop = slope * (width - previous_width) * cell_m + initial_m
        drops.append(min(drop, largest_m))
    return drops


def _runs(values: Any, n: int, pick: np.ufunc) -> Any:
    """Return the smallest or largest value of each square of n x n cells, with n - 1 rows and columns fewer."""
    for axis in (0, 1):
        covered = 1
        while covered < n:
            step = min(covered, n - covered)
            size = values.shape[axis] - step
            if axis == 0:
                values = pick(values[:size], values[step:])
            else:
                values = pick(values[:, :size], values[:, step:])
            covered += step
    return values


def opened_surfaces(heights: Int32, widths: list[int]) -> Iterator[Int32]:
    """Openings of a surface with each of the squares, without the outer ``max(widths) - 1`` cells.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Without empty cells, or with `EMPTY` ones which lie farther than ``max(widths) - 1`` from all cells that
        matter.
    widths : list of int
        Odd widths in growing order, cells.
    """
    rim = max(widths) - 1
    lowest, width = heights, 1
    for wider in widths:
        lowest, width = _runs(lowest, wider - width + 1, np.minimum), wider
        opened = _runs(lowest, width, np.maximum)
        inner = rim - (width - 1)
        yield opened[inner : opened.shape[0] - inner, inner : opened.shape[1] - inner]


class Opening(NamedTuple):
    """Windows and height thresholds of a progressive opening.

    Attributes
    ----------
    widths : list of int
        Widths of the windows, cells.
    drops : list of float
        A cell that drops by more from one surface to the next is an object; counts of height.
    mean_layers : int
        See `fill_empty`.
    """

    widths: list[int]
    drops: list[float]
    mean_layers: int

    @property
    def reach(self) -> int:
        """Distance in cells within which cells decide on a cell."""
        return max(self.widths) - 1


def object_cells(heights: Int32, opening: Opening, known: Bool | None) -> tuple[Bool, Bool]:
    """Masks of the cells that are higher than an opening allows for ground, and of those that may be.

    Parameters
    ----------
    heights : int32 [rows, columns]
        The minimum raster, `EMPTY` where there is no point; twice ``opening.reach`` wider on all sides than the
        result.
    opening : Opening
    known : bool [rows, columns], optional
        A rectangle of cells whose points are all given; by default all cells.
    """
    reach = opening.reach
    filled, layers = fill_empty(heights, opening.mean_layers, reach)
    inner = np.s_[reach:-reach, reach:-reach]
    surface = filled[inner]
    previous_surface = surface[inner].astype(np.int64)
    objects = np.zeros(previous_surface.shape, np.bool_)
    for opened, drop in zip(
        opened_surfaces(surface, opening.widths), opening.drops, strict=True
    ):
        objects |= previous_surface - opened > drop
        previous_surface = opened.astype(np.int64)
    uncertified = np.zeros(objects.shape, np.bool_)
    if known is not None and not known.all():
        to_unknown = scipy.ndimage.distance_transform_cdt(known, "chessboard")
        near_unknown = to_unknown <= np.where(layers < 0, reach, layers)
        uncertified = _runs(near_unknown[inner], 2 * reach + 1, np.logical_or)
    return objects, uncertified


def potential_seeds(
    x: Int32,
    y: Int32,
    z: Int32,
    eligible: Bool,
    cells: CellLattice,
    opening: Opening,
    known: Window,
) -> tuple[Bool, Bool]:
    """Find the points whose cell does not rise above the ground.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts, at most one point per cell.
    eligible : bool [n]
        False for outliers, which leave their cells empty.
    cells : CellLattice
        Lattice of the minimum raster.
    opening : Opening
    known : Window
        The box in which all points and their eligibility are known.

    Returns
    -------
    seeds : bool [n]
    uncertified : bool [n]
        Mask of the points for which points outside the window could change the result.
    """
    seeds, uncertified = np.zeros(x.size, np.bool_), np.zeros(x.size, np.bool_)
    if not x.size:
        return seeds, uncertified
    columns, rows = cells.cell_indices(x, y)
    rim, order = 2 * opening.reach, np.argsort(rows, kind="stable")
    for part, inner in blocks(x[order], y[order], cells, rim, BLOCK_CELLS):
        near = order[part]
        inner_points = near[inner]
        row, column = rows[inner_points].min() - rim, columns[inner_points].min() - rim
        heights = np.full(
            (
                np.ptp(rows[inner_points]) + 1 + 2 * rim,
                np.ptp(columns[inner_points]) + 1 + 2 * rim,
            ),
            EMPTY,
            np.int32,
        )
        taken = near[eligible[near]]
        within = (rows[taken] - row < heights.shape[0]) & (
            columns[taken] - column < heights.shape[1]
        )
        within &= (rows[taken] >= row) & (columns[taken] >= column)
        taken = taken[within]
        heights[rows[taken] - row, columns[taken] - column] = z[taken]
        inside = _known_cells(cells, known, int(row), int(column), heights.shape)
        objects, uncertified_cells = object_cells(heights, opening, inside)
        cell_positions = rows[inner_points] - row - rim, columns[inner_points] - column - rim
        seeds[inner_points], uncertified[inner_points] = (
            eligible[inner_points] & ~objects[cell_positions],
            uncertified_cells[cell_positions],
        )
    return seeds, uncertified


def _known_cells(
    cells: CellLattice, known: Window, row: int, column: int, shape: tuple[int, int]
) -> Bool | None:
    """Return a mask of the cells of a raster that lie in a window of whole cells, or None if all do."""
    if not known.closed:
        return None
    souths = np.array([cells.south(row + i) for i in range(shape[0] + 1)])
    wests = np.array([cells.west(column + i) for i in range(shape[1] + 1)])
    in_rows = (souths[:-1] >= known.south) & (souths[1:] <= known.north)
    in_columns = (wests[:-1] >= known.west) & (wests[1:] <= known.east)
    return np.outer(in_rows, in_columns)
