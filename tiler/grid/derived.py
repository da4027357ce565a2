"""Hillshade, slope and height above ground, computed block by block from other rasters with a margin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ptd.gridding.shape import gradients, multidirectional_hillshade, slope_deg
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.checksum import checksum
from tiler.grid.records import BlockRecord
from tiler.grid.work import BlockWork
from tiler.store import TileStore, open_store

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DeriveBlock(BlockWork):
    """Arguments of `derive_block`.

    Attributes
    ----------
    sources : tuple of str
        Raster of the terrain; for ``ndsm`` the rasters of the surface and the terrain.
    fill : float
        Value to store for pixels without a result.
    """

    sources: tuple[str, ...]
    fill: float


def derive_block(store_url: str, work: DeriveBlock) -> BlockRecord:
    """Write one block of a raster that is computed from other rasters. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    BlockRecord
        Record of the block.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    computed_values = _PRODUCTS[work.name](store, spec, block, work.sources)
    fill = np.float32(work.fill)
    values = np.where(np.isnan(computed_values), fill, computed_values.astype(np.float32))
    store.write_block(work.name, block, values)
    return BlockRecord(
        pixels=values.size,
        filled=int(np.count_nonzero(values != fill)),
        checksum=checksum(values),
    )


def _read(store: TileStore, name: str, block: Block) -> Float64:
    heights = store.read_block(name, block)
    return np.where(heights == np.float32(NODATA), np.nan, heights.astype(np.float64))


def with_rim(store: TileStore, name: str, spec: RasterSpec, block: Block) -> Float64:
    """Return the heights of a block and of one pixel on each side, NaN beyond the raster."""
    top, left = min(block.row, 1), min(block.col, 1)
    bottom = min(spec.height - block.row - block.height, 1)
    right = min(spec.width - block.col - block.width, 1)
    wider = Block(
        block.row - top,
        block.col - left,
        block.height + top + bottom,
        block.width + left + right,
    )
    rim = ((1 - top, 1 - bottom), (1 - left, 1 - right))
    return np.pad(_read(store, name, wider), rim, constant_values=np.nan)


def _terrain_gradients(
    store: TileStore, spec: RasterSpec, block: Block, sources: Sequence[str]
) -> tuple[Float64, Float64]:
    # The size of a pixel is converted to vertical units, as plan and heights may have different
    # units (feet, metres).
    frame = store.meta.frame
    step = spec.lattice.size * frame.metres_xy / frame.units.vertical
    return gradients(with_rim(store, sources[0], spec, block), float(step))


def _hillshade(
    store: TileStore, spec: RasterSpec, block: Block, sources: Sequence[str]
) -> Float64:
    return multidirectional_hillshade(*_terrain_gradients(store, spec, block, sources))


def _slope(store: TileStore, spec: RasterSpec, block: Block, sources: Sequence[str]) -> Float64:
    return slope_deg(*_terrain_gradients(store, spec, block, sources))


def _ndsm(store: TileStore, spec: RasterSpec, block: Block, sources: Sequence[str]) -> Float64:
    """Return surface minus terrain. The surface is not below the terrain, except in voids that were filled."""
    surface, terrain = sources
    return _read(store, surface, block) - _read(store, terrain, block)


_PRODUCTS: dict[str, Callable[[TileStore, RasterSpec, Block, Sequence[str]], Float64]] = {
    "hillshade": _hillshade,
    "slope": _slope,
    "ndsm": _ndsm,
}
