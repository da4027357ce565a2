"""Coarse cells that may be a bridge deck: narrow, drops on both sides, roads at both ends.

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
"""Largest width of a deck, largest distance along it to ground, and largest distance across water to a bank."""
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
    """Return rows, columns and numbers of the direction across the deck, for the cells that may be decks."""
    spans = [_spans(cells, direction) for direction in range(DIRECTIONS)]
    marked = np.zeros(cells.top.shape, np.bool_)
    for rows, cols, _ in spans:
        marked[rows, cols] = True
    good_cells = [np.empty((3, 0), np.int64)]
    for direction, (rows, cols, middle) in enumerate(spans):
        ends = np.ones(int(middle.max(initial=-1)) + 1, np.bool_)
        first = np.unique(middle, return_index=True)[1]
        for sign in (1, -1):
            ends &= _road_goes_on(cells, marked, rows[first], cols[first], direction, sign)
        good = ends[middle]
        good_cells.append(np.stack((rows[good], cols[good], np.full(int(good.sum()), direction))))
    rows, cols, directions = np.concatenate(good_cells, axis=1)
    return rows, cols, directions


def along(direction: int, steps: int) -> tuple[int, int]:
    """Return the rows down and columns to the right for a number of steps in a direction."""
    angle = math.pi * direction / DIRECTIONS
    return -round(steps * math.sin(angle)), round(steps * math.cos(angle))


def _drops(cells: DeckCells, rows: Ints, cols: Ints, height: Floats, direction: int, sign: int) -> Bools:
    """Return whether the ground next to cells, or the first point beyond water, is lower by `CLEAR_M`."""
    has_drop, waiting = np.zeros(len(rows), np.bool_), np.ones(len(rows), np.bool_)
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
    """Return rows, columns and span numbers of the cells between two drops. The middle cell of a span comes first."""
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
        go_on = (
            ~ended & (gap | (np.abs(here - previous_top) <= STEP_M))
            if step
            else gap | (np.abs(here - previous_top) <= STEP_M)
        )
        previous_top = np.where(gap, previous_top, here)[go_on]
        rows, cols, start_rows, start_cols = rows[go_on], cols[go_on], start_rows[go_on], start_cols[go_on]
    first_rows, first_cols, steps = np.concatenate(spans, axis=1)
    span_cells = []
    for step in range(cells.steps(MAX_WIDTH_M) + 1):
        down, right = along(direction, -step)
        has = np.flatnonzero(steps >= step)
        middle = (step == steps[has] // 2).astype(np.int64)
        span_cells.append(np.stack((has, 1 - middle, first_rows[has] + down, first_cols[has] + right)))
    number, _, rows, cols = (whole := np.concatenate(span_cells, axis=1))[:, np.lexsort((whole[1], whole[0]))]
    return rows, cols, number


def _road_goes_on(
    cells: DeckCells, marked: Bools, rows: Ints, cols: Ints, direction: int, sign: int
) -> Bools:
    """Return whether a way along a deck leads without a step to ground that is not a deck, for each cell."""
    goes_on = np.zeros(len(rows), np.bool_)
    ways, previous_top, gaps = (
        np.arange(len(rows)),
        cells.at(cells.top, rows, cols),
        np.zeros(len(rows), np.int64),
    )
    arrived = np.zeros(len(rows), np.int64)
    turn = direction + sign * DIRECTIONS // 2
    for step in range(1, cells.steps(MAX_LENGTH_M) + 1):
        down, right = along(turn, step)
        r, c = rows[ways] + down, cols[ways] + right
        here, inside = cells.at(cells.top, r, c), cells.inside(r, c)
        unknown = np.isnan(here)
        gaps = np.where(unknown, gaps + 1, 0)
        road = np.zeros(len(ways), np.bool_)
        road[inside] = cells.ground[r[inside], c[inside]] & ~marked[r[inside], c[inside]]
        arrived = np.where(unknown, arrived, np.where(road, arrived + 1, 0))
        goes_on[ways[arrived >= 2]] = True
        go_on = inside & (arrived < 2) & np.where(unknown, gaps <= 2, np.abs(here - previous_top) <= STEP_M)
        previous_top = np.where(unknown, previous_top, here)[go_on]
        ways, gaps, arrived = ways[go_on], gaps[go_on], arrived[go_on]
    return goes_on
