"""Terrain around a block's pixels: its slope, and the deviation of a height from the trend around it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.gridding.shape import gradients
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.nodata import NODATA
from tiler.core.raster import Block, RasterSpec
from tiler.store import TileStore, read_cells

CELL_M = 3.4
"""Side of the cells whose means represent the terrain. A median of 5 x 5 of them covers 17
m."""
HALF = 2
"""Number of cells on each side of the middle cell in the window of the median."""
RIM = HALF + 1
"""Margin around a block in cells."""

Float64 = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]
Index = npt.NDArray[np.intp]


class Land:
    """Heights of a block and its margin, and their means over cells of whole pixels, anchored at pixel 0."""

    def __init__(self, store: TileStore, name: str, spec: RasterSpec, block: Block) -> None:
        pixel_m = float(spec.lattice.size * store.meta.frame.metres_xy)
        side = max(1, round(CELL_M / pixel_m))
        west, north = spec.west + block.col, spec.north - block.row
        left = (west // side - RIM) * side - spec.west
        right = (-(-(west + block.width) // side) + RIM) * side - spec.west
        top = spec.north - (-(-north // side) + RIM) * side
        bottom = spec.north - ((north - block.height) // side - RIM) * side
        window = Block(top, left, bottom - top, right - left)
        heights = read_cells(store, name, spec, window, NODATA)
        known = heights != np.float32(NODATA)
        self._heights = np.where(known, heights.astype(np.float64), np.nan)
        self._side = side
        self._rows = np.arange(block.height) + (block.row - top)
        self._columns = np.arange(block.width) + (block.col - left)
        # Sums of whole numbers are the same for any start of the block.
        counts = np.rint(np.where(known, self._heights, 0.0) * COUNTS_PER_UNIT).astype(np.int64)
        total, n = _by_cells(counts, side), _by_cells(known.astype(np.int64), side)
        self._means = np.where(n > 0, total / np.maximum(n, 1) / COUNTS_PER_UNIT, np.nan)

    def known(self) -> npt.NDArray[np.bool_]:
        """Return a mask of the block's pixels that have a height."""
        return ~np.isnan(self._heights[np.ix_(self._rows, self._columns)])

    def slope(self, pixel: float) -> Float64:
        """Return the slope of the cells' means at the block's pixels (rise over run).

        The side of a pixel, ``pixel``, is in units of the heights.
        """
        east, north = gradients(self._means, pixel * self._side)
        steep = np.sqrt(east * east + north * north)
        pixel_slope = steep[
            np.ix_(self._rows // self._side - 1, self._columns // self._side - 1)
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
        trend = _linear(
            _linear((low + high) / 2, *self._between(self._rows)).T,
            *self._between(self._columns),
        )
        return np.nan_to_num(np.abs(self._heights[np.ix_(self._rows, self._columns)] - trend.T))

    def _between(self, pixels: Index) -> tuple[Index, Float64]:
        """Return the index of the median before each row or column of pixels, and the share of the way to the next."""
        # Whole numbers of half pixels make the share the same for any start of the block.
        half_pixels = 2 * pixels + 1 - (2 * HALF + 1) * self._side
        first = half_pixels // (2 * self._side)
        return first, (half_pixels - 2 * self._side * first) / (2 * self._side)


def _linear(values: Float64, first: Index, share: Float64) -> Float64:
    """Interpolate linearly between rows of values."""
    interpolated: Float64 = (
        values[first] * (1 - share)[:, np.newaxis] + values[first + 1] * share[:, np.newaxis]
    )
    return interpolated


def _by_cells(pixels: Int64, side: int) -> Int64:
    """Return sums over squares of pixels."""
    rows, columns = pixels.shape
    sums: Int64 = pixels.reshape(rows // side, side, columns // side, side).sum(axis=(1, 3))
    return sums
