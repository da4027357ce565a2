"""Mask: whether the height of a pixel is measured, interpolated, filled or missing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.lattice import Bounds
from tiler.core.mask_values import (
    CANOPY,
    FILLED,
    HOLE,
    INTERPOLATED,
    MASK_VALUES,
    MEASURED,
    OUTSIDE,
    WATER,
)
from tiler.core.products import SURVEYED
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.canopy import OPEN
from tiler.grid.checksum import checksum
from tiler.grid.density import ground_counts
from tiler.grid.records import MaskRecord
from tiler.grid.work import PointsBlock
from tiler.store import coarse_values, open_store


@dataclass(frozen=True, kw_only=True)
class MaskBlock(PointsBlock):
    """Arguments of `mask_block`.

    Attributes
    ----------
    dtm, filled : str
        Raster of the heights before voids are filled, and raster of the delivered heights, cut at the outline.
    survey : str
        Raster of the survey.
    coarse : RasterSpec
        Raster of the survey's cells.
    canopy : str or None
        Raster of the canopy.
    holes : tuple of Bounds
        Bounds of tiles that failed.
    area : str or None
        Key in the store of the area. Every pixel outside it is "outside" in the mask.
    waters : str or None
        Key in the store of bodies of water. The digest includes those that touch the block.
    """

    dtm: str
    filled: str
    survey: str
    coarse: RasterSpec
    canopy: str | None = None
    holes: tuple[Bounds, ...] = ()
    area: str | None = None
    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)


def mask_block(store_url: str, work: MaskBlock) -> MaskRecord:
    """Write one block of the mask. This is a `tiler.schedule.task.Work`.

    A pixel with a height is measured if a ground point lies in it, else interpolated. A pixel
    without a height is a hole inside the survey (see `tiler.grid.coverage`), else outside.
    Filled holes, water and a canopy that was bridged have separate values. A pixel where a tile
    failed is a hole, even if its surroundings give it a height.

    Returns
    -------
    MaskRecord
        Record of the block.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    nodata = np.float32(NODATA)
    heights = store.read_block(work.dtm, block) != nodata
    filled = store.read_block(work.filled, block) != nodata
    heights &= filled  # the outline or edits may have removed a height
    inside = coarse_values(store, work.survey, work.coarse, spec, block) >= SURVEYED
    measured = ground_counts(store, work.rule, spec, block) > 0
    mask = np.select(
        [heights & measured, heights, filled, inside],
        [MEASURED, INTERPOLATED, FILLED, HOLE],
        OUTSIDE,
    ).astype(np.float32)
    if work.canopy is not None:
        mask[(store.read_block(work.canopy, block) > OPEN) & filled] = CANOPY
    waters = store.waters(work.waters, spec.block_bounds(block))
    if waters is not None:
        mask[waters.inside(spec, block) & filled] = WATER
    for hole in work.holes:
        mask[_within(hole, spec, block)] = HOLE
    mask[~spec.inside(block, store.area(work.area))] = OUTSIDE
    store.write_block(work.name, block, mask)
    return MaskRecord(
        pixels=mask.size,
        filled=int(filled.sum()),
        values=np.bincount(mask.ravel().astype(np.int64), minlength=len(MASK_VALUES)).tolist(),
        checksum=checksum(mask),
    )


def _within(bounds: Bounds, spec: RasterSpec, block: Block) -> tuple[slice, slice]:
    """Return the rows and columns of a block's pixels whose centres lie within bounds."""

    def first(edge: int) -> int:
        """Return the index of the first pixel whose centre is at an edge or beyond it."""
        return math.ceil(edge / spec.lattice.size - Fraction(1, 2))

    def clipped(start: int, stop: int, count: int) -> slice:
        return slice(min(max(start, 0), count), min(max(stop, 0), count))

    top, left = spec.north - block.row, spec.west + block.col
    rows = clipped(top - first(bounds.y1), top - first(bounds.y0), block.height)
    return rows, clipped(first(bounds.x0) - left, first(bounds.x1) - left, block.width)
