"""Coarse raster of the extent of the survey, which distinguishes voids inside it from the area outside.

A coarse cell is occupied if it contains a surface point. Gaps up to a certain width belong to the survey: 20 m, or
more where points are sparse (`gaps_of`). They are closed by a disk of that diameter. Enclosed areas of any width
belong to the survey too. All other cells are outside. Each block is closed separately, with a margin. Its open areas
are joined with those of its neighbours to find the enclosed areas (`tiler.grid.tasks.steps`).

Gaps that are closed, but wider than four times the spacing of the points around them, are places without returns
(`bare_cells`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy

from ptd.arrays import AnyArray, Bool, Float32, Float64, Int64, UInt8
from tiler.core.products import BARE, BEYOND, BORDER, SURVEYED, VOID
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.coarse import (
    Piece,
    block_runs,
    box_around,
    cells_in,
    label_block,
    padded,
    part_of,
    within,
)
from tiler.grid.steps import Counts, Position

LEVELS = 5
"""Number of levels: single cells, and cells merged 2 x 2, 4 x 4, ..."""
BINS_PER_OCTAVE = 16
"""Bins of the logarithm of a count. Each bin of counts up to 20 contains a single count."""

Histogram = list[list[int]]
"""Bin and number of cells, for the cells with returns."""


def merged(values: AnyArray, times: int) -> AnyArray:
    """Return the cells in squares of ``times`` by ``times``, shape (height / times, width / times, times ** 2)."""
    rows, cols = (side // times for side in values.shape)
    return values.reshape(rows, times, cols, times).swapaxes(1, 2).reshape(rows, cols, times**2)


def histograms(counts: Int64) -> list[Histogram]:
    """Return histograms of the returns per cell of a block, one for each level of merging.

    Parameters
    ----------
    counts : int64, shape (height, width)
    """
    level_histograms = []
    for level in range(LEVELS):
        sums = merged(counts, 1 << level).sum(axis=2)
        bins = np.rint(np.log2(sums[sums > 0]) * BINS_PER_OCTAVE).astype(np.int64)
        bin_numbers, cells = np.unique(bins, return_counts=True)
        level_histograms.append(
            [[int(b), int(n)] for b, n in zip(bin_numbers, cells, strict=True)]
        )
    return level_histograms


def usual_returns(found: Iterable[list[Histogram]], enough: float) -> tuple[int, float] | None:
    """Find how many cells to merge so that a cell without returns is significant.

    Parameters
    ----------
    found : iterable of list of Histogram
        The `histograms` of some blocks.
    enough : float
        Least median of the cells with returns.

    Returns
    -------
    (int, float) or None
        Number of cells to merge along a side, and the median of the merged cells with returns; None if no level has a
        large enough median.
    """
    blocks = list(found)
    for level in range(LEVELS):
        bins = np.array([pair for block in blocks for pair in block[level]], np.int64).reshape(
            -1, 2
        )
        if not len(bins):
            return None
        bins = bins[np.argsort(bins[:, 0], kind="stable")]
        cumulative = np.cumsum(bins[:, 1])
        median = float(
            2 ** (bins[np.searchsorted(cumulative, cumulative[-1] / 2), 0] / BINS_PER_OCTAVE)
        )
        if median >= enough:
            return 1 << level, median
    return None


WINDOW = 128
"""Side of the windows in coarse cells, anchored at CRS coordinate 0. Each window has its own
widest gap."""
MIN_GAP = 6
"""Least diameter of the disk in cells, as a smaller disk is not round."""
ENOUGH_CELLS = 4
"""Points are not sparse if occupied squares of half a gap's width have at least this many
occupied cells on average."""
MIN_BARE = 2.0
"""Least distance in cells from a cell in the middle of a place without returns to a cell with points. In a gap of
three cells it is 2."""
BARE_SPACINGS = 4
"""Least width of a place without returns, in spacings of the points, by the rule of many specifications for laser
scans (USGS Lidar Base Specification: data voids)."""
BARE_GAP = -2.0
"""Value of a raster of open areas for a closed cell in a place without returns."""
NO_PIECE = -1.0
"""Value of a raster of open areas for a block that was not written: it is open everywhere."""


def occupancy(points: PointsNear) -> tuple[Float64, Counts]:
    """Return the number of points of each cell, negated if the input classifies more than half of them as water.

    Returns
    -------
    values : float64 (height, width)
    counts : dict
        ``water``: number of cells that are water by the input. ``returns``: histogram of points per cell for each level
        of merging, see `tiler.grid.coverage`.
    """
    counts, water = points.surface_per_pixel()
    wet = 2 * water > counts
    values = np.where(wet, -counts, counts).astype(np.float64)
    return values, {"water": int(wet.sum()), "returns": histograms(counts)}


def margin_of(max_gap: float) -> int:
    """Return the margin in cells around a block that `open_areas` needs."""
    return max(WINDOW, 2 * int(np.ceil(max_gap / 2)) + 2)


def open_areas(
    occupancy: Float32, *, gap: float, max_gap: float, marks_bare: bool
) -> tuple[Float64, Counts]:
    """Label the open areas of a block, which have no points and are not closed gaps; 0 elsewhere.

    Parameters
    ----------
    occupancy : float32 (height + 2 margin, width + 2 margin)
        Result of `occupancy` for the block and `margin_of` cells around it, 0 beyond the raster.
    gap, max_gap : float
        Widest gap in cells where points are dense, and where they are sparse.
    marks_bare : bool
        Whether closed cells in places without returns are marked as `BARE_GAP`.

    Returns
    -------
    values : float64 (height, width)
    counts : dict
        ``sides``, ``labels``: labels along the sides of the block and their number (`tiler.grid.coarse`). ``gaps``:
        pairs of a gap width in cells and the number of windows with it. ``filled``: number of cells.
    """
    pad = margin_of(max_gap)
    counts = np.abs(occupancy)
    occupied = counts != 0
    rows, cols = (side - pad + WINDOW for side in counts.shape)
    # The windows of the block, and one more on each side.
    surroundings = np.s_[pad - WINDOW : rows, pad - WINDOW : cols]
    gaps = gaps_of(occupied[surroundings], gap, max_gap)
    closed = closed_cells(occupied, gaps, pad)
    labels, sides = label_block(~closed, corners=False)
    values = labels.astype(np.float64)
    if marks_bare:
        spacings = spacings_of(counts[surroundings], gaps)
        values[bare_cells(occupied, spacings, pad) & closed] = BARE_GAP
    inner = occupied[pad : len(occupied) - pad, pad : occupied.shape[1] - pad]
    held = inner.reshape(len(gaps), WINDOW, -1, WINDOW).any(axis=(1, 3))
    widths, windows = np.unique(gaps[held], return_counts=True)
    return values, {
        "sides": sides,
        "labels": int(labels.max(initial=0)),
        "gaps": list(zip(widths.tolist(), windows.tolist(), strict=True)),
        "filled": values.size,
    }


def gaps_of(occupied: Bool, gap: float, most: float) -> Float64:
    """Return the widest gap that belongs to the survey in each window, in cells (see `gap_of`).

    Each window is examined together with the eight windows around it.

    Parameters
    ----------
    occupied : bool, shape (height, width)
        Cells of whole windows. The outermost windows are only neighbours.
    gap, most : float
        The usual gap and the widest gap, in cells.

    Returns
    -------
    float64, shape (height / 128 - 2, width / 128 - 2)
    """
    rows, cols = (side // WINDOW - 2 for side in occupied.shape)
    gaps = np.full((rows, cols), min(max(gap, MIN_GAP), most))
    for row, col in np.ndindex(rows, cols):
        near = occupied[row * WINDOW : (row + 3) * WINDOW, col * WINDOW : (col + 3) * WINDOW]
        gaps[row, col] = gap_of(near, gap, most)
    return gaps


def gap_of(occupied: Bool, gap: float, most: float) -> float:
    """Return the widest gap of a survey in cells: the usual one, doubled until points are not sparse in it.

    Parameters
    ----------
    occupied : bool, shape (height, width)
    gap, most : float
        The usual gap and the widest gap, in cells.
    """
    gap = max(gap, MIN_GAP)
    n_occupied = np.count_nonzero(occupied)
    while gap < most and n_occupied:
        squares = occupied
        for axis, length in enumerate(occupied.shape):
            squares = np.logical_or.reduceat(
                squares, np.arange(0, length, int(gap / 2)), axis=axis
            )
        if n_occupied >= ENOUGH_CELLS * np.count_nonzero(squares):
            break
        gap *= 2
    return min(gap, most)


def spacings_of(counts: Float32, gaps: Float64) -> Float64:
    """Return the mean spacing of the points in each window and the eight around it, in cells; infinite without points.

    The area of the points is that of occupied squares of half a gap's width, as in `gap_of`.

    Parameters
    ----------
    counts : float32, shape (height, width)
        Number of points in the cells of whole windows. The outermost windows are only neighbours.
    gaps : float64, shape (height / 128 - 2, width / 128 - 2)
        See `gaps_of`.
    """
    spacings = np.full(gaps.shape, np.inf)
    for row, col in np.ndindex(gaps.shape):
        near = counts[row * WINDOW : (row + 3) * WINDOW, col * WINDOW : (col + 3) * WINDOW]
        side = max(int(gaps[row, col] / 2), 1)
        squares = near
        for axis, length in enumerate(near.shape):
            squares = np.add.reduceat(squares, np.arange(0, length, side), axis=axis)
        if n_points := float(squares.sum()):
            spacings[row, col] = np.sqrt(np.count_nonzero(squares) * side**2 / n_points)
    return spacings


def bare_cells(occupied: Bool, spacings: Float64, pad: int) -> Bool:
    """Return a mask of the cells of a block in gaps without points that are wider than `BARE_SPACINGS` spacings.

    Parameters
    ----------
    occupied : bool, shape (height + 2 pad, width + 2 pad)
    spacings : float64, shape (height / 128, width / 128)
        See `spacings_of`.
    pad : int
        Margin around the block in cells.
    """
    # The middle of a gap of n cells is (n + 1) / 2 cells from cells with points.
    depths = np.clip(BARE_SPACINGS / 2 * spacings + 0.5, MIN_BARE, pad / 2)
    depth = np.pad(np.kron(depths, np.ones((WINDOW, WINDOW))), pad, mode="edge")
    if not occupied.any():
        return np.zeros(spacings.shape, np.bool_).repeat(WINDOW, 0).repeat(WINDOW, 1)
    middle = scipy.ndimage.distance_transform_edt(~occupied) >= depth
    inner = np.s_[pad:-pad, pad:-pad]
    if not middle.any():
        return middle[inner]
    bare: Bool = ~occupied & (scipy.ndimage.distance_transform_edt(~middle) < depth)
    return bare[inner]


def closed_cells(occupied: Bool, gaps: Float64, pad: int) -> Bool:
    """Return a mask of the cells of a block that have points or lie in a gap that belongs to the survey.

    Parameters
    ----------
    occupied : bool, shape (height + 2 pad, width + 2 pad)
    gaps : float64, shape (height / 128, width / 128)
        See `gaps_of`.
    pad : int
        Margin around the block in cells.
    """
    closed = occupied[pad : len(occupied) - pad, pad : occupied.shape[1] - pad].copy()
    if not occupied.any():
        return closed
    gap_of_cell = np.kron(gaps, np.ones((WINDOW, WINDOW)))
    for gap in np.unique(gaps):
        radius = gap / 2
        filled = within(occupied, radius)
        part = box_around(filled, 1)  # no cell beyond it is filled
        filled[part] = ~within(~filled[part], radius)
        closed |= filled[pad : len(occupied) - pad, pad : occupied.shape[1] - pad] & (
            gap_of_cell == gap
        )
    return closed


def survey(
    opened: Float64,
    place: Position,
    products: RasterSpec,
    *,
    outside: list[Piece],
    empty: list[tuple[int, int]],
) -> tuple[Float64, Counts]:
    """Return the survey (see `tiler.core.products.BEYOND`).

    Parameters
    ----------
    opened : float64 (height + 2, width + 2)
        Result of `open_areas` for the block and one cell on each side.
    place : Position
    products : RasterSpec
        Raster of the products.
    outside : list of Piece
        Open areas of this block and of its neighbours that are not enclosed by the survey.
    empty : list of (row, column)
        First row and column of each missing block, among this block and its neighbours, that the survey encloses.

    Returns
    -------
    values : float64 (height, width)
    counts : dict
        ``inside``, ``cells``: number of cells inside the survey, and of all cells. ``blocks``: runs of the blocks of
        the products that overlap the inside (`coarse.block_runs`).
    """
    window = padded(place.block, 1)
    enclosed = (opened > 0) & ~cells_in(opened, window, outside)
    for first_cell in empty:
        enclosed[part_of(window, *first_cell)] = True
    bare = opened == BARE_GAP
    values = survey_values((opened == 0) | bare, enclosed, bare)[1:-1, 1:-1]
    inside = values >= SURVEYED
    cells = place.spec.window(place.block)
    return values.astype(np.float64), {
        "inside": int(inside.sum()),
        "cells": values.size,
        "blocks": block_runs(inside, cells, products, BLOCK_PIXELS),
    }


def survey_values(closed: Bool, enclosed: Bool, bare: Bool) -> UInt8:
    """Return the values of the cells of a survey, see `tiler.core.products.BEYOND`.

    Parameters
    ----------
    closed, enclosed, bare : bool, shape (height, width)
        Cells with points or in narrow gaps, cells that are enclosed by them, and closed cells far from returns.
    """
    whole = closed | enclosed
    inner = scipy.ndimage.binary_erosion(whole, np.ones((3, 3), np.bool_))
    values = np.select(
        [inner & ~closed, inner & bare, inner, whole], [VOID, BARE, SURVEYED, BORDER], BEYOND
    )
    return values.astype(np.uint8)
