"""Surface model: the highest return of each pixel without spikes, elsewhere the TIN of these returns.

Places without returns (see `tiler.grid.coverage.bare_cells`) have no height: a facet there spans roofs and trees.
Bodies of water have their level. `--voids fill` fills what remains.

The surface is never below the terrain. Returns below the terrain come from the slope within
their pixel, from low noise that the filter missed, or from places where the terrain is too
high (see `tiler.grid.above`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds
from tiler.core.points import PointBlock
from tiler.core.products import BEYOND, VOID
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.block import full_halo, heights_in_units, rasterise_window
from tiler.grid.checksum import checksum
from tiler.grid.highest import NOTHING, ReturnsBlock, highest_returns
from tiler.grid.records import SurfaceRecord
from tiler.grid.work import TinBlock
from tiler.store import TileStore, coarse_values, open_store

Int32 = npt.NDArray[np.int32]
Heights = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SurfaceBlock(TinBlock, ReturnsBlock):
    """Arguments of `surface_block`. The terrain limits the surface from below.

    Attributes
    ----------
    survey : str
        Raster of the survey.
    coarse : RasterSpec
        Raster of the survey's cells.
    waters : str or None
        Key in the store of the bodies of water. The digest includes those that touch the block.
    """

    survey: str
    coarse: RasterSpec
    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)


def surface_block(store_url: str, work: SurfaceBlock) -> SurfaceRecord:
    """Write one block of the surface model. This is a `tiler.schedule.task.Work`.

    A pixel with a return (see `highest_returns`) has its height. Other pixels are interpolated
    on the TIN of these returns under the same limit as the terrain, except in places without returns. All heights are
    at least those of the terrain.

    Returns
    -------
    SurfaceRecord
        Record of the block.
    """
    store = open_store(store_url)
    cells = coarse_values(store, work.survey, work.coarse, work.spec, work.block)
    bare = (cells >= VOID) | (cells == BEYOND)
    heights, measured, record = surface_heights(store, work, bare)
    terrain = store.read_block(work.terrain, work.block)
    heights = raised_to(heights, terrain)
    waters = store.waters(work.waters, work.spec.block_bounds(work.block))
    if waters is not None:
        wet = waters.inside(work.spec, work.block) & bare & ~measured
        heights[wet] = terrain[wet]
    store.write_block(work.name, work.block, heights)
    filled = int(np.count_nonzero(heights != np.float32(NODATA)))
    return replace(record, filled=filled, checksum=checksum(heights))


def raised_to(heights: Heights, terrain: Heights) -> Heights:
    """Return the heights, at least those of the terrain where both are known."""
    both = (heights != np.float32(NODATA)) & (terrain != np.float32(NODATA))
    return np.where(both, np.maximum(heights, terrain), heights)


def surface_heights(
    store: TileStore, work: SurfaceBlock, bare: Bools
) -> tuple[Heights, Bools, SurfaceRecord]:
    """Return the heights of any block, not yet raised to the terrain, a mask of measured pixels, and the record.

    Pixels of ``bare`` without a return get no height.
    """
    block, bounds, limit = (
        work.block,
        work.spec.block_bounds(work.block),
        full_halo(work.max_edge),
    )
    returns = highest_returns(store, work, block)
    measured = returns[..., 2] != NOTHING
    heights = np.where(measured, returns[..., 2] / COUNTS_PER_UNIT, NODATA).astype(np.float32)
    between = ~measured & ~bare
    # A block with a return in every pixel needs no interpolation.
    halo, tries, marked = 0, 1, 0
    while between.any():
        halo = min(max(2 * halo, work.halo, math.ceil(work.spec.lattice.size)), limit)
        window = bounds.pad(halo)
        raster = rasterise_window(store, work, window, _vertices(store, work, window))
        marks = raster.marks & between
        marked = int(marks.sum())
        if marked == 0 or halo >= limit:
            heights = np.where(between, heights_in_units(raster.heights), heights)
            break
        tries += 1
    filled = int(np.count_nonzero(heights != np.float32(NODATA)))
    record = SurfaceRecord(
        pixels=heights.size,
        filled=filled,
        measured=int(measured.sum()),
        marked=marked,
        tries=tries,
        halo=halo,
    )
    return heights, measured, record


def _vertices(store: TileStore, work: SurfaceBlock, window: Bounds) -> Int32:
    """Return the pixels' returns in a window, local counts (3, n). Pixels at its border are processed whole."""
    lattice, spec = work.spec.lattice, work.spec
    west, east = lattice.index_of(window.x0), lattice.index_of(window.x1 - 1) + 1
    south, north = lattice.index_of(window.y0), lattice.index_of(window.y1 - 1) + 1
    block = Block(spec.north - north, west - spec.west, north - south, east - west)
    returns = highest_returns(store, work, block).reshape(-1, 3).T
    returns = returns[:, returns[2] != NOTHING]
    inside = PointBlock(returns).inside(window, store.meta.frame.origin)
    return np.ascontiguousarray(returns[:, inside])
