"""Surroundings of each cell of a raster: Gaussian sums that end at a fixed radius, shares by blocks, slopes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from ptd.ground.morphology import Bool

Float64 = npt.NDArray[np.float64]

SLOPE_SMOOTHED_M, STEEPEST = 2.0, 2.0
"""Standard deviation of the surroundings from which slopes are computed, and the limit at which
slopes are cut off."""
TRUNCATE = 2.0
"""Number of standard deviations at which Gaussian sums end."""
SHARE_BLOCK_M = 4.0
"""Size of the blocks for which shares of the surroundings are computed. The surroundings are
much larger."""


@dataclass(frozen=True)
class RemainingCells:
    """Cells that remain after objects are removed.

    Fields are heights in metres, a mask of the cells that have a height, and the size of cells
    in metres.
    """

    height: Float64
    there: Bool
    cell_m: float

    @cached_property
    def near(self) -> Float64:
        """Weighted share of cells in the surroundings from which slopes are computed."""
        return self.smoothed(self.there.astype(np.float64), SLOPE_SMOOTHED_M)

    def mean(self, values: Float64) -> Float64:
        """Return the Gaussian mean of the values of cells for slopes, or 0 where no cell is near."""
        return self.smoothed(np.where(self.there, values, 0.0), SLOPE_SMOOTHED_M) / np.maximum(
            self.near, 1e-9
        )

    def around(self, which: Bool | Float64, std_m: float) -> Float64:
        """Return the share of chosen cells in the surroundings of each cell, by blocks of `SHARE_BLOCK_M`.

        Values instead of a mask are summed with weights that add up to 1.
        """
        rows, columns = which.shape
        block = share_block(self.cell_m)
        down, right = -rows % block, -columns % block
        padded = np.pad(which, ((0, down), (0, right))).astype(np.float64)
        split = padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block)
        shares = smoothed(split.mean(axis=(1, 3)), std_m / SHARE_BLOCK_M)
        whole = np.repeat(np.repeat(shares, block, axis=0), block, axis=1)
        return np.ascontiguousarray(whole[:rows, :columns])

    def smoothed(self, values: Float64, std_m: float) -> Float64:
        """Return Gaussian sums over the cells around each one."""
        return smoothed(values, std_m / self.cell_m)

    def slope(self, surface: Float64) -> Float64:
        """Return the slope of a surface, or 0 where few cells are near."""
        north, east = np.gradient(self.mean(surface), self.cell_m)
        slope: Float64 = np.where(self.there & (self.near > 0.2), np.hypot(north, east), 0.0)
        return np.minimum(slope, STEEPEST)


def smoothed(values: Float64, std: float) -> Float64:
    """Return Gaussian sums with weights that add up to 1.

    ``std`` is the standard deviation in cells. Values beyond the raster are 0.
    """
    radius = gaussian_radius(std)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / std) ** 2)
    weights /= weights.sum()
    along: Float64 = scipy.ndimage.correlate1d(values, weights, axis=1, mode="constant")
    sums: Float64 = scipy.ndimage.correlate1d(along, weights, axis=0, mode="constant")
    return sums


def gaussian_radius(std: float) -> int:
    """Return the distance in cells at which Gaussian sums end."""
    return math.ceil(TRUNCATE * std)


def slope_radius(cell_m: float) -> int:
    """Return the distance in cells beyond which heights do not change a slope."""
    return gaussian_radius(SLOPE_SMOOTHED_M / cell_m) + 1


def share_block(cell_m: float) -> int:
    """Return the number of cells on a side of the blocks by which shares are computed."""
    return round(SHARE_BLOCK_M / cell_m)


def share_radius(std_m: float, cell_m: float) -> int:
    """Return the distance in cells at which shares by blocks end."""
    return share_block(cell_m) * (gaussian_radius(std_m / SHARE_BLOCK_M) + 1)
