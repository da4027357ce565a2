"""Reading of rasters of coarse cells, in windows and at the pixels of finer rasters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.raster import Block, RasterSpec
from tiler.store.store import TileStore

Floats = npt.NDArray[np.float32]
Steps = tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]
"""For each of some positions, the cell whose centre lies before it, and the share of the way to the next centre."""


def read_cells(
    store: TileStore, name: str, coarse: RasterSpec, window: Block, fill: float = 0.0
) -> Floats:
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


def coarse_cells(
    coarse: RasterSpec, spec: RasterSpec, block: Block
) -> tuple[npt.NDArray[np.int64], ...]:
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
    store: TileStore, name: str, coarse: RasterSpec, spec: RasterSpec, block: Block
) -> Floats:
    """Return the values of a coarse raster at a block's pixels, float32 (height, width), 0 beyond the raster."""
    window = coarse_window(coarse, spec, block)
    cells = read_cells(store, name, coarse, window)
    rows, cols = coarse_cells(coarse, spec, block)
    return cells[np.ix_(rows - window.row, cols - window.col)]
