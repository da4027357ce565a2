"""Warning about terrain of a photogrammetric cloud that looks like the crowns of a closed canopy."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import chain

import numpy as np

from ptd.matched.crowns import BLOCK, Crowns, crowns
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.nodata import NODATA
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.grid.roofs import Advice
from tiler.grid.steps import Counts
from tiler.store import TileStore

CELL_M, MAX_CELL_M = 1.0, 1.25
"""Approximate and largest side of the cells for the search. Finer pixels are thinned, coarser
pixels hide crowns."""
MIN_SHARE, MIN_BLOCKS = 0.1, 10
"""Least share of the terrain and least number of blocks (0.06 ha each) that look like crowns
for a warning."""


def find_crowns(store: TileStore, *, spec: RasterSpec, names: tuple[str, ...]) -> Counts:
    """Search blocks of the terrain for crowns: ``n_tested`` and ``found`` of `ptd.matched.crowns.Crowns`."""
    blocks = [spec.block_named(name, BLOCK_PIXELS) for name in names]
    parts = [crowns_in_block(store, "dtm", spec, block) for block in blocks]
    return {
        "n_tested": sum(part.n_tested for part in parts),
        "found": list(chain.from_iterable(part.found for part in parts)),
    }


def crowns_in_block(store: TileStore, name: str, spec: RasterSpec, block: Block) -> Crowns:
    """Find the positions in a block of the terrain that look like crowns, as pixels of the raster.

    Parameters
    ----------
    store : TileStore
    name : str
        Name of the raster of the terrain.
    spec : RasterSpec
    block : Block
    """
    times = _thinning(store, spec)
    if times is None:
        return Crowns(0, [])
    heights = store.read_block(name, block)[times // 2 :: times, times // 2 :: times]
    metres = np.where(heights == np.float32(NODATA), np.nan, heights.astype(np.float64))
    cells = crowns(metres * float(store.meta.frame.units.vertical))
    half = BLOCK * times // 2
    pixels = []
    for row, column in cells.found:
        pixels.append((block.row + row * times + half, block.col + column * times + half))
    return Crowns(cells.n_tested, pixels)


def crown_advice(parts: Iterable[Crowns], spec: RasterSpec) -> Advice | None:
    """Return a warning if `MIN_SHARE` of the terrain and `MIN_BLOCKS` blocks look like crowns, else None."""
    looked_at = 0
    pixels: list[tuple[int, int]] = []
    for part in parts:
        looked_at += part.n_tested
        pixels += part.found
    if len(pixels) < max(MIN_SHARE * looked_at, MIN_BLOCKS):
        return None
    row, column = pixels[len(pixels) // 2]
    a, _, x, _, e, y = spec.transform(COUNTS_PER_UNIT)
    x, y = x + a * column, y + e * row
    text = (
        f"{100 * len(pixels) / looked_at:.0f} % of the terrain looks like crowns of a closed canopy and may be metres "
        f"too high, as around x {x:.0f}, y {y:.0f}; remove these areas (--edits, action void) or survey them with LiDAR"
    )
    return Advice(text, x, y)


def _thinning(store: TileStore, spec: RasterSpec) -> int | None:
    """Return the number of pixels along a cell of about a metre, or None if pixels are too coarse."""
    pixel = float(spec.lattice.size * store.meta.frame.metres_xy)
    times = max(round(CELL_M / pixel), 1)
    return times if pixel * times <= MAX_CELL_M else None
