"""Places where the terrain lies far above all returns, so that it is certainly wrong, or far below them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import scipy

from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.edits import FLAT
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.grid.derived import with_rim
from tiler.grid.highest import NOTHING, ReturnsBlock, returns_of
from tiler.grid.pieces import label_block
from tiler.grid.records import AboveRecord
from tiler.store import TileStore, open_store

Heights = npt.NDArray[np.float64]

ABOVE_M = 1.0
"""Height above the highest return of its pixel from which terrain counts as wrong."""
MIN_PLACE_M2 = Fraction(10)
"""Least area of a place. In smaller ones, the returns are often noise that the filter missed."""
BELOW_M = 2.0
"""Height of the lowest return of a pixel above the terrain from which the terrain counts as below all returns."""
CELLS_PER_BLOCK = 4
"""Number of cells along the side of a block in which pixels below all returns are counted."""


@dataclass(frozen=True, kw_only=True)
class AboveBlock(ReturnsBlock):
    """Arguments of `above_block`.

    Attributes
    ----------
    waters : str or None
        Key in the store of bodies of water. The digest includes those that touch the block.
    """

    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)


def above_block(store_url: str, work: AboveBlock) -> AboveRecord:
    """Find the places in a block where the terrain lies above all returns.

    This is a `tiler.schedule.task.Work`. It writes no pixels. Places are pixels that touch at
    sides or corners. The record has those that are large enough or that touch a side of the
    block, as they may continue in the next one.

    Returns
    -------
    AboveRecord
        Record of the block.
    """
    store = open_store(store_url)
    above, below = heights_above(store, work)
    wrong = above > ABOVE_M
    labels, sides = label_block(_listed(wrong, min_pixels(store, work.spec)), corners=True)
    numbers = np.arange(1, int(labels.max(initial=0)) + 1)
    sizes = np.bincount(labels.ravel(), minlength=len(numbers) + 1)[1:]
    largest = scipy.ndimage.maximum(above, labels, numbers) if len(numbers) else ()
    places = []
    for size, height, (rows, cols) in zip(
        sizes, largest, scipy.ndimage.find_objects(labels), strict=True
    ):
        first = work.block.row + rows.start, work.block.col + cols.start
        last = work.block.row + rows.stop - 1, work.block.col + cols.stop - 1
        places.append([int(size), *first, *last, round(float(height), 3)])
    return AboveRecord(
        filled=0,
        sides=sides,
        labels=len(places),
        wrong=int(np.count_nonzero(wrong)),
        places=places,
        cells=_cells(work, below),
    )


def _cells(work: AboveBlock, below: Heights) -> list[list[int]]:
    """Return row and column of each cell, its number of known pixels, and of those below all returns."""
    side, cells = BLOCK_PIXELS // CELLS_PER_BLOCK, []
    for row in range(0, work.block.height, side):
        for col in range(0, work.block.width, side):
            part = below[row : row + side, col : col + side]
            if known := int(np.count_nonzero(~np.isnan(part))):
                counts = known, int(np.count_nonzero(part > BELOW_M))
                cells.append([work.block.row + row, work.block.col + col, *counts])
    return cells


def heights_above(store: TileStore, work: AboveBlock) -> tuple[Heights, Heights]:
    """Return the metres of the terrain of each pixel above the highest return, and below the lowest one.

    The terrain is that at the lowest corner of the pixel for the first, at the highest for the second.

    Pixels without a return or without terrain have 0 and NaN. So have pixels of water, whose low
    returns are noise, and of edits that set a height.
    """
    spec, block = work.spec, work.block
    supported, lowest = returns_of(store, work, block)
    returns = supported[..., 2]
    wider = with_rim(store, work.terrain, spec, block)
    terrain = wider[1:-1, 1:-1]
    known = (returns != NOTHING) & ~np.isnan(terrain)
    waters = store.waters(work.waters, spec.block_bounds(block))
    if waters is not None:
        known &= ~waters.inside(spec, block)
    key = work.rule.edits
    edits = None if key is None else store.edits(key, spec.block_bounds(block), (FLAT,))
    for edit in () if edits is None else edits.edits:
        known &= ~spec.inside(block, edit.area)
    half, metres = _half_rise(wider), float(store.meta.frame.units.vertical)
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


def min_pixels(store: TileStore, spec: RasterSpec) -> int:
    """Return the number of pixels of the smallest place."""
    return math.ceil(MIN_PLACE_M2 / (spec.lattice.size * store.meta.frame.metres_xy) ** 2)


def _listed(wrong: npt.NDArray[np.bool_], least: int) -> npt.NDArray[np.bool_]:
    """Return the mask of the places with at least ``least`` pixels and of those at a side of the block."""
    labels, sides = label_block(wrong, corners=True)
    listed = np.bincount(labels.ravel()) >= least
    listed[[label for side in sides.values() for label, _ in side]] = True
    listed[0] = False
    kept: npt.NDArray[np.bool_] = listed[labels]
    return kept
