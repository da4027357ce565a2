"""Places where the terrain lies far above all returns, so that it is certainly wrong, or far below them."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import scipy

from ptd.gridding.above_ground import NOTHING
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, Block
from tiler.grid.block_surroundings import EditsNear, PointsNear, WatersNear
from tiler.grid.coarse import label_block
from tiler.grid.steps import Counts

Bools = npt.NDArray[np.bool_]
Heights = npt.NDArray[np.float64]

ABOVE_M = 1.0
"""Height above the highest return of its pixel from which terrain counts as wrong."""
MIN_PLACE_M2 = Fraction(10)
"""Least area of a place. In smaller ones, the returns are often noise that the filter missed."""
BELOW_M = 2.0
"""Height of the lowest return of a pixel above the terrain from which the terrain counts as below all returns."""
CELLS_PER_BLOCK = 4
"""Number of cells along the side of a block in which pixels below all returns are counted."""


def above(
    points: PointsNear,
    terrain: Heights,
    waters: WatersNear,
    edits: EditsNear,
    *,
    reach: int,
    spike: Fraction,
    least: int,
) -> tuple[None, Counts]:
    """Find the places in a block where the terrain lies above all returns.

    Places are pixels that touch at sides or corners. Those count that are large enough or that touch a side of the
    block, as they may continue in the next one.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height + 2, width + 2)
        Terrain of the block and of one pixel on each side.
    waters : WatersNear
    edits : EditsNear
    reach, spike
        See `PointsNear.returns`.
    least : int
        Number of pixels of the smallest place.

    Returns
    -------
    None
    counts : dict
        ``wrong``: number of pixels in which the terrain is above all returns, also of those in places that are too
        small. ``labels``, ``sides``: number of places, and their labels along the sides of the block (see
        `tiler.grid.coarse`). ``places``: [pixels, row, col, last_row, last_col, height] of each place, with the
        largest height of its terrain above the returns in metres. ``cells``: see `_cells`.
    """
    above_m, below_m = heights_above(points, terrain, waters.inside | edits.flat, reach, spike)
    wrong = above_m > ABOVE_M
    labels, sides = label_block(_listed(wrong, least), corners=True)
    numbers = np.arange(1, int(labels.max(initial=0)) + 1)
    sizes = np.bincount(labels.ravel(), minlength=len(numbers) + 1)[1:]
    largest = scipy.ndimage.maximum(above_m, labels, numbers) if len(numbers) else ()
    places, block = [], points.block
    for size, height, (rows, cols) in zip(
        sizes, largest, scipy.ndimage.find_objects(labels), strict=True
    ):
        first = block.row + rows.start, block.col + cols.start
        last = block.row + rows.stop - 1, block.col + cols.stop - 1
        places.append([int(size), *first, *last, round(float(height), 3)])
    return None, {
        "wrong": int(np.count_nonzero(wrong)),
        "labels": len(places),
        "sides": sides,
        "places": places,
        "cells": _cells(block, below_m),
    }


def _cells(block: Block, below_m: Heights) -> list[list[int]]:
    """Return row and column of each cell, its number of known pixels, and of those below all returns."""
    side, cells = BLOCK_PIXELS // CELLS_PER_BLOCK, []
    for row in range(0, block.height, side):
        for col in range(0, block.width, side):
            part = below_m[row : row + side, col : col + side]
            if known := int(np.count_nonzero(~np.isnan(part))):
                counts = known, int(np.count_nonzero(part > BELOW_M))
                cells.append([block.row + row, block.col + col, *counts])
    return cells


def heights_above(
    points: PointsNear, wider: Heights, excluded: Bools, reach: int, spike: Fraction
) -> tuple[Heights, Heights]:
    """Return the metres of the terrain of each pixel above the highest return, and below the lowest one.

    The terrain is that at the lowest corner of the pixel for the first, at the highest for the second.

    Pixels without a return or without terrain have 0 and NaN. So have ``excluded`` pixels: those of water, whose low
    returns are noise, and of edits that set a height. Other parameters are those of `above`.
    """
    highest, lowest = points.returns(points.block, reach, spike)
    returns, terrain = highest[..., 2], wider[1:-1, 1:-1]
    known = (returns != NOTHING) & ~np.isnan(terrain) & ~excluded
    half, metres = _half_rise(wider), float(points.frame.units.vertical)
    above = terrain - half - returns / COUNTS_PER_UNIT
    below = lowest / COUNTS_PER_UNIT - terrain - half
    return np.where(known, above * metres, 0.0), np.where(known, below * metres, np.nan)


def _half_rise(wider: Heights) -> Heights:
    """Return by how much the terrain falls from the centre of each pixel to its lowest corner.

    The only return of a pixel may lie there. The larger of the two steps to the neighbours
    counts along each axis; pixels without terrain have no step. ``wider`` has one pixel more on
    each side than the result, and NaN where there is no terrain.
    """
    centre = wider[1:-1, 1:-1]
    rise = np.zeros_like(centre)
    for before, after in (
        (wider[:-2, 1:-1], wider[2:, 1:-1]),
        (wider[1:-1, :-2], wider[1:-1, 2:]),
    ):
        step = np.fmax(np.abs(centre - before), np.abs(centre - after))
        rise += np.nan_to_num(step) / 2
    return rise


def min_pixels(pixel_m2: Fraction) -> int:
    """Return the number of pixels of the smallest place."""
    return math.ceil(MIN_PLACE_M2 / pixel_m2)


def _listed(wrong: npt.NDArray[np.bool_], least: int) -> npt.NDArray[np.bool_]:
    """Return the mask of the places with at least ``least`` pixels and of those at a side of the block."""
    labels, sides = label_block(wrong, corners=True)
    listed = np.bincount(labels.ravel()) >= least
    listed[[label for side in sides.values() for label, _ in side]] = True
    listed[0] = False
    kept: npt.NDArray[np.bool_] = listed[labels]
    return kept
