"""The highest surface below cells that bends down no more than a given curvature, like a stiff cloth from below.

The hull is the union of all paraboloids of this curvature that fit below the cells. It passes
below objects narrower than ``2 * sqrt(2 * height / curvature)`` and follows terrain that bends
less. A paraboloid may cut through a few cells, so that a clump of blunders does not hold it
down. Paraboloids are computed up to a limited distance from their centres. On slopes they are
tilted like the terrain at large, so that their centres lie below the cells that they touch. All
paraboloids with centres in a block of cells have one tilt, so the hull lies a little lower in
hollows. Heights are whole numbers, and cells beyond a fixed distance do not change the hull at
a cell.

If every cell is a centre, the hull is computed by rows (`_hull_around_every_cell`). The fall of a
paraboloid is the sum of a fall along the row and one along the column. So the cells that limit
paraboloids are found along rows first and then across them, and the hull is raised across rows
first and then along them. For ``w`` cells across this takes about ``2 * w`` steps instead of
``w * w``, each for a whole row of centres. Few centres far apart are computed separately.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Float64, Int32, Int64
from ptd.frame import Scale
from ptd.kernel import as_int64, kernel
from ptd.matched.cells import CELL_M, EMPTY

CUT_M2 = 3.0
"""Area that a paraboloid may cut through, at least one cell: a clump of blunders fills no
more."""
BLOCK_M = 8.0
"""Side of the blocks of cells. A block whose lowest cell is too high to matter is skipped. The
lowest cells of blocks give the slope of the terrain."""
TILT_BLOCKS, ROOFS_TILT_BLOCKS = 1.0, 2.0
"""Standard deviation, in blocks, of the surroundings from which a slope is computed. The second
is for cells that still contain large roofs, which must not tilt the hull below them."""
TILT_RADIUS, MIN_WEIGHT = 5, 1e-3
"""Distance in blocks at which those surroundings end, and weight of their cells above which
there is a slope."""
LOWEST = -(2**31) + 1
"""Height of the hull where there is no paraboloid."""
NONE = 2**30
"""Number above the top of any paraboloid and below that of an empty cell: heights are less than
1,000 km."""


@dataclass(frozen=True)
class Envelope:
    """Settings of a hull.

    Attributes
    ----------
    curvature : float
        Curvature of the paraboloids per metre: 0.04 is a radius of curvature of 25 m.
    fall_m : float
        Fall in metres, from the top, at which paraboloids end.
    cell_m : float
        Size of the cells in metres.
    """

    curvature: float
    fall_m: float
    cell_m: float = CELL_M

    @property
    def cut_cells(self) -> int:
        """Number of cells that a paraboloid may cut through."""
        return max(1, round(CUT_M2 / self.cell_m**2))

    @property
    def block(self) -> int:
        """Number of cells on a side of a block."""
        return block_cells(self.cell_m)

    @property
    def radius(self) -> int:
        """Number of cells that a paraboloid extends from its centre, along rows and columns."""
        return math.ceil(math.sqrt(2 * self.fall_m / self.curvature) / self.cell_m)

    @property
    def stride(self) -> int:
        """Number of cells between the centres of paraboloids, which changes the hull by less than 4 cm."""
        return max(1, min(4, int(math.sqrt(0.16 / self.curvature) / self.cell_m)))

    @property
    def reach(self) -> int:
        """Distance in cells beyond which heights do not change the hull at a cell."""
        return self.radius + max(self.radius, self.block * (TILT_RADIUS + 3)) + self.stride

    def falls(self, scale: Scale) -> Int64:
        """Return the fall of a paraboloid by cells from its centre along a row: vertical counts, int64 [radius + 1]."""
        steps = self.cell_m * np.arange(self.radius + 1)
        falls: Int64 = np.rint(self.curvature / 2 * steps**2 * scale.counts_z(1.0)).astype(
            np.int64
        )
        return falls


def block_cells(cell_m: float) -> int:
    """Return the number of cells on a side of a block."""
    return round(BLOCK_M / cell_m)


@kernel
def _block_minima(heights: Int32, block: int) -> Int32:
    rows, columns = heights.shape
    lowest = np.full(
        ((rows + block - 1) // block, (columns + block - 1) // block), EMPTY, np.int32
    )
    for row in range(rows):
        for column in range(columns):
            b = lowest[row // block, column // block]
            lowest[row // block, column // block] = min(b, heights[row, column])
    return lowest


def tilts(heights: Int32, std_blocks: float, block: int) -> tuple[Int64, Int64]:
    """Return the slopes to the north and to the east of the lowest cells of blocks.

    Slopes are vertical counts per cell: int64 by block.
    """
    lowest, margin = _block_minima(heights, block), TILT_RADIUS + 1
    there = np.pad((lowest != EMPTY).astype(np.float64), margin)
    values = np.pad(np.where(lowest != EMPTY, lowest, 0).astype(np.float64), margin)
    weight = _smooth(there, std_blocks)
    mean = _smooth(values, std_blocks) / np.maximum(weight, 1e-9)
    slopes = []
    for axis in (0, 1):
        ahead, behind = np.roll(mean, -1, axis), np.roll(mean, 1, axis)
        known = (np.roll(weight, -1, axis) > MIN_WEIGHT) & (
            np.roll(weight, 1, axis) > MIN_WEIGHT
        )
        slope = np.where(known, (ahead - behind) / (2 * block), 0.0)
        slopes.append(np.rint(slope[margin:-margin, margin:-margin]).astype(np.int64))
    return slopes[0], slopes[1]


def _smooth(values: Float64, std: float) -> Float64:
    return scipy.ndimage.gaussian_filter(values, std, mode="constant", radius=TILT_RADIUS)


class _Blocks(NamedTuple):
    """Blocks of cells: cells on a side, lowest cell of each block, and slopes to the north and east (`tilts`)."""

    cells: int
    lowest: Int32
    north: Int64
    east: Int64


class _EnvelopeSearch(NamedTuple):
    """Buffers: tops of the lowest paraboloids at a centre, cells that limit them, least fall per column of blocks."""

    best: Int64
    held: Int64
    falls_east: Int64


@kernel
def _lowest_limits(
    heights: Int32, blocks: _Blocks, falls: Int64, r: int, c: int, found: _EnvelopeSearch
) -> None:
    """Find the lowest paraboloids around a centre, each limited by one cell, in rising order.

    ``best`` gets their tops and ``held`` the cells that limit them (-1: none). On entry ``held`` has the cells of the
    last centre. These cells give an upper limit of the tops, so most blocks can be skipped.
    """
    block, lowest = blocks.cells, blocks.lowest
    north, east = blocks.north[r // block, c // block], blocks.east[r // block, c // block]
    best, held, falls_east = found
    rows, columns = heights.shape
    radius, last = falls.size - 1, best.size - 1
    limit = as_int64(LOWEST)
    for k in range(last + 1):
        dr, dc = held[k] // columns - r, held[k] % columns - c
        if held[k] < 0 or abs(dr) > radius or abs(dc) > radius:
            limit = as_int64(NONE)
            break
        top = heights[r + dr, c + dc] + falls[abs(dr)] + falls[abs(dc)] - north * dr - east * dc
        limit = max(limit, min(as_int64(top + 1), as_int64(NONE)))
    best[:], held[:] = limit, -1
    west, east_end = max(c - radius, 0) // block, min(c + radius, columns - 1) // block + 1
    for bc in range(west, east_end):
        falls_east[bc] = _least_fall(falls, bc * block - c, east, block)
    for br in range(max(r - radius, 0) // block, min(r + radius, rows - 1) // block + 1):
        least = _least_fall(falls, br * block - r, north, block)
        r0, r1 = max(br * block, r - radius), min(br * block + block, r + radius + 1, rows)
        for bc in range(west, east_end):
            if lowest[br, bc] + least + falls_east[bc] >= limit:
                continue
            c0, c1 = (
                max(bc * block, c - radius),
                min(bc * block + block, c + radius + 1, columns),
            )
            for rr in range(r0, r1):
                fall = falls[abs(rr - r)] - north * (rr - r)
                for cc in range(c0, c1):
                    value = heights[rr, cc] + fall + falls[abs(cc - c)] - east * (cc - c)
                    if value < limit:  # An empty cell is higher than any limit.
                        k = last
                        while k > 0 and best[k - 1] > value:
                            best[k], held[k] = best[k - 1], held[k - 1]
                            k -= 1
                        best[k], held[k] = value, rr * columns + cc
                        limit = best[last]


@kernel
def _least_fall(falls: Int64, first: int, tilt: int, block: int) -> int:
    """Return the least fall of a paraboloid in a block, along one axis.

    ``first`` is the position of the block's first cell, counted from the centre of the paraboloid.
    """
    end = first + block - 1
    near = min(max(first, -end, 0), falls.size - 1)
    return int(falls[near]) - max(tilt * first, tilt * end)


@kernel
def _raise(hull: Int32, top: int, profile: Int32) -> None:
    for k in range(profile.size):
        hull[k] = max(hull[k], np.int32(np.int32(top) + profile[k]))


@kernel
def _union(
    heights: Int32,
    blocks: _Blocks,
    falls: Int64,
    stride: int,
    row0: int,
    column0: int,
    cut: int,
) -> Int32:
    """Return the height of the highest paraboloid over each cell, or LOWEST where there is none."""
    rows, columns = heights.shape
    radius, block = falls.size - 1, blocks.cells
    hull = np.full((rows, columns), LOWEST, np.int32)
    best, held = np.empty(cut + 1, np.int64), np.full(cut + 1, -1, np.int64)
    search = _EnvelopeSearch(best, held, np.empty(blocks.lowest.shape[1], np.int64))
    profile = np.empty(2 * radius + 1, np.int32)
    for r in range(row0, rows, stride):
        for c in range(column0, columns, stride):
            near = False
            for rr in range(r, min(r + stride, rows)):
                for cc in range(c, min(c + stride, columns)):
                    near |= heights[rr, cc] != EMPTY
            if not near:
                continue
            _lowest_limits(heights, blocks, falls, r, c, search)
            if held[cut] < 0:
                continue
            n, e = blocks.north[r // block, c // block], blocks.east[r // block, c // block]
            for k in range(profile.size):
                profile[k] = e * (k - radius) - falls[abs(k - radius)]
            c0, c1 = max(c - radius, 0), min(c + radius + 1, columns)
            for rr in range(max(r - radius, 0), min(r + radius + 1, rows)):
                top = best[cut] - falls[abs(rr - r)] + n * (rr - r)
                _raise(hull[rr, c0:c1], top, profile[c0 - c + radius : c1 - c + radius])
    return hull


def lower_envelope(
    heights: Int32,
    envelope: Envelope,
    scale: Scale,
    row: int,
    column: int,
    tilt_blocks: float = TILT_BLOCKS,
) -> Int32:
    """Compute the hull below a raster of cells.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights in vertical counts; `EMPTY` where there is no cell.
    envelope : Envelope
    scale : Scale
    row, column : int
        Row and column of the first cell on the lattice, multiples of `Envelope.block`. Centres of paraboloids lie at
        multiples of the stride on this lattice.
    tilt_blocks : float
        Standard deviation, in blocks, of the surroundings from which the slope of the terrain is computed.

    Returns
    -------
    int32 [rows, columns]
        Heights of the hull in vertical counts; `LOWEST` where there is no paraboloid.
    """
    falls, stride, lowest = (
        envelope.falls(scale),
        envelope.stride,
        _block_minima(heights, envelope.block),
    )
    north, east = tilts(heights, tilt_blocks, envelope.block)
    if stride == 1:
        return _hull_around_every_cell(
            heights, EMPTY, LOWEST, falls, envelope.cut_cells, envelope.block, north, east
        )
    first = -row % stride, -column % stride
    blocks = _Blocks(envelope.block, lowest, north, east)
    return _union(heights, blocks, falls, stride, *first, envelope.cut_cells)


HIGH, LOW = 2**30 + 2**29, -(2**30) - 2**29
"""Height of a missing cell, and of a missing paraboloid. They stay beyond real heights (less
than 1,000 km) after any fall or tilt is added."""
LIMIT = 2**30
"""Limit of real heights: values from `LIMIT` on, or down from `-LIMIT`, stand for none."""


@kernel
def _keep_lowest(lowest: Int32, values: Int32, first: int) -> None:
    """Insert one value per column into its sorted list of lowest values. Row 0 has the lowest.

    The rows before ``first`` must not be higher than the values. ``values`` is changed.
    """
    for k in range(first, lowest.shape[0]):
        row = lowest[k]
        for c in range(values.size):
            low = min(row[c], values[c])
            values[c] = max(row[c], values[c])
            row[c] = low


@kernel
def _tilted(out: Int32, values: Int32, fall: int, tilt: Int32, step: int) -> None:
    """Write to ``out`` values plus the fall of a paraboloid ``step`` cells from its centre, minus its block's tilt."""
    more, steps = np.int32(fall), np.int32(step)
    for c in range(out.size):
        out[c] = np.int32(values[c] + more) - np.int32(tilt[c] * steps)


@kernel
def _raise_row(highest: Int32, values: Int32) -> None:
    for c in range(values.size):
        highest[c] = max(highest[c], values[c])


@kernel
def _tops(
    padded: Int32, falls: Int64, cut: int, n_rows: int, north: Int32, east: Int32
) -> Int32:
    """Return the top of the paraboloid around each cell of some rows that cuts through ``cut`` cells.

    Tops from LIMIT on stand for no paraboloid.
    """
    radius, columns = falls.size - 1, north.size
    along = np.full((n_rows + 2 * radius, cut + 1, columns), HIGH, np.int32)
    values = np.empty(columns, np.int32)
    for row in range(along.shape[0]):
        for step in range(-radius, radius + 1):
            _tilted(
                values,
                padded[row, radius + step : radius + step + columns],
                falls[abs(step)],
                east,
                step,
            )
            _keep_lowest(along[row], values, 0)
    tops = np.empty((n_rows, columns), np.int32)
    for row in range(n_rows):
        lowest = np.full((cut + 1, columns), HIGH, np.int32)
        for step in range(-radius, radius + 1):
            for k in range(cut + 1):
                _tilted(values, along[row + radius + step, k], falls[abs(step)], north, step)
                _keep_lowest(lowest, values, k)
        tops[row] = lowest[cut]
    return tops


@kernel
def _spread(hull: Int32, tops: Int32, falls: Int64, north: Int32, east: Int32) -> None:
    """Raise a hull (with a margin of the radius all around) to the paraboloids around the cells of some rows."""
    radius, (n_rows, columns) = falls.size - 1, tops.shape
    values, across = np.empty(columns, np.int32), np.empty(columns, np.int32)
    for row in range(n_rows + 2 * radius):
        across[:] = LOW
        for centre in range(max(row - 2 * radius, 0), min(row + 1, n_rows)):
            step = centre + radius - row
            _tilted(values, tops[centre], -falls[abs(step)], north, step)
            _raise_row(across, values)
        for step in range(-radius, radius + 1):
            _tilted(values, across, -falls[abs(step)], east, -step)
            _raise_row(hull[row, radius + step : radius + step + columns], values)


@kernel
def _hull_around_every_cell(
    heights: Int32,
    empty: int,
    none: int,
    falls: Int64,
    cut: int,
    block: int,
    north: Int64,
    east: Int64,
) -> Int32:
    """Return the height of the highest paraboloid over each cell.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights in vertical counts; ``empty`` where there is no cell.
    empty, none : int
        Height of an empty cell, and height of the hull where there is no paraboloid.
    falls : int64 [radius + 1]
        Fall of a paraboloid in vertical counts, by cells from its centre along a row.
    cut : int
        Number of cells that a paraboloid may cut through.
    block : int
        Side in cells of the blocks, each of which has one tilt.
    north, east : int64 [blocks of rows, blocks of columns]
        Tilts of the blocks in vertical counts per cell.

    Returns
    -------
    int32 [rows, columns]
        Heights of the hull in vertical counts.
    """
    (rows, columns), radius = heights.shape, falls.size - 1
    padded = np.full((rows + 2 * radius, columns + 2 * radius), HIGH, np.int32)
    hull = np.full(padded.shape, LOW, np.int32)
    for r in range(rows):
        for c in range(columns):
            if heights[r, c] != empty:
                padded[r + radius, c + radius] = heights[r, c]
    for first in range(0, rows, block):
        block_heights = heights[first : first + block]
        west, end = columns, 0
        for r in range(block_heights.shape[0]):
            for c in range(columns):
                if block_heights[r, c] != empty:
                    west, end = min(west, c), max(end, c + 1)
        if west >= end:
            continue
        block_heights = block_heights[:, west:end]
        n, e = np.empty(end - west, np.int32), np.empty(end - west, np.int32)
        for c in range(west, end):
            n[c - west], e[c - west] = (
                north[first // block, c // block],
                east[first // block, c // block],
            )
        south, north_end, east_end = (
            first,
            first + block_heights.shape[0] + 2 * radius,
            end + 2 * radius,
        )
        tops = _tops(
            padded[south:north_end, west:east_end], falls, cut, block_heights.shape[0], n, e
        )
        for r in range(block_heights.shape[0]):
            for c in range(end - west):
                if block_heights[r, c] == empty or tops[r, c] >= LIMIT:
                    tops[r, c] = LOW
        _spread(hull[south:north_end, west:east_end], tops, falls, n, e)
    hull_heights = np.empty((rows, columns), np.int32)
    for r in range(rows):
        for c in range(columns):
            height = hull[r + radius, c + radius]
            hull_heights[r, c] = height if height > -LIMIT else none
    return hull_heights
