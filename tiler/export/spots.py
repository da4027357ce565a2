"""Tops and bottoms of a terrain, found block by block."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

HIGH, LOW = "high", "low"

BESIDE = 5
"""Side in pixels of the square around a spot in which every pixel has a height, since the edge
of data is not a top."""


def spots_of_block(
    heights: npt.NDArray[np.float64], kind: str, reach: int, least: float
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return rows and columns of the pixels that are the highest or lowest in the square around them.

    Of a flat top, only one pixel is returned.

    Parameters
    ----------
    heights : float64 (h, w)
        Heights, NaN for pixels without one. A result depends on the ``2 * reach`` pixels around it.
    kind : str
        `HIGH` or `LOW`.
    reach : int
        Number of pixels from a spot to each side of its square.
    least : float
        Minimum difference between the highest and lowest height in the square, in the unit of the heights.
    """
    size, sign = 2 * reach + 1, 1.0 if kind == HIGH else -1.0
    known = ~np.isnan(heights)
    height = sign * heights
    top = scipy.ndimage.maximum_filter(np.where(known, height, -np.inf), size, mode="nearest")
    bottom = scipy.ndimage.minimum_filter(np.where(known, height, np.inf), size, mode="nearest")
    chosen = known & (height == top) & (top - bottom >= least)
    chosen &= scipy.ndimage.binary_erosion(known, np.ones((BESIDE, BESIDE), np.bool_))
    # Chosen pixels near each other have the same height, and only the first of them in the
    # raster is kept.
    number = np.where(chosen, np.arange(heights.size).reshape(heights.shape), heights.size)
    first = scipy.ndimage.minimum_filter(number, size, mode="nearest") == number
    rows, cols = np.nonzero(chosen & first)
    return rows, cols
