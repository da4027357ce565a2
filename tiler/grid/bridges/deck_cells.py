"""Search for coarse cells that may be a bridge deck: narrow, with drops on both sides and roads at both ends.

The result depends only on cells within `REACH_M` of a cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64]

DIRECTIONS = 8
"""Number of directions across a deck that are tried, from east by north to west."""
DROP_M = 1.0
"""Least height of the free part of a deck above the ground next to it."""
CLEAR_M = 1.8
"""Least height of a cell above the ground next to it at which the cell may be part of a deck."""
STEP_M = 0.5
"""Largest height difference between neighbouring cells of a deck."""
MAX_WIDTH_M, MAX_LENGTH_M, VOID_M = 40.0, 60.0, 40.0
"""Largest width of a deck, largest distance along a deck to ground, and largest distance across water to a bank."""
REACH_M = MAX_WIDTH_M + MAX_LENGTH_M + VOID_M


@dataclass(frozen=True)
class DeckCells:
    """Heights of coarse cells in metres, NaN for cells without points.

    Attributes
    ----------
    top, low : float32 (h, w)
        Highest ground point of each cell (its lowest point if there is no ground point), and its lowest point.
    ground : bool (h, w)
        Whether a ground point lies in the cell.
    size_m : float
    """

    top: Floats
    low: Floats
    ground: Bools
    size_m: float

    def steps(self, length_m: float) -> int:
        """Convert a length to a number of cells, at least 1."""
        return max(math.ceil(length_m / self.size_m), 1)

    def inside(self, rows: Ints, cols: Ints) -> Bools:
        """Return a mask of the positions within the raster."""
        height, width = self.top.shape
        inside_mask: Bools = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        return inside_mask

    def at(self, values: Floats, rows: Ints, cols: Ints) -> Floats:
        """Return the values at positions, NaN beyond the raster."""
        inside = self.inside(rows, cols)
        cell_values = np.full(len(rows), np.nan, np.float32)
        cell_values[inside] = values[rows[inside], cols[inside]]
        return cell_values


def deck_cells(cells: DeckCells) -> tuple[Ints, Ints, Ints]:
    """Return the cells that may be decks: rows, columns, and the number of the direction across the deck."""
    spans = [_spans(cells, direction) for direction in range(DIRECTIONS)]
    marked = np.zeros(cells.top.shape, np.bool_)
    for rows, cols, _ in spans:
        marked[rows, cols] = True
    good_cells = [np.empty((3, 0), np.int64)]
    for direction, (rows, cols, number) in enumerate(spans):
        # The first cell of each span is its middle.
        middle = np.unique(number, return_index=True)[1]
        has_roads = np.ones(int(number.max(initial=-1)) + 1, np.bool_)
        for sign in (1, -1):
            has_roads &= _road_goes_on(cells, marked, rows[middle], cols[middle], direction, sign)
        good = has_roads[number]
        good_cells.append(np.stack((rows[good], cols[good], np.full(int(good.sum()), direction))))
    rows, cols, directions = np.concatenate(good_cells, axis=1)
    return rows, cols, directions


def along(direction: int, steps: int) -> tuple[int, int]:
    """Convert a number of steps in a direction to rows down and columns to the right."""
    angle = math.pi * direction / DIRECTIONS
    return -round(steps * math.sin(angle)), round(steps * math.cos(angle))


def _drops(cells: DeckCells, rows: Ints, cols: Ints, height: Floats, direction: int, sign: int) -> Bools:
    """Return a mask of the cells next to which the ground, or the first point beyond water, is `CLEAR_M` lower."""
    has_drop = np.zeros(len(rows), np.bool_)
    waiting = np.ones(len(rows), np.bool_)
    for step in range(1, cells.steps(VOID_M) + 1):
        down, right = along(direction, sign * step)
        low = cells.at(cells.low, rows + down, cols + right)
        has_drop |= waiting & (low <= height - CLEAR_M)
        # A cell at the edge has points of the deck and of the ground, so one more cell is examined.
        waiting &= ~has_drop & (np.isnan(low) | (step == 1))
        if not waiting.any():
            break
    return has_drop


def _spans(cells: DeckCells, direction: int) -> tuple[Ints, Ints, Ints]:
    """Return rows, columns and span numbers of the cells between two drops.

    A span is a line of cells across a deck, from one drop to the other. Its middle cell comes first.
    """
    rows, cols = (axis.astype(np.int64) for axis in np.nonzero(~np.isnan(cells.top)))
    edge = _drops(cells, rows, cols, cells.top[rows, cols], direction, 1)
    rows, cols = rows[edge], cols[edge]
    start_rows, start_cols, previous_top = rows, cols, cells.top[rows, cols]
    spans = [np.empty((3, 0), np.int64)]
    for step in range(cells.steps(MAX_WIDTH_M)):
        ended = _drops(cells, rows, cols, previous_top, direction, -1)
        if step:
            spans.append(np.stack((start_rows[ended], start_cols[ended], np.full(int(ended.sum()), step))))
        down, right = along(direction, -(step + 1))
        rows, cols = start_rows + down, start_cols + right
        here = cells.at(cells.top, rows, cols)
        gap = np.isnan(here) & cells.inside(rows, cols)
        go_on = gap | (np.abs(here - previous_top) <= STEP_M)
        if step:
            go_on &= ~ended
        previous_top = np.where(gap, previous_top, here)[go_on]
        rows, cols, start_rows, start_cols = rows[go_on], cols[go_on], start_rows[go_on], start_cols[go_on]
    first_rows, first_cols, steps = np.concatenate(spans, axis=1)
    span_cells = []
    for step in range(cells.steps(MAX_WIDTH_M) + 1):
        down, right = along(direction, -step)
        has = np.flatnonzero(steps >= step)
        middle = (step == steps[has] // 2).astype(np.int64)
        span_cells.append(np.stack((has, 1 - middle, first_rows[has] + down, first_cols[has] + right)))
    number, not_middle, rows, cols = np.concatenate(span_cells, axis=1)
    order = np.lexsort((not_middle, number))
    return rows[order], cols[order], number[order]


def _road_goes_on(
    cells: DeckCells, marked: Bools, rows: Ints, cols: Ints, direction: int, sign: int
) -> Bools:
    """Return a mask of the cells from which ground beyond the deck can be reached without a step in height.

    The path is straight, at right angles to the direction ``direction`` across the deck.
    """
    goes_on = np.zeros(len(rows), np.bool_)
    paths = np.arange(len(rows))
    previous_top = cells.at(cells.top, rows, cols)
    gaps = np.zeros(len(rows), np.int64)
    arrived = np.zeros(len(rows), np.int64)
    turn = direction + sign * DIRECTIONS // 2
    for step in range(1, cells.steps(MAX_LENGTH_M) + 1):
        down, right = along(turn, step)
        r, c = rows[paths] + down, cols[paths] + right
        here, inside = cells.at(cells.top, r, c), cells.inside(r, c)
        unknown = np.isnan(here)
        gaps = np.where(unknown, gaps + 1, 0)
        road = np.zeros(len(paths), np.bool_)
        road[inside] = cells.ground[r[inside], c[inside]] & ~marked[r[inside], c[inside]]
        arrived = np.where(unknown, arrived, np.where(road, arrived + 1, 0))
        goes_on[paths[arrived >= 2]] = True
        go_on = inside & (arrived < 2) & np.where(unknown, gaps <= 2, np.abs(here - previous_top) <= STEP_M)
        previous_top = np.where(unknown, previous_top, here)[go_on]
        paths, gaps, arrived = paths[go_on], gaps[go_on], arrived[go_on]
    return goes_on
