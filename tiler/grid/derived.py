"""Products made of the terrain, of points and of other rasters: each is a function of arrays."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.gridding.shape import gradients, multidirectional_hillshade, slope_deg
from tiler.core.mask_values import (
    CANOPY,
    FILLED,
    HOLE,
    INTERPOLATED,
    MASK_VALUES,
    MEASURED,
    OUTSIDE,
    WATER,
)
from tiler.core.products import SURVEYED
from tiler.grid.block_surroundings import PointsNear, WatersNear
from tiler.grid.canopy import OPEN
from tiler.grid.steps import Counts

Bools = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]

FIRST_SHARE = 4
"""Divisor of the cap for the first search of points, as few blocks need the whole cap."""


def hillshade(terrain: Float64, *, pixel: float) -> tuple[Float64, Counts]:
    """Return the shade of the terrain. ``pixel`` is the side of a pixel in units of the heights."""
    return multidirectional_hillshade(*gradients(terrain, pixel)), {}


def slope(terrain: Float64, *, pixel: float) -> tuple[Float64, Counts]:
    """Return the slope of the terrain in degrees. ``pixel`` is the side of a pixel in units of the heights."""
    return slope_deg(*gradients(terrain, pixel)), {}


def height_above_ground(surface: Float64, terrain: Float64) -> tuple[Float64, Counts]:
    """Return surface minus terrain. The surface is not below the terrain, except in voids that were filled."""
    return surface - terrain, {}


def density(points: PointsNear, *, pixel_m2: float) -> tuple[Float64, Counts]:
    """Return ground points per square metre."""
    counts: Float64 = points.ground_per_pixel() / pixel_m2
    return counts, {}


def distance(points: PointsNear, *, cap: Fraction) -> tuple[Float64, Counts]:
    """Return the plan distance in metres from each pixel's centre to the nearest ground point.

    Centres are rounded down to a whole count. Distances are at most ``cap`` counts. ``filled`` counts the pixels that
    are nearer.
    """
    counts = points.ground_distance(cap / FIRST_SHARE)
    if np.isinf(counts).any():
        counts = points.ground_distance(cap)
    near = int(np.isfinite(counts).sum())
    return np.minimum(counts, float(cap)) * float(points.frame.metres_xy), {"filled": near}


def mask(
    terrain: Float64,
    delivered: Float64,
    canopy: Float64,
    survey: npt.NDArray[np.float32],
    points: PointsNear,
    waters: WatersNear,
    failed: Bools,
    area: Bools,
) -> tuple[Float64, Counts]:
    """Return where the height of each pixel comes from (`tiler.core.mask_values`).

    A pixel with a height is measured if a ground point lies in it, else interpolated. A pixel
    without a height is a hole inside the survey (see `tiler.grid.coverage`), else outside.
    Filled holes, water and a canopy that was bridged have separate values. A pixel where a tile
    failed is a hole, even if its surroundings give it a height.

    Parameters
    ----------
    terrain, delivered : float64 (height, width)
        Heights before voids are filled, and delivered heights, cut at the outline. The outline or edits may have
        removed a height.
    canopy : float64 (height, width)
        Crowns that hide the ground.
    survey : float32 (height, width)
    points : PointsNear
    waters : WatersNear
    failed, area : bool (height, width)
        Pixels in tiles that failed, and in the area of the run.
    """
    filled = ~np.isnan(delivered)
    known = ~np.isnan(terrain) & filled
    values = np.select(
        [known & (points.ground_per_pixel() > 0), known, filled, survey >= SURVEYED],
        [MEASURED, INTERPOLATED, FILLED, HOLE],
        OUTSIDE,
    )
    values[(canopy > OPEN) & filled] = CANOPY
    values[waters.inside & filled] = WATER
    values[failed] = HOLE
    values[~area] = OUTSIDE
    by_value = np.bincount(values.ravel(), minlength=len(MASK_VALUES)).tolist()
    return values.astype(np.float64), {"filled": int(filled.sum()), "values": by_value}
