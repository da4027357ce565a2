"""Cells of whole pixels around a block, anchored at pixel 0, with linear interpolation between their middles."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import Block, RasterSpec

Bools = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]
Index = npt.NDArray[np.intp]


class PixelCells:
    """Cells of ``side`` x ``side`` pixels: those of a block, and ``rim`` more on each side.

    Attributes
    ----------
    side : int
    window : Block
        Pixels of all cells. It may extend beyond the raster.
    west, north : int
        Column and row of the first cell from pixel 0. Rows increase to the south.
    rows, columns : int (height,), int (width,)
        Rows and columns of the block's pixels in the window.
    """

    def __init__(self, spec: RasterSpec, block: Block, side: int, rim: int) -> None:
        left, top = spec.west + block.col, block.row - spec.north
        self.side = side
        self.west, self.north = left // side - rim, top // side - rim
        east = -(-(left + block.width) // side) + rim
        south = -(-(top + block.height) // side) + rim
        self.window = Block(
            self.north * side + spec.north,
            self.west * side - spec.west,
            (south - self.north) * side,
            (east - self.west) * side,
        )
        self.rows = np.arange(block.height) + (block.row - self.window.row)
        self.columns = np.arange(block.width) + (block.col - self.window.col)

    def means(self, values: npt.NDArray[np.floating], known: Bools) -> Float64:
        """Return the mean of the known pixels of each cell, NaN where none is known.

        Values are rounded to counts, as sums of whole numbers are the same for any start of the block.
        """
        counts = np.rint(np.where(known, values, 0.0).astype(np.float64) * COUNTS_PER_UNIT)
        total, n = self.sums(counts.astype(np.int64)), self.sums(known.astype(np.int64))
        means: Float64 = np.where(n > 0, total / np.maximum(n, 1) / COUNTS_PER_UNIT, np.nan)
        return means

    def sums(self, pixels: Int64) -> Int64:
        """Return the sum of the pixels of each cell."""
        rows, columns = (n // self.side for n in pixels.shape)
        sums: Int64 = pixels.reshape(rows, self.side, columns, self.side).sum(axis=(1, 3))
        return sums

    def between(self, pixels: Index, first: int = 0) -> tuple[Index, Float64]:
        """Return the cell before each row or column of pixels, and the share of the way to the next one.

        Cells are counted from cell ``first``.
        """
        # Whole numbers of half pixels make the share the same for any start of the block.
        half_pixels = 2 * pixels + 1 - (2 * first + 1) * self.side
        before = half_pixels // (2 * self.side)
        return before, (half_pixels - 2 * self.side * before) / (2 * self.side)


def linear(values: Float64, before: Index, share: Float64) -> Float64:
    """Interpolate linearly between rows of values."""
    interpolated: Float64 = (
        values[before] * (1 - share)[:, np.newaxis] + values[before + 1] * share[:, np.newaxis]
    )
    return interpolated
