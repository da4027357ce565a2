"""Surface model: the highest return of each pixel without spikes, elsewhere the TIN of these returns.

Places without returns (see `tiler.grid.coverage.bare_cells`) have no height: a facet there spans roofs and trees.
Bodies of water have their level. `--voids fill` fills what remains.

The surface is never below the terrain. Returns below the terrain come from the slope within
their pixel, from low noise that the filter missed, or from places where the terrain is too
high (see `tiler.grid.above`).
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.gridding.above_ground import NOTHING
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds
from tiler.core.points import PointBlock
from tiler.core.products import BEYOND, VOID
from tiler.core.raster import Block
from tiler.grid.block import full_halo, rasterise_window
from tiler.grid.block_surroundings import PointsNear, WatersNear
from tiler.grid.records import Facets
from tiler.grid.steps import Counts

Bools = npt.NDArray[np.bool_]
Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]


def surface(
    points: PointsNear,
    terrain: Float64,
    survey: npt.NDArray[np.float32],
    waters: WatersNear,
    facets: Facets,
    *,
    reach: int,
    spike: Fraction,
) -> tuple[Float64, Counts]:
    """Return the heights of the surface. All are at least those of the terrain.

    A pixel with a return has the height of its highest one. Other pixels are interpolated
    on the TIN of these returns under the same limit as the terrain, except in places without returns.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height, width)
    survey : float32 (height, width)
    waters : WatersNear
    facets : Facets
    reach, spike
        See `PointsNear.returns`.

    Returns
    -------
    heights : float64 (height, width)
    counts : dict
        ``measured``: number of pixels with a return. ``marked``, ``tries``, ``halo``: see `TerrainRecord`.
    """
    bare = (survey >= VOID) | (survey == BEYOND)
    heights, measured, counts = surface_heights(points, bare, facets, reach, spike)
    heights = raised_to(heights, terrain)
    wet = waters.inside & bare & ~measured
    heights[wet] = terrain[wet]
    return heights, counts


def raised_to(heights: Float64, terrain: Float64) -> Float64:
    """Return the heights, at least those of the terrain where both are known."""
    raised: Float64 = np.where(np.isnan(terrain), heights, np.maximum(heights, terrain))
    return raised


def surface_heights(
    points: PointsNear, bare: Bools, facets: Facets, reach: int, spike: Fraction
) -> tuple[Float64, Bools, Counts]:
    """Return the heights of a block, not yet raised to the terrain, a mask of measured pixels, and the counts.

    Pixels of ``bare`` without a return get no height.
    """
    spec, block, limit = points.spec, points.block, full_halo(facets.max_edge)
    bounds = spec.block_bounds(block)
    returns = points.returns(block, reach, spike)[0][..., 2]
    measured = returns != NOTHING
    heights = np.where(measured, returns / COUNTS_PER_UNIT, np.nan)
    between = ~measured & ~bare
    # A block with a return in every pixel needs no interpolation.
    halo, tries, marked = 0, 1, 0
    while between.any():
        halo = min(max(2 * halo, facets.halo, math.ceil(spec.lattice.size)), limit)
        window = bounds.pad(halo)
        xyz = _vertices(points, window, reach, spike)
        raster = rasterise_window(spec, block, points.frame.origin, facets, window, xyz)
        marked = int((raster.marks & between).sum())
        if marked == 0 or halo >= limit:
            heights = np.where(between, raster.heights / COUNTS_PER_UNIT, heights)
            break
        tries += 1
    counts = {"measured": int(measured.sum()), "marked": marked, "tries": tries, "halo": halo}
    return heights, measured, counts


def _vertices(points: PointsNear, window: Bounds, reach: int, spike: Fraction) -> Int32:
    """Return the pixels' returns in a window, local counts (3, n). Pixels at its border are processed whole."""
    lattice, spec = points.spec.lattice, points.spec
    west, east = lattice.index_of(window.x0), lattice.index_of(window.x1 - 1) + 1
    south, north = lattice.index_of(window.y0), lattice.index_of(window.y1 - 1) + 1
    block = Block(spec.north - north, west - spec.west, north - south, east - west)
    returns = points.returns(block, reach, spike)[0].reshape(-1, 3).T
    returns = returns[:, returns[2] != NOTHING]
    inside = PointBlock(returns).inside(window, points.frame.origin)
    return np.ascontiguousarray(returns[:, inside])
