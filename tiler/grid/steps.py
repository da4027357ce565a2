"""Steps: a block of a raster is a function of what it reads. `run_block` is the only runner."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ptd.arrays import Bool, Float32, Float64, Floating
from tiler.core.lattice import Bounds, CoordFrame
from tiler.core.points import PointBlock
from tiler.core.products import Read
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.block_surroundings import EditsNear, PointsNear, WatersNear
from tiler.grid.coarse import padded
from tiler.grid.records import BlockWork, Facets, GroundSelection, checksum
from tiler.store import TileStore, coarse_values, coarse_window, read_cells

Counts = Mapping[str, Any]
"""What a block adds to the summary of its raster, as JSON can hold it. It is the record of the block."""


@dataclass(frozen=True, kw_only=True)
class Sources:
    """What the reads of all blocks of a run have in common.

    Attributes
    ----------
    rule : GroundSelection
        Rule for the points that are ground, with the key in the store of the edits.
    pixels, coarse, canopy_grid : RasterSpec
        Rasters of the products, of the coarse cells, and of the cells in which canopies are compared with the terrain.
    waters, area : str or None
        Keys in the store of bodies of water, and of the area of the run.
    failed : tuple of Bounds
        Bounds of tiles that failed, if the step reads them: those that overlap the block.
    facets : Facets
    kind : str or None
        Source of the clouds as methods name it (`ptd.passes.RunHints`); None if it is not known.
    canopy : (str, str)
        Names in the store of the cells in which the filter found a canopy, as elected points, and of their labels;
        empty if it found none, as then no step reads them.
    """

    rule: GroundSelection
    pixels: RasterSpec
    coarse: RasterSpec
    canopy_grid: RasterSpec
    facets: Facets
    waters: str | None = None
    area: str | None = None
    failed: tuple[Bounds, ...] = ()
    kind: str | None = None
    canopy: tuple[str, str] = ("", "")


class Position(NamedTuple):
    """Position of a block: the frame of the store, the raster, the block, and what all blocks have in common."""

    frame: CoordFrame
    spec: RasterSpec
    block: Block
    sources: Sources

    @property
    def pixel_m(self) -> float:
        """Side of a pixel or cell in metres."""
        return float(self.spec.lattice.size * self.frame.metres_xy)

    @property
    def pixel_m2(self) -> float:
        """Area of a pixel or cell in square metres."""
        return float((self.spec.lattice.size * self.frame.metres_xy) ** 2)

    @property
    def pixel_in_heights(self) -> float:
        """Side of a pixel in units of the heights, as plan and heights may have different units."""
        metres = self.spec.lattice.size * self.frame.metres_xy
        return float(metres / self.frame.units.vertical)

    @property
    def unit_m(self) -> float:
        """Metres in a vertical unit of the CRS."""
        return float(self.frame.units.vertical)


@dataclass(frozen=True, kw_only=True)
class MakeBlock(BlockWork):
    """Block that a step makes.

    Attributes
    ----------
    work : callable
        Function of a module, ``work(**reads, **values) -> (values of pixels, counts)``. The values are NaN where a
        pixel has none. They are None if the step has no raster.
    reads : mapping of str to Read
        Arguments of ``work`` that are read for the block.
    values : mapping
        Other arguments of ``work``.
    sources : Sources
    fill : float
        Value to store for pixels without one.
    empty : frozenset of str
        Rasters that have no block, so that none is looked for in the store.
    """

    work: Callable[..., tuple[Floating | None, Counts]]
    reads: Mapping[str, Read]
    values: Mapping[str, Any]
    sources: Sources
    fill: float
    empty: frozenset[str] = frozenset()


def run_block(store: TileStore, *, task: MakeBlock) -> Counts:
    """Make one block of a raster.

    Returns
    -------
    dict
        Counts of the function. For a raster also ``pixels``, ``filled`` (pixels with a value, unless the function
        counts them) and ``checksum``.
    """
    reads = {name: READERS[read.kind](store, task, read) for name, read in task.reads.items()}
    values, counts = task.work(**reads, **task.values)
    if values is None:
        return counts
    if values.shape != (task.block.height, task.block.width):
        raise ValueError(
            f"{task.name}: the function returned {values.shape} pixels for {task.block}"
        )
    fill = np.float32(task.fill)
    pixels = np.where(np.isnan(values), fill, values.astype(np.float32))
    store.write_block(task.name, task.block, pixels)
    filled = int(np.count_nonzero(pixels != fill))
    return {"pixels": pixels.size, "filled": filled, "checksum": checksum(pixels), **counts}


def erase_blocks(store: TileStore, *, name: str, blocks: Sequence[Block]) -> Counts:
    """Delete the stored pixels of blocks of a raster, which then read as the fill value."""
    store.erase_blocks(name, blocks)
    return {}


def _raster(store: TileStore, task: MakeBlock, read: Read) -> Float64:
    """Return a raster around a block, float64, NaN without a value and beyond the raster."""
    window = padded(task.block, read.margin)
    if read.raster in task.empty:
        return np.full((window.height, window.width), np.nan)
    values = read_cells(store, read.raster, task.spec, window, NODATA)
    return np.where(values == np.float32(NODATA), np.nan, values.astype(np.float64))


def _numbers(store: TileStore, task: MakeBlock, read: Read) -> Float32:
    """Return a raster of numbers that has no nodata around a block, float32, 0 beyond the raster."""
    return read_cells(store, read.raster, task.spec, padded(task.block, read.margin))


def _cells(store: TileStore, task: MakeBlock, read: Read) -> Float32:
    """Return a raster of coarse cells at the pixels around a block, float32, 0 beyond the raster."""
    window = padded(task.block, read.margin)
    return coarse_values(store, read.raster, task.sources.coarse, task.spec, window)


@dataclass(frozen=True)
class PixelsUnder:
    """Raster that a step reads part by part, as the whole may not fit into memory."""

    store: TileStore
    name: str
    spec: RasterSpec

    def read(self, block: Block) -> Float32:
        """Return the pixels of a block, float32 (height, width), 0 beyond the raster."""
        return read_cells(self.store, self.name, self.spec, block)


def _points(store: TileStore, task: MakeBlock, read: Read) -> PointsNear:
    return PointsNear(store, task.sources.rule, task.spec, task.block, read.raster)


def _waters(store: TileStore, task: MakeBlock, _: Read) -> WatersNear:
    waters = store.waters(task.sources.waters, task.spec.block_bounds(task.block))
    return WatersNear(waters, task.spec, task.block)


def _edits(store: TileStore, task: MakeBlock, _: Read) -> EditsNear:
    return EditsNear(store, task.sources.rule.edits, task.spec, task.block)


def _canopy(store: TileStore, task: MakeBlock, read: Read) -> PointBlock:
    elected, labels = task.sources.canopy
    return store.elected(elected, task.spec.block_bounds(task.block).pad(read.margin), labels)


def _canopy_grid(store: TileStore, task: MakeBlock, read: Read) -> Float64:
    """Return a raster of cells of canopies around a block (see `canopy_window`), float64, NaN without a value."""
    cells = task.sources.canopy_grid
    window = canopy_window(_place(store, task, read), read.margin)
    values = read_cells(store, read.raster, cells, window, NODATA).astype(np.float64)
    return np.where(values == NODATA, np.nan, values)


def canopy_window(place: Position, margin: int) -> Block:
    """Return the cells of canopies at a block and ``margin`` cells around it."""
    return padded(coarse_window(place.sources.canopy_grid, place.spec, place.block), margin)


def _place(store: TileStore, task: MakeBlock, _: Read) -> Position:
    return Position(store.meta.frame, task.spec, task.block, task.sources)


def _area(store: TileStore, task: MakeBlock, read: Read) -> Bool:
    """Return a mask of the pixels around a block in the area of the run."""
    return task.spec.inside(padded(task.block, read.margin), store.area(task.sources.area))


def _failed(_: TileStore, task: MakeBlock, __: Read) -> Bool:
    """Return a mask of the pixels whose centres lie in a tile that failed."""
    mask = np.zeros((task.block.height, task.block.width), np.bool_)
    x, y = task.spec.centres(task.block)
    for bounds in task.sources.failed:
        mask |= (x >= bounds.x0) & (x < bounds.x1) & (y >= bounds.y0) & (y < bounds.y1)
    return mask


READERS: dict[str, Callable[[TileStore, MakeBlock, Read], Any]] = {
    "raster": _raster,
    "numbers": _numbers,
    "cells": _cells,
    "pixels": lambda store, task, read: PixelsUnder(store, read.raster, task.sources.pixels),
    "same-cells": lambda store, task, read: PixelsUnder(store, read.raster, task.spec),
    "coarse": lambda store, task, read: PixelsUnder(store, read.raster, task.sources.coarse),
    "points": _points,
    "waters": _waters,
    "edits": _edits,
    "canopy": _canopy,
    "canopy-grid": _canopy_grid,
    "place": _place,
    "area": _area,
    "failed": _failed,
    "facets": lambda _, task, __: task.sources.facets,
    "kind": lambda _, task, __: task.sources.kind,
    "products": lambda _, task, __: task.sources.pixels,
}
"""Functions that read the arguments of a step."""
