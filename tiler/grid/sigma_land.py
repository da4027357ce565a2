"""Terrain around a block's pixels: its slope, and the deviation of a height from the trend around it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.gridding.shape import gradients
from tiler.core.raster import Block, RasterSpec
from tiler.grid.block_surroundings import PixelCells, linear

CELL_M = 3.4
"""Side of the cells whose means represent the terrain. A median of 5 x 5 of them covers 17
m."""
HALF = 2
"""Number of cells on each side of the middle cell in the window of the median."""
RIM = HALF + 1
"""Margin around a block in cells."""

Float64 = npt.NDArray[np.float64]


def land_margin(pixel_m: float) -> int:
    """Return the margin in pixels around a block that `Land` needs."""
    return _side(pixel_m) * (RIM + 1)


def _side(pixel_m: float) -> int:
    """Return the side of a cell in pixels."""
    return max(1, round(CELL_M / pixel_m))


class Land:
    """Heights of a block and its margin, and their means over cells of whole pixels."""

    def __init__(
        self, heights: Float64, margin: int, pixel_m: float, spec: RasterSpec, block: Block
    ) -> None:
        """Prepare the heights of a block and of ``margin`` pixels around it, NaN without a height."""
        self._cells = PixelCells(spec, block, _side(pixel_m), RIM)
        window = self._cells.window
        top, left = window.row - block.row + margin, window.col - block.col + margin
        self._heights = heights[top : top + window.height, left : left + window.width]
        self._means = self._cells.means(self._heights, ~np.isnan(self._heights))

    def known(self) -> npt.NDArray[np.bool_]:
        """Return a mask of the block's pixels that have a height."""
        return ~np.isnan(self._heights[np.ix_(self._cells.rows, self._cells.columns)])

    def slope(self, pixel: float) -> Float64:
        """Return the slope of the cells' means at the block's pixels (rise over run).

        The side of a pixel, ``pixel``, is in units of the heights.
        """
        cells = self._cells
        east, north = gradients(self._means, pixel * cells.side)
        steep = np.sqrt(east * east + north * north)
        pixel_slope = steep[
            np.ix_(cells.rows // cells.side - 1, cells.columns // cells.side - 1)
        ]
        return np.nan_to_num(pixel_slope)

    def off_trend(self) -> Float64:
        """Return the absolute deviation of the block's heights from the median of the cells around.

        Medians are interpolated linearly between the middles of cells.
        """
        around = np.lib.stride_tricks.sliding_window_view(
            self._means, (2 * HALF + 1, 2 * HALF + 1)
        )
        ordered = np.sort(around.reshape(*around.shape[:2], -1), axis=-1)  # NaN is last
        n = np.count_nonzero(~np.isnan(ordered), axis=-1)[..., np.newaxis]
        low = np.take_along_axis(ordered, np.maximum((n - 1) // 2, 0), -1)[..., 0]
        high = np.take_along_axis(ordered, np.minimum(n // 2, ordered.shape[-1] - 1), -1)[
            ..., 0
        ]
        cells = self._cells
        rows, columns = cells.between(cells.rows, HALF), cells.between(cells.columns, HALF)
        trend = linear(linear((low + high) / 2, *rows).T, *columns)
        heights = self._heights[np.ix_(cells.rows, cells.columns)]
        return np.nan_to_num(np.abs(heights - trend.T))
