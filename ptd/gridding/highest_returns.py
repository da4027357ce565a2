"""The highest return of each pixel for a surface model, without single high points that nothing nearby supports."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy

from ptd.kernel import as_int64, kernel

Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]

NOTHING = np.iinfo(np.int32).min
"""Height of a pixel without a return."""


@kernel
def _higher(ax: int, ay: int, az: int, bx: int, by: int, bz: int) -> bool:
    """Whether return a ranks before b: higher, then lexicographically smaller in (x, y)."""
    if az != bz:
        return az > bz
    if ax != bx:
        return ax < bx
    return ay < by


@kernel
def _update(top: Int32, pixels: Int64, x: Int32, y: Int32, z: Int32) -> None:
    for i in range(pixels.size):
        first, second = top[pixels[i], 0], top[pixels[i], 1]
        px, py, pz = as_int64(x[i]), as_int64(y[i]), as_int64(z[i])
        if pz == first[2] and px == first[0] and py == first[1]:
            continue  # a repeated return does not count as the second
        if _higher(px, py, pz, as_int64(first[0]), as_int64(first[1]), as_int64(first[2])):
            second[0], second[1], second[2] = first[0], first[1], first[2]
            first[0], first[1], first[2] = px, py, pz
        elif _higher(px, py, pz, as_int64(second[0]), as_int64(second[1]), as_int64(second[2])):
            second[0], second[1], second[2] = px, py, pz


class HighestReturns:
    """The two highest returns of each pixel of a block, whatever the order in which points come.

    Parameters
    ----------
    rows, columns : int

    Attributes
    ----------
    top : int32 [rows * columns, 2, 3]
        x, y, z of the highest return, and of the next highest at another position or height; z is `NOTHING` without a
        return.
    """

    def __init__(self, rows: int, columns: int) -> None:
        self.rows, self.columns = rows, columns
        self.top = np.full((rows * columns, 2, 3), NOTHING, np.int32)

    def add(self, pixels: Int64, xyz: Int32) -> None:
        """Enter points.

        Parameters
        ----------
        pixels : int64 [n]
            Pixel of each point: ``row * columns + column``.
        xyz : int32 [3, n]
        """
        _update(self.top, pixels, *xyz)

    def supported(self, reach: int, spike: float) -> Int32:
        """The highest return of each pixel that is not a spike.

        A spike is a bird, a cloud or a blunder of matching. The highest return of a pixel is a spike if it is more than
        ``spike`` higher than the second return of its pixel and the highest returns of all pixels around. Then the
        second return replaces it. The second return is compared only with the pixels around; if it is a spike too, the
        pixel is empty. Two adjacent spikes support each other and stay. A pixel with no returns around it keeps its
        only return, or one of its two highest.

        Parameters
        ----------
        reach : int
            Number of pixels that are compared on each side, at least 1. Within this distance of the block's edge the
            result is right only if nothing lies beyond the edge.
        spike : float
            Counts.

        Returns
        -------
        int32 [rows, columns, 3]
            x, y, z; z is `NOTHING` for empty pixels.
        """
        first, second = self.top[:, 0], self.top[:, 1]
        heights = first[:, 2].reshape(self.rows, self.columns)
        around = np.ones((2 * reach + 1, 2 * reach + 1), np.bool_)
        around[reach, reach] = False
        beside = scipy.ndimage.maximum_filter(
            heights, footprint=around, mode="constant", cval=NOTHING
        ).ravel()
        limit = math.floor(spike)
        highest_other = np.maximum(beside, second[:, 2]).astype(np.int64)
        alone = highest_other == NOTHING
        good = alone | (first[:, 2] - highest_other <= limit)
        second_good = (beside == NOTHING) | (second[:, 2] - beside.astype(np.int64) <= limit)
        second_good &= second[:, 2] != NOTHING
        chosen = np.where(good[:, np.newaxis], first, second)
        chosen[~(good | second_good), 2] = NOTHING
        return chosen.reshape(self.rows, self.columns, 3)
