"""Inverse distance weighting of the nearest points (Shepard, A two-dimensional interpolation function, 1968).

Twelve neighbours have weights 1 / d2; a position on a point gets the height of the point.
Heights are relative to the nearest neighbour. They are summed from near to far, and ties in the
order of (x, y, z). So the result does not depend on the order of points, on the tile or on the
frame.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ptd.gridding.nearest import NONE, nearest_points
from ptd.tin.gridding import Pixels

Int32 = npt.NDArray[np.int32]
Float64 = npt.NDArray[np.float64]

NEIGHBOURS = 12


def inverse_distance(
    x: Int32, y: Int32, z: Int32, pixels: Pixels, reach: float
) -> tuple[Float64, Float64]:
    """Return heights at pixel centres, and the distance to the farthest neighbour of each.

    Parameters
    ----------
    x, y, z : int32 [n]
        Local counts.
    pixels : Pixels
    reach : float
        Largest distance of a neighbour in horizontal counts.

    Returns
    -------
    heights : float64 [rows, columns]
        Counts, NaN where no point is within reach.
    distance : float64 [rows, columns]
        Distance of the twelfth neighbour in counts, or ``reach`` if there are fewer.
    """
    squared, points = nearest_points(x, y, z, pixels, NEIGHBOURS, reach)
    there = points != NONE
    near_z = np.where(there, z[points] if z.size else 0, 0).astype(np.float64)
    d2 = np.where(there, squared, 1).astype(np.float64)
    base, on_point = near_z[..., 0], d2[..., 0] == 0.0
    weights, rises = np.zeros(base.shape), np.zeros(base.shape)
    for k in range(NEIGHBOURS):
        weight = there[..., k] / np.where(d2[..., k] == 0.0, 1.0, d2[..., k])
        weights += weight
        rises += weight * (near_z[..., k] - base)
    rise = np.where(on_point, 0.0, rises / np.where(weights > 0, weights, 1.0))
    heights = np.where(there[..., 0], base + rise, np.nan)
    return heights, np.where(there[..., -1], np.sqrt(d2[..., -1]), reach)
