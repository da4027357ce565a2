"""Rasters of a store, with one chunk per block, so that each block has one writer.

Rasters of coarse cells are read in windows, and at the pixels of finer rasters.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from itertools import product

import numpy as np

from ptd.arrays import Float32, Float64, Int64
from tiler.core.products import MAX_RESOLUTIONS, NODATA
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.errors import StoreError
from tiler.store import arrays, layout
from tiler.store.arrays import StorePart
from tiler.store.georeference import raster_attributes

RASTER_SETS = "raster-sets"
"""Name of the state that lists the sets of rasters, the current one last."""

MAX_RASTER_SETS = MAX_RESOLUTIONS
"""Number of sets that stay in a store, which bounds its size."""

RASTER_STAGES = ("grid-", "water")
"""Prefixes of the names of the stages whose tasks work on rasters."""


class RasterStore(StorePart):
    """Rasters of a store. Pixels that were never written hold the raster's fill.

    The rasters of each resolution are a set, so that runs with several resolutions can share a filter. All methods use
    the current set (see `TileStore.use_rasters`).
    """

    @cached_property
    def _raster_set(self) -> str:
        """Name of the current set; empty if none was chosen."""
        names = self._storage.get_json(layout.state_key(RASTER_SETS)) or [""]
        return str(names[-1])

    def _raster_path(self, name: str) -> str:
        return layout.raster_path(name, self._raster_set)

    def create_raster(self, name: str, spec: RasterSpec, fill: float = NODATA) -> None:
        """Make a float32 raster (*coordinator*). An existing raster of the same shape and fill keeps its blocks."""
        path = self._raster_path(name)
        kind = layout.raster_kind(fill)
        shape = (spec.height, spec.width)
        attributes = raster_attributes(name, spec, self.meta.frame.crs_wkt, fill)
        array = arrays.find_array(self._storage, path, kind)
        if array is None or array.shape != shape or array.fill != np.float32(fill):
            self._storage.delete_folder(path)
            array = None
        if array is None or {**array.attributes, **attributes} != array.attributes:
            array = arrays.write_metadata(self._storage, path, shape, kind, attributes)
            arrays.make_group(self._storage, layout.RASTERS)
        self._open[path] = array

    def write_block(self, name: str, block: Block, values: Float32) -> None:
        """Write a whole block as one chunk: 512 x 512 pixels, or fewer at the south and east edge.

        Raises
        ------
        StoreError
            The block is not a chunk of the raster, or ``values`` has another shape.
        """
        array = self._raster(name)
        height, width = array.shape
        whole = (min(BLOCK_PIXELS, height - block.row), min(BLOCK_PIXELS, width - block.col))
        aligned = block.row % BLOCK_PIXELS == 0 and block.col % BLOCK_PIXELS == 0
        if not aligned or (block.height, block.width) != whole or values.shape != whole:
            raise StoreError(
                f"{array.path}: block {block.name} is not a chunk; blocks are {BLOCK_PIXELS} pixels wide"
            )
        chunk = np.full(array.kind.chunks, array.fill, np.float32)
        chunk[: block.height, : block.width] = values
        array.write((block.row // BLOCK_PIXELS, block.col // BLOCK_PIXELS), chunk)

    def read_block(self, name: str, block: Block) -> Float32:
        """Return any window of a raster, float32 (height, width). Pixels that were never written hold the fill.

        Raises
        ------
        StoreError
            The window reaches beyond the raster.
        """
        array = self._raster(name)
        height, width = array.shape
        bottom = block.row + block.height
        right = block.col + block.width
        if block.row < 0 or block.col < 0 or bottom > height or right > width:
            raise StoreError(
                f"{array.path}: block {block.name} reaches beyond {height} x {width} pixels"
            )
        rows = range(block.row // BLOCK_PIXELS, -(-bottom // BLOCK_PIXELS))
        cols = range(block.col // BLOCK_PIXELS, -(-right // BLOCK_PIXELS))
        numbers = list(product(rows, cols))
        pixels = np.empty((block.height, block.width), np.float32)
        for (chunk_row, chunk_col), chunk in zip(numbers, array.read(numbers), strict=True):
            row = chunk_row * BLOCK_PIXELS
            col = chunk_col * BLOCK_PIXELS
            top = max(block.row, row)
            left = max(block.col, col)
            part = chunk[top - row : bottom - row, left - col : right - col]
            pixels[top - block.row :, left - block.col :][: part.shape[0], : part.shape[1]] = (
                part
            )
        return pixels

    def stored_blocks(self, name: str) -> set[tuple[int, int]]:
        """Return first row and column of each block with a stored chunk. Other blocks hold the fill or are lost."""
        block_corners = set()
        for key in self._storage.names(self._raster_path(name)):
            numbers = layout.chunk_numbers(key)
            if numbers is not None and len(numbers) == 2:
                block_corners.add((numbers[0] * BLOCK_PIXELS, numbers[1] * BLOCK_PIXELS))
        return block_corners

    def erase_blocks(self, name: str, blocks: Iterable[Block]) -> None:
        """Remove the chunks of some blocks, whose pixels then hold the raster's fill."""
        for block in blocks:
            chunk = (block.row // BLOCK_PIXELS, block.col // BLOCK_PIXELS)
            self._storage.delete(layout.chunk_key(self._raster_path(name), chunk))

    def _raster(self, name: str) -> arrays.StoredArray:
        return self._opened(self._raster_path(name), layout.raster_kind(0.0))


Steps = tuple[Int64, Float64]
"""For each of some positions, the cell whose centre lies before it, and the share of the way to the next centre."""


def read_cells(
    store: RasterStore, name: str, coarse: RasterSpec, window: Block, fill: float = 0.0
) -> Float32:
    """Return a window of a raster, float32 (height, width). Cells of the window beyond the raster are ``fill``."""
    values = np.full((window.height, window.width), fill, np.float32)
    top, left = max(window.row, 0), max(window.col, 0)
    bottom = min(window.row + window.height, coarse.height)
    right = min(window.col + window.width, coarse.width)
    if top < bottom and left < right:
        part = store.read_block(name, Block(top, left, bottom - top, right - left))
        values[
            top - window.row : bottom - window.row, left - window.col : right - window.col
        ] = part
    return values


def coarse_cells(coarse: RasterSpec, spec: RasterSpec, block: Block) -> tuple[Int64, ...]:
    """Return row and column of the coarse cell at each pixel's centre, int64 (height,) and (width,).

    They may be beyond the raster of coarse cells if the side of a cell is not a multiple of the
    side of a pixel.
    """
    p, q = spec.lattice.p, spec.lattice.q
    x = ((2 * (spec.west + block.col + np.arange(block.width, dtype=np.int64)) + 1) * p) // (
        2 * q
    )
    y = (
        (2 * (spec.north - 1 - block.row - np.arange(block.height, dtype=np.int64)) + 1) * p
    ) // (2 * q)
    return coarse.north - 1 - coarse.lattice.index(y), coarse.lattice.index(x) - coarse.west


def between_centres(coarse: RasterSpec, spec: RasterSpec, block: Block) -> tuple[Steps, Steps]:
    """Return the rows and the columns of coarse cells between whose centres the centres of a block's pixels lie.

    Rows increase to the south. All numbers are whole up to the last division, so they do not depend on the block.
    """
    down = np.arange(block.height, dtype=np.int64) + block.row - spec.north
    right = np.arange(block.width, dtype=np.int64) + spec.west + block.col
    pixel, cell = spec.lattice, coarse.lattice
    whole = 2 * pixel.q * cell.p
    rows, columns = (
        np.divmod((2 * pixels + 1) * (pixel.p * cell.q) - pixel.q * cell.p, whole)
        for pixels in (down, right)
    )
    return (rows[0] + coarse.north, rows[1] / whole), (
        columns[0] - coarse.west,
        columns[1] / whole,
    )


def coarse_window(coarse: RasterSpec, spec: RasterSpec, block: Block) -> Block:
    """Return the window of the coarse cells at the centres of a block's pixels."""
    rows, cols = coarse_cells(coarse, spec, block)
    top, left = int(rows.min()), int(cols.min())
    return Block(top, left, int(rows.max()) - top + 1, int(cols.max()) - left + 1)


def coarse_values(
    store: RasterStore, name: str, coarse: RasterSpec, spec: RasterSpec, block: Block
) -> Float32:
    """Return the values of a coarse raster at a block's pixels, float32 (height, width), 0 beyond the raster."""
    window = coarse_window(coarse, spec, block)
    cells = read_cells(store, name, coarse, window)
    rows, cols = coarse_cells(coarse, spec, block)
    return cells[np.ix_(rows - window.row, cols - window.col)]
