"""Terrain that looks like the crowns of a closed canopy: smooth over a crown's top, rough from crown to crown.

Image matching sees no ground below closed crowns, and a surface over them bends no more than hills do. What tells is
how its roughness grows with the window: residuals of planes are some decimetres over 9 m, several times those over 3 m.
Rocks, rough grass and noise are rough over 3 m already, smooth hills over neither, and where a cliff or a gorge bends
the terrain its slopes fall one way, those of crowns all ways.

Measured on terrain of 1 m (share of the blocks): closed forest of a drone survey 62 %; a village in a gorge 4 %, seven
semi-real scenes, a park and rough fields 0 to 2 %, one of 15 blocks of a lava field.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

SMALL, LARGE = 3, 9
"""Cells of about a metre: sides of the windows."""
BLOCK = 24
"""Cells: side of the blocks that look like crowns or do not."""
ROUGH_M, SMOOTHER = 0.3, 0.35
"""Median residual over the large windows from which on, and its part over the small ones up to which, a block does."""
ONE_WAY = 0.7
"""Mean gradient of a block in parts of the mean of its lengths, from which on its slopes fall one way."""
MIN_FILLED = 0.3

Float64 = npt.NDArray[np.float64]
Place = tuple[slice, slice]
"""Rows and columns of a block."""


class Crowns(NamedTuple):
    """Blocks of a raster that look like crowns.

    Attributes
    ----------
    looked_at : int
        Blocks with heights enough.
    found : list of (int, int)
        First row and column of those that look like crowns.
    """

    looked_at: int
    found: list[tuple[int, int]]


def crowns(heights: Float64) -> Crowns:
    """Look for crowns in a raster of the terrain.

    Parameters
    ----------
    heights : float64 (rows, columns)
        Metres, NaN where there are none; cells of about 1 m. Blocks begin in the first row and column.
    """
    large = residuals(heights, LARGE)
    filled = [place for place in _blocks(heights) if _share_held(large[place]) >= MIN_FILLED]
    rough = [place for place in filled if np.nanmedian(large[place]) > ROUGH_M]
    if not rough:  # as nearly everywhere: what follows is half of the work
        return Crowns(len(filled), [])
    part = residuals(heights, SMALL) / np.maximum(large, 1e-3)
    gradients: list[Float64] = list(np.gradient(heights))
    down, right = gradients
    found = [
        (rows.start, columns.start)
        for rows, columns in rough
        if np.nanmedian(part[rows, columns]) < SMOOTHER
        and one_way(down[rows, columns], right[rows, columns]) < ONE_WAY
    ]
    return Crowns(len(filled), found)


def _blocks(heights: Float64) -> Iterator[Place]:
    for row in range(0, heights.shape[0], BLOCK):
        for column in range(0, heights.shape[1], BLOCK):
            yield slice(row, row + BLOCK), slice(column, column + BLOCK)


def _share_held(block: Float64) -> float:
    """Share of a whole block, which reaches beyond the raster at its edge."""
    return float(np.count_nonzero(np.isfinite(block))) / BLOCK**2


def one_way(down: Float64, right: Float64) -> float:
    """Length of the mean gradient in parts of the mean length of the gradients: 1 where all slopes fall one way."""
    known = np.isfinite(down) & np.isfinite(right)
    lengths = np.hypot(down[known], right[known])
    if not lengths.any():
        return 1.0
    return float(np.hypot(down[known].mean(), right[known].mean()) / lengths.mean())


def residuals(heights: Float64, side: int) -> Float64:
    """Root mean square of the residuals of planes in windows around each cell; NaN where a window is half empty.

    Every window is summed by itself and in the same order, so that it does not matter where the raster begins.
    """
    held = np.isfinite(heights)
    weight, z = held.astype(np.float64), np.where(held, heights, 0.0)
    one: Float64 = np.ones(side)
    away: Float64 = np.arange(side, dtype=np.float64) - side // 2

    squared: Float64 = away * away

    def total(values: Float64, across: Float64, down: Float64) -> Float64:
        along: Float64 = scipy.ndimage.correlate1d(values, across, axis=1, mode="constant")
        found: Float64 = scipy.ndimage.correlate1d(along, down, axis=0, mode="constant")
        return found

    n = total(weight, one, one)
    points = np.maximum(n, 1.0)
    mx, my, mz = (
        total(v, x, y) / points for v, x, y in ((weight, away, one), (weight, one, away), (z, one, one))
    )
    xx, yy = total(weight, squared, one) / points - mx * mx, total(weight, one, squared) / points - my * my
    xy, zz = total(weight, away, away) / points - mx * my, total(z * z, one, one) / points - mz * mz
    xz, yz = total(z, away, one) / points - mx * mz, total(z, one, away) / points - my * mz
    determinant = np.maximum(xx * yy - xy * xy, 1e-9)
    a, b = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    left = np.sqrt(np.maximum(zz - a * xz - b * yz, 0.0) * points / np.maximum(points - 3, 1.0))
    return np.where(held & (n >= side**2 / 2), left, np.nan)
