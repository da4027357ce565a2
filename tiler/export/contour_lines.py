"""Contours of a raster that is seen one block at a time: lines of a block, and lines joined across blocks.

A line runs from one edge between two neighbouring pixel centres to the next. A vertex is known by its edge and computed
from the two heights at the edge's ends alone, so both blocks beside a border find the same one, and lines join exactly.

Of lines that are short rings, those around small tops and pits are drawn; the noise of the heights is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import scipy
import shapely

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

OFF_LEVEL = 1e-6
"""Part of the interval: heights that are nearer to a level are put this far above it. So lines never run through a
pixel centre, where they would touch, and go around a lake that lies exactly on a level."""

SHORT = 10.0
"""Pixels: shorter rings are drawn only around a top or a pit."""
MIN_RISE = 0.5
"""Share of the interval by which the ground inside of a short ring differs from its level, if it is drawn."""

LINES_OF_RELIEF = 50
"""Levels at most over the relief of a run where the user names no interval."""
TIMES_NOISE = 4
"""Times the noise of the ground that lines lie apart at least, where the user names no interval."""
STEPS = (1, 2, 5)
"""Intervals are one of these times a power of ten."""

REACH_SIGMAS = 3
"""Standard deviations at which the weights of the smoothing end."""

MAX_HELD_VERTICES = 4_000_000
"""Vertices of unfinished lines that are held at once; beyond it the longest are cut."""

Key = tuple[int, int, int, int]
"""Name of a vertex: level, row and column of the first pixel (from the north-west) of the edge on which it lies, and 1
if that edge runs south, 0 if it runs east."""


@dataclass(frozen=True)
class Piece:
    """A contour line within a block, higher ground to one side all along.

    Attributes
    ----------
    start, end : Key
        Equal where the line is closed.
    places : float64 (n, 2)
        Column and row of each vertex, in pixels from the centre of the raster's north-west pixel.
    """

    start: Key
    end: Key
    places: Floats


def default_interval(relief: float, floor: Fraction, noise: float = 0.0) -> Fraction:
    """The smallest round interval of `LINES_OF_RELIEF` levels at most that is no finer than the heights are accurate.

    Parameters
    ----------
    relief : float
        Between low and high ground, in the unit of the heights, as all that follows.
    floor : Fraction
        The smallest interval.
    noise : float
        Standard deviation of the heights: an interval has `TIMES_NOISE` of it.
    """
    least = max(relief / LINES_OF_RELIEF, TIMES_NOISE * noise)
    if least <= floor:
        return floor
    power = math.floor(math.log10(least)) - 1
    steps = (Fraction(step) * Fraction(10) ** (power + more) for more in range(4) for step in STEPS)
    return next(step for step in steps if float(step) >= least)


def smoothing_reach(sigma: float) -> int:
    """Pixels around a block that `smoothed` needs, for a standard deviation in pixels."""
    return math.ceil(REACH_SIGMAS * sigma)


def smoothed(heights: Floats, sigma: float) -> Floats:
    """Heights averaged by a Gaussian of ``sigma`` pixels; what has no height (NaN) has no weight and gets none."""
    if sigma <= 0:
        return heights
    reach = smoothing_reach(sigma)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    known = ~np.isnan(heights)
    total, weight = np.where(known, heights, 0.0), known.astype(np.float64)
    for axis in (0, 1):
        total = scipy.ndimage.correlate1d(total, weights, axis=axis, mode="constant")
        weight = scipy.ndimage.correlate1d(weight, weights, axis=axis, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known, total / weight, np.nan)


def contour_block(heights: Floats, interval: Fraction, row: int, col: int) -> Iterator[Piece]:
    """Lines between the pixel centres of a block, level by level from the lowest; none beside a pixel without height.

    Parameters
    ----------
    heights : float64 (h, w)
        NaN where there is none. A block shares its last row and column with those to the south and east of it.
    interval : Fraction
        Levels are its multiples, in the unit of the heights.
    row, col : int
        Of the block's first pixel in the raster.
    """
    from contourpy import LineType, contour_generator

    if min(heights.shape) < 2 or np.isnan(heights).all():
        return
    step = float(interval)
    level = np.rint(heights / step)
    heights = np.where(np.abs(heights / step - level) < OFF_LEVEL, (level + OFF_LEVEL) * step, heights)
    lines = contour_generator(
        z=np.ma.masked_invalid(heights), name="serial", corner_mask=False, line_type=LineType.Separate
    )
    for number in range(math.ceil(np.nanmin(heights) / step), math.floor(np.nanmax(heights) / step) + 1):
        height = float(number * interval)
        for line in lines.lines(height):
            rows, cols, down = _edges(np.asarray(line))
            part = _part(heights, height, rows, cols, down)
            rows, cols = rows + row, cols + col
            first, last = ((number, int(rows[i]), int(cols[i]), int(down[i])) for i in (0, -1))
            yield Piece(first, last, np.stack((cols + (1 - down) * part, rows + down * part), axis=1))


def _edges(line: Floats) -> tuple[Ints, Ints, Ints]:
    """Row and column of the first pixel of the edge on which each vertex (x, y) lies, and whether that runs south.

    One of the two is whole but for rounding, which is far smaller than what `OFF_LEVEL` leaves of the other.
    """
    nearest = np.rint(line)
    off = np.abs(line - nearest)
    down = off[:, 0] < off[:, 1]
    cols = np.where(down, nearest[:, 0], np.floor(line[:, 0])).astype(np.int64)
    rows = np.where(down, np.floor(line[:, 1]), nearest[:, 1]).astype(np.int64)
    return rows, cols, down.astype(np.int64)


def _part(heights: Floats, level: float, rows: Ints, cols: Ints, down: Ints) -> Floats:
    """How far along its edge each vertex lies, from the heights at both ends, in the order of the raster."""
    first, second = heights[rows, cols], heights[rows + down, cols + 1 - down]
    part: Floats = (level - first) / (second - first)
    return part


@dataclass
class _Line:
    """A line that may go on at both ends."""

    start: Key
    end: Key
    parts: list[Floats]
    n: int


@dataclass
class Joiner:
    """Joins the pieces of blocks that come row by row from the north-west, each row from the west.

    Attributes
    ----------
    max_held : int
        Vertices of unfinished lines; beyond it the longest are given back as they are, and go on as new lines.
    cut : int
        How often that happened.
    """

    max_held: int = MAX_HELD_VERTICES
    cut: int = 0
    _starts: dict[Key, _Line] = field(default_factory=dict)
    _ends: dict[Key, _Line] = field(default_factory=dict)
    _held: int = 0

    def add(self, piece: Piece) -> Iterator[tuple[int, Floats]]:
        """Take a piece; the line, level and places, that it completes to a ring."""
        if piece.start == piece.end:
            yield piece.start[0], _from_least(piece.places)
            return
        line = _Line(piece.start, piece.end, [piece.places], len(piece.places))
        self._held += line.n
        before = self._ends.pop(piece.start, None)
        if before is not None:
            self._forget(before)
            line = _Line(before.start, line.end, [*before.parts, line.parts[0][1:]], before.n + line.n - 1)
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

    def end_row(self, last_row: int) -> Iterator[tuple[int, Floats]]:
        """Lines that no later block can go on with, after a row of blocks down to the pixel row ``last_row``."""

        def waits(key: Key) -> bool:
            return key[1] == last_row and key[3] == 0

        done = [line for line in self._starts.values() if not (waits(line.start) or waits(line.end))]
        for line in done:
            yield self._given(line)
        if self._held > self.max_held:
            for line in sorted(self._starts.values(), key=lambda held: (-held.n, held.start)):
                self.cut += 1
                yield self._given(line)
                if self._held <= self.max_held // 2:
                    break

    def _given(self, line: _Line) -> tuple[int, Floats]:
        self._forget(line)
        self._held -= line.n
        return line.start[0], np.concatenate(line.parts)

    def _forget(self, line: _Line) -> None:
        self._starts.pop(line.start, None)
        self._ends.pop(line.end, None)


def _from_least(places: Floats) -> Floats:
    """A ring that starts at its westernmost vertex, so that it does not depend on the order of the blocks."""
    ring = places[:-1]
    first = int(np.lexsort((ring[:, 1], ring[:, 0]))[0])
    return np.concatenate((ring[first:], ring[: first + 1]))


def is_short(places: Floats) -> bool:
    """Whether a line, of places (column, row) in pixels, is closed and shorter than `SHORT`."""
    if len(places) > 4 * SHORT or not (places[0] == places[-1]).all():
        return False
    return bool(np.hypot(*np.diff(places, axis=0).T).sum() < SHORT)


def stays(places: Floats, heights: Floats, level: float, interval: float) -> bool:
    """Whether a short ring is the only one of a top or pit that differs from its level by `MIN_RISE` intervals.

    Parameters
    ----------
    places : float64 (n, 2)
        Column and row of its vertices in `heights`.
    heights : float64 (h, w)
        NaN where there is none.
    level, interval : float
        In the unit of the heights.
    """
    rows, cols = np.indices(heights.shape)
    inside = heights[shapely.contains_xy(shapely.Polygon(places), cols, rows)]
    inside = inside[~np.isnan(inside)]
    if not len(inside):
        return False
    rise = float(np.abs(inside - level).max()) / interval
    return MIN_RISE <= rise < 1.0
