"""Contours of a raster that is read block by block: lines of a block, and lines joined across blocks.

An edge connects two neighbouring pixel centres, and a line runs from edge to edge. A vertex is
identified by its edge and computed only from the two heights at the ends of the edge. So the
blocks on both sides of a border find the same vertex, and lines join exactly.

Short rings are drawn only around small tops and pits, since other short rings are noise of the
heights.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import scipy
import shapely

from ptd.arrays import Float64, Int64

OFF_LEVEL = 1e-6
"""Distance from a level, as a share of the interval, below which a height is moved to this distance above the level.

So lines never run through a pixel centre, where they would touch, and run around a lake that
lies exactly on a level.
"""

STEP = 2.0**-20
"""Precision in pixels of the position of a vertex between two pixels. Sums of positions are exact, so that vertices do
not depend on the raster's first pixel."""
SHORT = 10.0
"""Length in pixels below which a ring is drawn only around a top or a pit."""
MIN_RISE = 0.5
"""Minimum difference between the level of a short ring and the ground inside it, as a share of
the interval."""

LINES_OF_RELIEF = 50
"""Maximum number of levels over the relief of a run if the user gives no interval."""
TIMES_NOISE = 4
"""Minimum interval as a multiple of the noise of the ground, if the user gives no interval."""
STEPS = (1, 2, 5)
"""Factors of the default intervals: each interval is a factor times a power of ten."""

REACH_SIGMAS = 3
"""Radius of the smoothing in standard deviations."""

MAX_HELD_VERTICES = 4_000_000
"""Maximum number of vertices of unfinished lines in memory. If there are more, the longest
lines are cut."""

Key = tuple[int, int, int, int]
"""Key of a vertex: level, row and column of the first pixel (from the north-west) of its edge,
and the direction of the edge, 1 for south and 0 for east."""


@dataclass(frozen=True)
class Piece:
    """Contour line within a block, with higher ground always on the same side.

    Attributes
    ----------
    start, end : Key
        Keys of its ends, which are equal if the line is closed.
    places : float64 (n, 2)
        Column and row of each vertex, in pixels from the centre of the raster's north-west pixel.
    """

    start: Key
    end: Key
    places: Float64


def default_interval(relief: float, floor: Fraction, noise: float = 0.0) -> Fraction:
    """Return the smallest round interval that suits the relief and the accuracy of the heights.

    It gives at most about `LINES_OF_RELIEF` levels. All values are in the unit of the heights.

    Parameters
    ----------
    relief : float
        Difference between high and low ground.
    floor : Fraction
        Minimum interval.
    noise : float
        Standard deviation of the heights. The interval is at least `TIMES_NOISE` times as large.
    """
    least = max(relief / LINES_OF_RELIEF, TIMES_NOISE * noise)
    if least <= floor:
        return floor
    power = math.floor(math.log10(least)) - 1
    steps = (
        Fraction(step) * Fraction(10) ** (power + more) for more in range(4) for step in STEPS
    )
    return next(step for step in steps if float(step) >= least)


def smoothing_reach(sigma: float) -> int:
    """Return the margin in pixels that `smoothed` needs, for a standard deviation in pixels."""
    return math.ceil(REACH_SIGMAS * sigma)


def smoothed(heights: Float64, sigma: float) -> Float64:
    """Return heights averaged by a Gaussian of ``sigma`` pixels.

    Pixels without a height (NaN) have no weight and stay NaN.
    """
    if sigma <= 0:
        return heights
    radius = smoothing_reach(sigma)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    known = ~np.isnan(heights)
    total, weight = np.where(known, heights, 0.0), known.astype(np.float64)
    for axis in (0, 1):
        total = scipy.ndimage.correlate1d(total, weights, axis=axis, mode="constant")
        weight = scipy.ndimage.correlate1d(weight, weights, axis=axis, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known, total / weight, np.nan)


def contour_block(heights: Float64, interval: Fraction, row: int, col: int) -> Iterator[Piece]:
    """Yield the lines between the pixel centres of a block, level by level from the lowest.

    There are no lines next to a pixel without a height.

    Parameters
    ----------
    heights : float64 (h, w)
        Heights of the block, NaN for pixels without one. It shares its last row and column with the blocks to the south
        and east.
    interval : Fraction
        Interval of the levels, which are its multiples, in the unit of the heights.
    row, col : int
        Row and column of the block's first pixel in the raster.
    """
    from contourpy import LineType, contour_generator

    if min(heights.shape) < 2 or np.isnan(heights).all():
        return
    step = float(interval)
    level = np.rint(heights / step)
    heights = np.where(
        np.abs(heights / step - level) < OFF_LEVEL, (level + OFF_LEVEL) * step, heights
    )
    lines = contour_generator(
        z=np.ma.masked_invalid(heights),
        name="serial",
        corner_mask=False,
        line_type=LineType.Separate,
    )
    for number in range(
        math.ceil(np.nanmin(heights) / step), math.floor(np.nanmax(heights) / step) + 1
    ):
        height = float(number * interval)
        for line in lines.lines(height):
            rows, cols, down = _edges(np.asarray(line))
            part = _part(heights, height, rows, cols, down)
            rows, cols = rows + row, cols + col
            first, last = ((number, int(rows[i]), int(cols[i]), int(down[i])) for i in (0, -1))
            yield Piece(
                first, last, np.stack((cols + (1 - down) * part, rows + down * part), axis=1)
            )


def _edges(line: Float64) -> tuple[Int64, Int64, Int64]:
    """Return row and column of the first pixel of the edge of each vertex (x, y), and 1 if the edge runs south.

    One of x and y is a whole number up to rounding. `OFF_LEVEL` keeps the other one much
    farther from whole numbers.
    """
    nearest = np.rint(line)
    off = np.abs(line - nearest)
    down = off[:, 0] < off[:, 1]
    cols = np.where(down, nearest[:, 0], np.floor(line[:, 0])).astype(np.int64)
    rows = np.where(down, np.floor(line[:, 1]), nearest[:, 1]).astype(np.int64)
    return rows, cols, down.astype(np.int64)


def _part(heights: Float64, level: float, rows: Int64, cols: Int64, down: Int64) -> Float64:
    """Return the position of each vertex along its edge (0 to 1), from the heights at both ends.

    The ends are in the order of the raster, so that both blocks of an edge get the same
    position, a multiple of `STEP`.
    """
    first, second = heights[rows, cols], heights[rows + down, cols + 1 - down]
    part: Float64 = np.rint((level - first) / (second - first) / STEP) * STEP
    return part.clip(STEP, 1 - STEP)


@dataclass
class _Line:
    """Line that may continue at both ends."""

    start: Key
    end: Key
    parts: list[Float64]
    n: int


@dataclass
class Joiner:
    """Joiner of the pieces of blocks that come row by row from the north-west, each row from the west.

    Attributes
    ----------
    max_held : int
        Maximum number of vertices of unfinished lines. If there are more, the longest lines are yielded unfinished, and
        continue as new lines.
    cut : int
        Number of lines that were yielded unfinished.
    """

    max_held: int = MAX_HELD_VERTICES
    cut: int = 0
    _starts: dict[Key, _Line] = field(default_factory=dict)
    _ends: dict[Key, _Line] = field(default_factory=dict)
    _held: int = 0

    def add(self, piece: Piece) -> Iterator[tuple[int, Float64]]:
        """Add a piece, and yield the ring that it completes, if any, as level and vertices."""
        if piece.start == piece.end:
            yield piece.start[0], _from_least(piece.places)
            return
        line = _Line(piece.start, piece.end, [piece.places], len(piece.places))
        self._held += line.n
        before = self._ends.pop(piece.start, None)
        if before is not None:
            self._forget(before)
            line = _Line(
                before.start,
                line.end,
                [*before.parts, line.parts[0][1:]],
                before.n + line.n - 1,
            )
            self._held -= 1
        if line.start == line.end:
            self._held -= line.n
            yield line.start[0], _from_least(np.concatenate(line.parts))
            return
        after = self._starts.pop(line.end, None)
        if after is not None:
            self._forget(after)
            rest = [after.parts[0][1:], *after.parts[1:]]
            line = _Line(line.start, after.end, [*line.parts, *rest], line.n + after.n - 1)
            self._held -= 1
        self._starts[line.start] = self._ends[line.end] = line

    def end_row(self, last_row: int) -> Iterator[tuple[int, Float64]]:
        """Yield the lines that no later block can extend, once all blocks down to ``last_row`` were added.

        If too many vertices are left, the longest unfinished lines are yielded as well.
        """

        def waits(key: Key) -> bool:
            return key[1] == last_row and key[3] == 0

        done = [
            line for line in self._starts.values() if not (waits(line.start) or waits(line.end))
        ]
        for line in done:
            yield self._given(line)
        if self._held > self.max_held:
            for line in sorted(self._starts.values(), key=lambda held: (-held.n, held.start)):
                self.cut += 1
                yield self._given(line)
                if self._held <= self.max_held // 2:
                    break

    def _given(self, line: _Line) -> tuple[int, Float64]:
        self._forget(line)
        self._held -= line.n
        return line.start[0], np.concatenate(line.parts)

    def _forget(self, line: _Line) -> None:
        self._starts.pop(line.start, None)
        self._ends.pop(line.end, None)


def _from_least(places: Float64) -> Float64:
    """Return a ring from its westernmost vertex on, so that it does not depend on the order of the blocks."""
    ring = places[:-1]
    first = int(np.lexsort((ring[:, 1], ring[:, 0]))[0])
    return np.concatenate((ring[first:], ring[: first + 1]))


def is_short(places: Float64) -> bool:
    """Return whether a line with vertices (column, row) in pixels is closed and shorter than `SHORT`."""
    if len(places) > 4 * SHORT or not (places[0] == places[-1]).all():
        return False
    return bool(np.hypot(*np.diff(places, axis=0).T).sum() < SHORT)


def stays(places: Float64, heights: Float64, level: float, interval: float) -> bool:
    """Return whether a short ring is the only ring of a top or pit that is high or deep enough to be drawn.

    Its ground differs from the level of the ring by at least `MIN_RISE` intervals, and by less
    than one interval.

    Parameters
    ----------
    places : float64 (n, 2)
        Column and row of the vertices of the ring in `heights`.
    heights : float64 (h, w)
        Heights around the ring, NaN for pixels without one.
    level, interval : float
        Level of the ring and interval of the levels, in the unit of the heights.
    """
    rows, cols = np.indices(heights.shape)
    inside = heights[shapely.contains_xy(shapely.Polygon(places), cols, rows)]
    inside = inside[~np.isnan(inside)]
    if not len(inside):
        return False
    rise = float(np.abs(inside - level).max()) / interval
    return MIN_RISE <= rise < 1.0
