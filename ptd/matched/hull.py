"""The highest surface below cells that bends down no more than a given curvature, as a stiff cloth from below.

It is the union of all paraboloids of that curvature that fit below the cells: an object narrower than
``2 * sqrt(2 * height / curvature)`` is passed below, terrain that bends less is followed. A paraboloid may cut through
a few cells, so that a clump of blunders does not hold it down. Paraboloids are looked at around their centres alone; on
slopes they are tilted as the terrain is at large, so that their centres lie below what they touch. One tilt serves a
block of cells: in hollows the hull lies a little lower for that. Heights are whole numbers, and nothing beyond a fixed
reach has a part in a cell's answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from ptd.cells import Int32, Int64
from ptd.frame import Scale
from ptd.ground.morphology import Float64
from ptd.kernel import as_int64, kernel
from ptd.matched.cells import CELL_M, EMPTY
from ptd.matched.separable import hull_around_every_cell

CUT_M2 = 3.0
"""What a paraboloid may cut through, one cell at least: a clump of blunders fills no more."""
BLOCK_M = 8.0
"""Side of the blocks of cells that are passed over where their lowest cell is too high to matter, and whose lowest
cells say how the terrain slopes."""
TILT_BLOCKS, ROOFS_TILT_BLOCKS = 1.0, 2.0
"""Standard deviation of the surroundings from which a slope is taken, in blocks; and where there are large roofs yet,
which must not tilt what is looked for below them."""
TILT_RADIUS, MIN_WEIGHT = 5, 1e-3
"""Blocks at which those surroundings end, and the weight of their cells from which on there is a slope."""
LOWEST = -(2**31) + 1
NONE = 2**30
"""Number above the top of any paraboloid and below that of an empty cell: heights are less than 1,000 km."""


@dataclass(frozen=True)
class Envelope:
    """How a hull is made.

    Attributes
    ----------
    curvature : float
        Per metre: 0.04 bends over a circle of 25 m.
    fall_m : float
        Paraboloids are looked at until they have fallen so far.
    cell_m : float
        Side of the cells.
    """

    curvature: float
    fall_m: float
    cell_m: float = CELL_M

    @property
    def cut_cells(self) -> int:
        """Cells that a paraboloid may cut through."""
        return max(1, round(CUT_M2 / self.cell_m**2))

    @property
    def block(self) -> int:
        """Cells on a side of a block."""
        return block_cells(self.cell_m)

    @property
    def radius(self) -> int:
        """Cells that a paraboloid extends from its centre, along rows and columns."""
        return math.ceil(math.sqrt(2 * self.fall_m / self.curvature) / self.cell_m)

    @property
    def stride(self) -> int:
        """Cells between the centres of paraboloids: what is missed between them is less than 4 cm."""
        return max(1, min(4, int(math.sqrt(0.16 / self.curvature) / self.cell_m)))

    @property
    def reach(self) -> int:
        """Cells beyond which nothing has a part in a cell's answer."""
        return self.radius + max(self.radius, self.block * (TILT_RADIUS + 3)) + self.stride

    def falls(self, scale: Scale) -> Int64:
        """Fall of a paraboloid so many cells from its centre along a row: vertical counts, int64 [radius + 1]."""
        steps = self.cell_m * np.arange(self.radius + 1)
        falls: Int64 = np.rint(self.curvature / 2 * steps**2 * scale.counts_z(1.0)).astype(np.int64)
        return falls


def block_cells(cell_m: float) -> int:
    """Cells on a side of a block."""
    return round(BLOCK_M / cell_m)


@kernel
def _block_minima(heights: Int32, block: int) -> Int32:
    rows, columns = heights.shape
    lowest = np.full(((rows + block - 1) // block, (columns + block - 1) // block), EMPTY, np.int32)
    for row in range(rows):
        for column in range(columns):
            b = lowest[row // block, column // block]
            lowest[row // block, column // block] = min(b, heights[row, column])
    return lowest


def tilts(heights: Int32, std_blocks: float, block: int) -> tuple[Int64, Int64]:
    """Slope of the lowest cells of blocks to the north and to the east: vertical counts a cell, int64 by block."""
    lowest, margin = _block_minima(heights, block), TILT_RADIUS + 1
    there = np.pad((lowest != EMPTY).astype(np.float64), margin)
    values = np.pad(np.where(lowest != EMPTY, lowest, 0).astype(np.float64), margin)
    weight = _smooth(there, std_blocks)
    mean = _smooth(values, std_blocks) / np.maximum(weight, 1e-9)
    found = []
    for axis in (0, 1):
        ahead, behind = np.roll(mean, -1, axis), np.roll(mean, 1, axis)
        known = (np.roll(weight, -1, axis) > MIN_WEIGHT) & (np.roll(weight, 1, axis) > MIN_WEIGHT)
        slope = np.where(known, (ahead - behind) / (2 * block), 0.0)
        found.append(np.rint(slope[margin:-margin, margin:-margin]).astype(np.int64))
    return found[0], found[1]


def _smooth(values: Float64, std: float) -> Float64:
    found: Float64 = scipy.ndimage.gaussian_filter(values, std, mode="constant", radius=TILT_RADIUS)
    return found


class _Blocks(NamedTuple):
    """Blocks of so many cells a side: their lowest cells, and how these rise to the north and to the east (`tilts`)."""

    cells: int
    lowest: Int32
    north: Int64
    east: Int64


class _EnvelopeSearch(NamedTuple):
    """Tops of the lowest paraboloids around a centre, and the cells that limit them; room for a number a block."""

    best: Int64
    held: Int64
    falls_east: Int64


@kernel
def _highest_fit(
    heights: Int32, blocks: _Blocks, falls: Int64, r: int, c: int, found: _EnvelopeSearch
) -> None:
    """Tops of the lowest paraboloids around a centre that each one cell limits, in rising order, into ``best``.

    ``held``: the cells that limit them; before, those of the last centre (-1: none). As none that is looked for is
    higher than with these, most blocks are passed over.
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
            c0, c1 = max(bc * block, c - radius), min(bc * block + block, c + radius + 1, columns)
            for rr in range(r0, r1):
                fall = falls[abs(rr - r)] - north * (rr - r)
                for cc in range(c0, c1):
                    value = heights[rr, cc] + fall + falls[abs(cc - c)] - east * (cc - c)
                    if value < limit:  # never in an empty cell
                        k = last
                        while k > 0 and best[k - 1] > value:
                            best[k], held[k] = best[k - 1], held[k - 1]
                            k -= 1
                        best[k], held[k] = value, rr * columns + cc
                        limit = best[last]


@kernel
def _least_fall(falls: Int64, first: int, tilt: int, block: int) -> int:
    """The least that a paraboloid has fallen in a block that begins so many cells from its centre, along one axis."""
    end = first + block - 1
    near = min(max(first, -end, 0), falls.size - 1)
    return int(falls[near]) - max(tilt * first, tilt * end)


@kernel
def _raise(hull: Int32, top: int, profile: Int32) -> None:
    """Heights of a row of the hull, not below those of a paraboloid."""
    for k in range(profile.size):
        hull[k] = max(hull[k], np.int32(np.int32(top) + profile[k]))


@kernel
def _union(
    heights: Int32, blocks: _Blocks, falls: Int64, stride: int, row0: int, column0: int, cut: int
) -> Int32:
    """Height of the highest paraboloid over each cell, LOWEST where there is none."""
    rows, columns = heights.shape
    radius, block = falls.size - 1, blocks.cells
    hull = np.full((rows, columns), LOWEST, np.int32)
    best, held = np.empty(cut + 1, np.int64), np.full(cut + 1, -1, np.int64)
    found = _EnvelopeSearch(best, held, np.empty(blocks.lowest.shape[1], np.int64))
    profile = np.empty(2 * radius + 1, np.int32)
    for r in range(row0, rows, stride):
        for c in range(column0, columns, stride):
            near = False
            for rr in range(r, min(r + stride, rows)):
                for cc in range(c, min(c + stride, columns)):
                    near |= heights[rr, cc] != EMPTY
            if not near:
                continue
            _highest_fit(heights, blocks, falls, r, c, found)
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
    heights: Int32, rule: Envelope, scale: Scale, row: int, column: int, tilt_blocks: float = TILT_BLOCKS
) -> Int32:
    """The hull of a raster of cells.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Vertical counts; `EMPTY` where there is no cell.
    rule : Envelope
    scale : Scale
    row, column : int
        Place of the first cell on its lattice, multiples of a block's cells: centres are anchored there.
    tilt_blocks : float
        Standard deviation of the surroundings that say how the terrain slopes, in blocks.

    Returns
    -------
    int32 [rows, columns]
        Vertical counts; `LOWEST` beyond reach of the cells.
    """
    falls, stride, lowest = rule.falls(scale), rule.stride, _block_minima(heights, rule.block)
    north, east = tilts(heights, tilt_blocks, rule.block)
    if stride == 1:
        return hull_around_every_cell(heights, EMPTY, LOWEST, falls, rule.cut_cells, rule.block, north, east)
    first = -row % stride, -column % stride
    blocks = _Blocks(rule.block, lowest, north, east)
    return _union(heights, blocks, falls, stride, *first, rule.cut_cells)
