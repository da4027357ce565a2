"""Models that are cut at the outline of the survey, with level water."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.products import BEYOND, SURVEYED, VOID
from tiler.core.raster import NODATA, RasterSpec
from tiler.grid.block import edit_heights
from tiler.grid.canopy import OPEN
from tiler.grid.checksum import checksum
from tiler.grid.coarse import padded
from tiler.grid.holes import hole_cells, holes_of_block
from tiler.grid.records import OutlineRecord
from tiler.grid.work import BlockWork
from tiler.store import coarse_values, open_store


@dataclass(frozen=True, kw_only=True)
class OutlineBlock(BlockWork):
    """Arguments of `outline_block`.

    Attributes
    ----------
    heights : str
        Raster of the model.
    survey : str
        Raster of the survey.
    coarse : RasterSpec
        Raster of the survey's cells.
    cut : bool
        Whether heights beyond the survey are removed.
    canopy : str or None
        Raster of the canopy. Where it hides the ground, pixels get no height.
    below : str or None
        Raster of the heights below a canopy, which replace those of the model.
    waters, edits : str or None
        Keys in the store of bodies of water, and of edits, which are applied after water. The digest includes those
        that touch the block.
    finds_water : bool
        Whether the run found the water itself. Drawn water gets no height outside the survey where the model has none.
    area : str or None
        Key in the store of the area. Holes outside it do not count.
    """

    heights: str
    survey: str
    coarse: RasterSpec
    cut: bool = True
    canopy: str | None = None
    below: str | None = None
    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    finds_water: bool = False
    area: str | None = None


def outline_block(store_url: str, work: OutlineBlock) -> OutlineRecord:
    """Write one block of a model, cut at the survey's outline and with level water.

    This is a `tiler.schedule.task.Work`. Facets span a concave border of the survey, so land
    that was never surveyed would get a height from the border. Facets also span rivers that
    leave the survey. Water keeps its height there.

    Returns
    -------
    OutlineRecord
        Record of the block.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    nodata = np.float32(NODATA)
    heights_before = store.read_block(work.heights, block)
    cells = coarse_values(store, work.survey, work.coarse, spec, padded(block, 1))
    beyond = cells[1:-1, 1:-1] == BEYOND
    heights, water = heights_before.copy(), []
    if work.canopy is not None:
        heights[store.read_block(work.canopy, block) > OPEN] = nodata
    if work.below is not None:
        below = store.read_block(work.below, block)
        heights = np.where(below != nodata, below, heights)
    if work.canopy is not None or work.below is not None:
        edit_heights(store, work.edits, spec, block, heights)
    hidden = int(np.count_nonzero((heights_before != nodata) & (heights == nodata)))
    waters = store.waters(work.waters, spec.block_bounds(block))
    if waters is not None:
        wet = waters.inside(spec, block)
        gets_water = (heights_before != nodata) | ~beyond | work.finds_water
        water = waters.set_heights(spec, block, heights, gets_water)
        edit_heights(store, work.edits, spec, block, heights)
        beyond &= ~wet
    if work.cut:
        heights[beyond] = nodata
    store.write_block(work.name, block, heights)
    bare = (cells[1:-1, 1:-1] >= VOID) & (heights != nodata)
    bare &= spec.inside(block, store.area(work.area))
    if waters is not None:
        bare &= ~wet
    lost = int(np.count_nonzero((heights_before != nodata) & (heights == nodata)))
    holes = holes_of_block(
        store, spec, block, heights, cells >= SURVEYED, work.edits, store.area(work.area)
    )
    return OutlineRecord(
        pixels=heights.size,
        filled=int(np.count_nonzero(heights != nodata)),
        cut=max(lost - hidden, 0),
        water=water,
        checksum=checksum(heights),
        surveyed=holes.n_surveyed,
        voided=holes.n_voided,
        holes=holes.cells,
        edit_holes=holes.by_edit,
        bare=hole_cells(bare, block, cells < SURVEYED),
    )
