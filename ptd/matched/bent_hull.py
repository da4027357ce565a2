"""Hull below the cells of the ground that bends as much as the cells show.

1. There are two hulls. The stiff one is correct below trees, where ground is visible only
   through gaps; the pliable one follows terrain. The *contrast* decides between them: above
   ground there is a gap up to the objects on it, and a hull that climbed into plants has as
   many cells above it as on it. Cells that are terrain as a whole (`ptd.matched.objects`) do
   not count as plants, because a hull lies below crests.
2. Less stiff hulls follow banks, ridges and crests. They are used where the cells above the
   surface are terrain as a whole, or where nearly everything around is ground. The least stiff
   hull would follow cars too. So on level ground it is used only for features that are wider
   than cars.

The surroundings of cells that decide on this come first: Gaussian sums that end at a fixed
radius, shares by blocks, slopes (`RemainingCells`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from ptd.arrays import Bool, Float64
from ptd.matched.hull import Envelope

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
    return scipy.ndimage.correlate1d(along, weights, axis=0, mode="constant")


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


STIFF, PLIABLE = Envelope(0.01, 11.5), Envelope(0.04, 11.5)
RIDGES = (Envelope(0.08, 6.0), Envelope(0.2, 6.0), Envelope(0.5, 6.0))
OPEN_GROUND = 0.3
"""Curvature up to which a hull is used on open ground as well. Hulls of more curvature are used
only on surfaces that are terrain as a whole (`ptd.matched.objects`), because they would follow
cars."""
CREST_SLOPE, CREST_M = (0.1, 0.2), 7.0
"""Mean slopes of the surroundings (`TERRAIN_M`) at which hulls of more curvature than
`OPEN_GROUND` begin to be used, and are used fully. On level ground they are used only for
features that are at least `CREST_M` wide, for example dams. A car that a single cell connects
to the ground belongs to the surface of the ground, so it is terrain as a whole."""
STEEP = (0.3, 0.6)
"""Mean slopes up to which terrain just above a ridge's hull counts fully as plants, and from
which on it does not count, because hulls cut off crests."""
BAND_M, BAND_SIGMAS, BAND_SLOPE = 0.15, 2.5, 0.15
"""Largest distance of cells on a hull: the sum of metres, a multiple of the noise, and metres
per unit of slope."""
CONTRAST_M, CONTRAST = 12.0, (0.5, 1.0)
"""Standard deviation of the surroundings in which cells are counted, and limits of the
contrast. Up to the first limit (half as many cells above a hull as on it) only the pliable hull
is used, from the second on (equally many) only the stiff one."""
RIDGE_M, RIDGE_SHARE, RIDGE_CONTRAST, CREST_CONTRAST = (
    6.0,
    (0.6, 0.85),
    (0.02, 0.06),
    (0.05, 0.15),
)
"""Settings of the hulls of ridges.

- `RIDGE_M`: standard deviation of the surroundings in which cells are counted.
- `RIDGE_SHARE`: shares of open ground or terrain at which the hulls begin to be used, and are
  used fully.
- `RIDGE_CONTRAST`: contrasts up to which they are used fully, and at which they end to be used.
- `CREST_CONTRAST`: the same contrasts for hulls of more curvature than `OPEN_GROUND`.
"""
MIN_SHARE_LEFT = 0.3
"""Lower limit of the share of cells that remain after objects are removed. The share of open
ground is relative to these cells, so that it is the same next to a roof or a pond as in the
open."""
TERRAIN_M = 8.0
"""Standard deviation of the surroundings in which cells above the surface are counted and
slopes are averaged."""


def _crest_cells(cell_m: float) -> int:
    """Return the least width in cells, an odd number, of a crest on level ground."""
    return 2 * int(CREST_M / cell_m / 2) + 1


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells beyond which heights do not change the hull."""
    hulls = [replace(h, cell_m=cell_m) for h in (STIFF, PLIABLE, *RIDGES)]
    slope = slope_radius(cell_m)
    reach = max(h.reach for h in hulls) + slope + share_radius(CONTRAST_M, cell_m)
    reach += len(RIDGES) * (
        slope + max(share_radius(RIDGE_M, cell_m), share_radius(TERRAIN_M, cell_m))
    )
    return reach + sum(_crest_cells(cell_m) - 1 for h in RIDGES if h.curvature > OPEN_GROUND)


def ramp(values: Float64, limits: tuple[float, float]) -> Float64:
    """Return 0 up to the first limit, 1 from the second on, and linear values between them."""
    return np.clip((values - limits[0]) / (limits[1] - limits[0]), 0.0, 1.0)


def _contrast(
    cells: RemainingCells,
    counted: Bool | Float64,
    surface: Float64,
    sigma_m: float | Float64,
    std_m: float,
) -> tuple[Float64, Float64]:
    """Return the contrast around each cell, and the share of cells on the surface.

    The contrast is the number of cells just above the surface, weighted by ``counted``, in
    parts of those on it.
    """
    band = BAND_M + BAND_SIGMAS * sigma_m + BAND_SLOPE * cells.slope(surface)
    residual = cells.height - surface
    on = cells.around(cells.there & (np.abs(residual) < band), std_m)
    just_above = cells.there & (residual >= band) & (residual < 3.0 * band)
    return cells.around(counted * just_above, std_m) / np.maximum(on, 1e-3), on


def bent_hull(
    cells: RemainingCells,
    terrain: Bool,
    hull: Callable[[Envelope], Float64],
    sigma_m: float | Float64,
) -> Float64:
    """Combine hulls so that the surface bends as much as the cells show."""
    stiff = hull(STIFF)
    pliable = np.maximum(hull(PLIABLE), stiff)
    contrast, _ = _contrast(cells, ~terrain, pliable, sigma_m, CONTRAST_M)
    surface = pliable - ramp(contrast, CONTRAST) * (pliable - stiff)
    around = cells.around
    there = np.maximum(around(cells.there, TERRAIN_M), 1e-3)
    left = np.maximum(around(cells.there, RIDGE_M), MIN_SHARE_LEFT)
    for envelope in RIDGES:
        slope = around(cells.slope(surface), TERRAIN_M) / there
        above = cells.there & (cells.height - surface > BAND_M + BAND_SIGMAS * sigma_m)
        share = around(above & terrain, TERRAIN_M) / np.maximum(around(above, TERRAIN_M), 1e-3)
        crests = envelope.curvature > OPEN_GROUND
        if crests and (share <= RIDGE_SHARE[0]).all():
            continue
        raised = np.maximum(hull(envelope) - surface, 0.0)
        if crests:
            crest = _crest_cells(cells.cell_m)
            least = scipy.ndimage.minimum_filter(raised, crest, mode="constant")
            wide = scipy.ndimage.maximum_filter(least, crest, mode="constant")
            raised = wide + ramp(slope, CREST_SLOPE) * (raised - wide)
        ridges = surface + raised
        counted = 1.0 - terrain * ramp(slope, STEEP)
        contrast, on = _contrast(cells, counted, ridges, sigma_m, RIDGE_M)
        if not crests:
            share = np.maximum(share, on / left)
        clear = 1.0 - ramp(contrast, CREST_CONTRAST if crests else RIDGE_CONTRAST)
        surface = surface + ramp(share, RIDGE_SHARE) * clear * raised
    return surface
