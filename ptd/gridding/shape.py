"""Slope and shading from heights: pixels with their eight neighbours.

Gradients are Horn's (1981, Hill shading and the reflectance map, Proc. IEEE 69(1), p. 18): a
third-order finite difference, east and north, over the 3 x 3 pixels. Neighbours may have no
height at the border of the survey, of the raster or of a hole. A missing side is mirrored
through the centre from the opposite one, and a missing corner completes the parallelogram of
its two sides, so planes stay exact to their last pixel. A direction in which neither neighbour
is known counts as level.
"""

from __future__ import annotations

import math

import numpy as np

from ptd.arrays import Float64

AZIMUTHS_DEG = (225.0, 270.0, 315.0, 360.0)
ALTITUDE_DEG = 45.0


def gradients(heights: Float64, step: float) -> tuple[Float64, Float64]:
    """Gradients of heights: rise to the east and to the north.

    Parameters
    ----------
    heights : float64, shape (rows + 2, columns + 2)
        Pixels and one more on each side, NaN without a height; row 0 is the northern one.
    step : float
        Size of a pixel in the unit of the heights.

    Returns
    -------
    east, north : float64, shape (rows, columns)
        NaN where the pixel itself has no height.
    """
    rows, columns = heights.shape[0] - 2, heights.shape[1] - 2

    def shifted(down: int, right: int) -> Float64:
        return heights[1 + down : 1 + down + rows, 1 + right : 1 + right + columns]

    centre = shifted(0, 0)

    def side(down: int, right: int) -> Float64:
        near, opposite = shifted(down, right), shifted(-down, -right)
        mirrored = np.where(np.isnan(opposite), centre, 2 * centre - opposite)
        return np.where(np.isnan(near), mirrored, near)

    west, east, north, south = side(0, -1), side(0, 1), side(-1, 0), side(1, 0)

    def corner(down: int, right: int, beside: Float64, above: Float64) -> Float64:
        near = shifted(down, right)
        return np.where(np.isnan(near), beside + above - centre, near)

    northwest, northeast = corner(-1, -1, west, north), corner(-1, 1, east, north)
    southwest, southeast = corner(1, -1, west, south), corner(1, 1, east, south)
    to_east = (northeast + 2 * east + southeast) - (northwest + 2 * west + southwest)
    to_north = (northwest + 2 * north + northeast) - (southwest + 2 * south + southeast)
    return to_east / (8 * step), to_north / (8 * step)


def slope_deg(east: Float64, north: Float64) -> Float64:
    """Angle of steepest descent from gradients, degrees."""
    return np.degrees(np.arctan(np.sqrt(east * east + north * north)))


def multidirectional_hillshade(east: Float64, north: Float64) -> Float64:
    """Return the shading from four suns as whole numbers from 1 (dark) to 255, NaN where the gradients are NaN.

    The suns are in the west half of the sky, 45 degrees high, at `AZIMUTHS_DEG`. Each counts by
    the squared cosine of the angle between its azimuth and the aspect, so that slopes of every
    direction are lit. The weights sum to 2.

    The source is Mark (1992, Multidirectional, oblique-weighted, shaded-relief image of the
    Island of Hawaii, USGS OFR 92-422), as `gdaldem hillshade -multidirectional` computes it.
    Mark has a squared sine, but gdaldem turns the aspect by a quarter, so the sine becomes this
    cosine. As in gdaldem, shades are scaled to 1 + 254 times the cosine of incidence, so level
    ground is 181.
    """
    squared = east * east + north * north
    sin_h, cos_h = math.sin(math.radians(ALTITUDE_DEG)), math.cos(math.radians(ALTITUDE_DEG))
    total = np.zeros_like(squared)
    for azimuth in AZIMUTHS_DEG:
        sin_a, cos_a = math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth))
        along = east * sin_a + north * cos_a
        total += along * along * np.maximum(sin_h - cos_h * along, 0.0)
    level = squared == 0.0
    cosine = np.where(level, sin_h, total / (2.0 * np.where(level, 1.0, squared)))
    return np.floor(1.5 + 254.0 * cosine / np.sqrt(1.0 + squared))
