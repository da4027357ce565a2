"""Search for coarse cells that may be part of a bridge deck.

A deck is narrow, the ground drops on both sides of it, and a road continues at both ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ptd.arrays import Bool, Float32, Int64

DIRECTIONS = 8
"""Number of directions that are tried as the direction across a deck.

Direction 0 points east. The others follow counterclockwise at equal angles, up to but not
including west.
"""
DROP_M = 1.0
"""A point counts as lower than a deck only if it is more than this far below the surface of the
deck, in metres."""
MIN_CELL_DROP_M = 1.8
"""A cell is at the edge of a deck only if a cell next to it is at least this much lower, in metres.

The points of a deck are tested more strictly later (`tiler.grid.bridges.deck.CLEARANCE_M`).
"""
STEP_M = 0.5
"""A deck or a road continues in the next cell if the heights of the cells differ by at most
this, in metres."""
MAX_WIDTH_M = 40.0
"""Wider areas are not decks, in metres."""
MAX_ROAD_DISTANCE_M = 60.0
"""A cell is part of a deck only if a road begins within this distance in both directions along
the deck, in metres."""
VOID_M = 40.0
"""Ground next to a deck is searched up to this distance, as there may be water without points,
in metres."""
ROUNDING_M = 4.0
"""Distances are counted in whole cells, each of which may round up by some of this, in
metres."""
REACH_M = MAX_WIDTH_M + MAX_ROAD_DISTANCE_M + VOID_M + ROUNDING_M
"""Cells farther away than this cannot change the result for a cell, in metres."""


@dataclass(frozen=True)
class CoarseHeights:
    """Heights of coarse cells in metres, NaN for cells without points.

    Attributes
    ----------
    top : float32 (h, w)
        Height of the highest ground point of each cell, or of the lowest point if the cell has no ground point.
    low : float32 (h, w)
        Height of the lowest point of each cell.
    ground : bool (h, w)
        Whether a ground point lies in the cell.
    size_m : float
        Side of a cell.
    """

    top: Float32
    low: Float32
    ground: Bool
    size_m: float

    def steps(self, length_m: float) -> int:
        """Convert a length to a number of cells, at least 1."""
        return max(math.ceil(length_m / self.size_m), 1)

    def inside(self, rows: Int64, cols: Int64) -> Bool:
        """Return a mask of the positions within the raster."""
        height, width = self.top.shape
        inside_mask: Bool = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        return inside_mask

    def at(self, values: Float32, rows: Int64, cols: Int64) -> Float32:
        """Return the values at positions, NaN beyond the raster."""
        inside = self.inside(rows, cols)
        cell_values = np.full(len(rows), np.nan, np.float32)
        cell_values[inside] = values[rows[inside], cols[inside]]
        return cell_values


def candidate_cells(cells: CoarseHeights) -> tuple[Int64, Int64, Int64]:
    """Return row, column and direction of each cell that may be part of a deck.

    The direction points across the deck.
    """
    spans = [_spans(cells, direction) for direction in range(DIRECTIONS)]
    marked = np.zeros(cells.top.shape, np.bool_)
    for rows, cols, _ in spans:
        marked[rows, cols] = True
    good_cells = [np.empty((3, 0), np.int64)]
    for direction, (rows, cols, span_of) in enumerate(spans):
        # The first cell of each span is its middle.
        middle = np.unique(span_of, return_index=True)[1]
        has_roads = np.ones(int(span_of.max(initial=-1)) + 1, np.bool_)
        for sign in (1, -1):
            has_roads &= _has_road(cells, marked, rows[middle], cols[middle], direction, sign)
        good = has_roads[span_of]
        good_cells.append(
            np.stack((rows[good], cols[good], np.full(int(good.sum()), direction)))
        )
    rows, cols, directions = np.concatenate(good_cells, axis=1)
    return rows, cols, directions


def _offset(direction: int, steps: int) -> tuple[int, int]:
    angle = math.pi * direction / DIRECTIONS
    return -round(steps * math.sin(angle)), round(steps * math.cos(angle))


def _drops(
    cells: CoarseHeights, rows: Int64, cols: Int64, height: Float32, direction: int, sign: int
) -> Bool:
    """Return a mask of the cells with a drop next to them, in a direction or (``sign`` -1) against it.

    There is a drop if the next cell with points lies at least `MIN_CELL_DROP_M` below
    ``height``. The second cell is examined even if the first one has points. Cells without
    points, such as water, are skipped up to `VOID_M`.
    """
    has_drop = np.zeros(len(rows), np.bool_)
    waiting = np.ones(len(rows), np.bool_)
    for step in range(1, cells.steps(VOID_M) + 1):
        down, right = _offset(direction, sign * step)
        low = cells.at(cells.low, rows + down, cols + right)
        has_drop |= waiting & (low <= height - MIN_CELL_DROP_M)
        # The first cell may have points of the deck as well as of the ground, so the second
        # cell is always examined.
        waiting &= ~has_drop & (np.isnan(low) | (step == 1))
        if not waiting.any():
            break
    return has_drop


def _spans(cells: CoarseHeights, direction: int) -> tuple[Int64, Int64, Int64]:
    """Return the cells of all spans in a direction: row, column and number of the span of each cell.

    A span is a line of cells across a deck, from one drop to the other. The middle cell of a
    span comes first.
    """
    # A span starts at a cell with a drop in the direction. It goes on against the direction to
    # the next drop.
    rows, cols = (axis.astype(np.int64) for axis in np.nonzero(~np.isnan(cells.top)))
    edge = _drops(cells, rows, cols, cells.top[rows, cols], direction, 1)
    rows, cols = rows[edge], cols[edge]
    start_rows, start_cols, previous_top = rows, cols, cells.top[rows, cols]
    spans = [np.empty((3, 0), np.int64)]
    for step in range(cells.steps(MAX_WIDTH_M)):
        ended = _drops(cells, rows, cols, previous_top, direction, -1)
        if step:  # A span has at least two cells.
            spans.append(
                np.stack(
                    (start_rows[ended], start_cols[ended], np.full(int(ended.sum()), step))
                )
            )
        down, right = _offset(direction, -(step + 1))
        rows, cols = start_rows + down, start_cols + right
        here = cells.at(cells.top, rows, cols)
        gap = np.isnan(here) & cells.inside(rows, cols)
        go_on = gap | (np.abs(here - previous_top) <= STEP_M)
        if step:
            go_on &= ~ended
        previous_top = np.where(gap, previous_top, here)[go_on]
        rows, cols = rows[go_on], cols[go_on]
        start_rows, start_cols = start_rows[go_on], start_cols[go_on]
    # For each span: its first cell, and the number of steps to its last cell.
    first_rows, first_cols, last_step = np.concatenate(spans, axis=1)
    span_cells = []
    for step in range(cells.steps(MAX_WIDTH_M) + 1):
        down, right = _offset(direction, -step)
        spans_here = np.flatnonzero(last_step >= step)
        not_middle = (step != last_step[spans_here] // 2).astype(np.int64)
        rows, cols = first_rows[spans_here] + down, first_cols[spans_here] + right
        span_cells.append(np.stack((spans_here, not_middle, rows, cols)))
    span_of, not_middle, rows, cols = np.concatenate(span_cells, axis=1)
    order = np.lexsort((not_middle, span_of))
    return rows[order], cols[order], span_of[order]


def _has_road(
    cells: CoarseHeights, marked: Bool, rows: Int64, cols: Int64, direction: int, sign: int
) -> Bool:
    """Return a mask of the cells from which a straight path along the deck leads to a road.

    A road is two successive cells of ground that are not ``marked`` as deck. Cells without
    points may lie between them. The path has no steps above `STEP_M`, and at most two
    successive cells without points. ``direction`` points across the deck. ``sign`` selects the
    end of the deck.
    """
    has_road = np.zeros(len(rows), np.bool_)
    paths = np.arange(len(rows))  # Indices of the cells whose paths still go on.
    previous_top = cells.at(cells.top, rows, cols)
    gaps = np.zeros(len(rows), np.int64)
    n_road = np.zeros(len(rows), np.int64)
    along = direction + sign * DIRECTIONS // 2
    for step in range(1, cells.steps(MAX_ROAD_DISTANCE_M) + 1):
        down, right = _offset(along, step)
        r, c = rows[paths] + down, cols[paths] + right
        here, inside = cells.at(cells.top, r, c), cells.inside(r, c)
        unknown = np.isnan(here)
        gaps = np.where(unknown, gaps + 1, 0)
        road = np.zeros(len(paths), np.bool_)
        road[inside] = cells.ground[r[inside], c[inside]] & ~marked[r[inside], c[inside]]
        n_road = np.where(unknown, n_road, np.where(road, n_road + 1, 0))
        has_road[paths[n_road >= 2]] = True
        passable = np.where(unknown, gaps <= 2, np.abs(here - previous_top) <= STEP_M)
        go_on = inside & (n_road < 2) & passable
        previous_top = np.where(unknown, previous_top, here)[go_on]
        paths, gaps, n_road = paths[go_on], gaps[go_on], n_road[go_on]
    return has_road
