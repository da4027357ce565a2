"""Tops and bottoms of a terrain, found block by block."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

HIGH, LOW = "high", "low"

BESIDE = 5
"""Pixels a side around a spot in which each has a height: the rim of the data is no top."""


def spots_of_block(
    heights: npt.NDArray[np.float64], kind: str, reach: int, least: float
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows and columns of the pixels that nothing around is higher than (or lower), one of each level top.

    Parameters
    ----------
    heights : float64 (h, w)
        NaN where there is none. What is found depends on ``2 * reach`` pixels around it.
    kind : str
        `HIGH` or `LOW`.
    reach : int
        Pixels to each side that are around.
    least : float
        How much lower (or higher) something around has to be.
    """
    size, sign = 2 * reach + 1, 1.0 if kind == HIGH else -1.0
    known = ~np.isnan(heights)
    height = sign * heights
    top = scipy.ndimage.maximum_filter(np.where(known, height, -np.inf), size, mode="nearest")
    bottom = scipy.ndimage.minimum_filter(np.where(known, height, np.inf), size, mode="nearest")
    chosen = known & (height == top) & (top - bottom >= least)
    chosen &= scipy.ndimage.binary_erosion(known, np.ones((BESIDE, BESIDE), np.bool_))
    # Of pixels of one height the first in the order of the raster; those that are chosen nearby are of one height.
    number = np.where(chosen, np.arange(heights.size).reshape(heights.shape), heights.size)
    first = scipy.ndimage.minimum_filter(number, size, mode="nearest") == number
    rows, cols = np.nonzero(chosen & first)
    return rows, cols
