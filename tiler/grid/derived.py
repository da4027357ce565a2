"""Products made of the terrain, of points and of other rasters: each is a function of arrays.

The surface model has the highest return of each pixel without spikes, elsewhere the TIN of these returns. Places
without returns (see `tiler.grid.coverage.bare_cells`) have no height: a facet there spans roofs and trees. Bodies of
water have their level. `--voids fill` fills what remains.

The surface is never below the terrain. Returns below the terrain come from the slope within their pixel, from low
noise that the filter missed, or from places where the terrain is too high (see `tiler.grid.flaws`).
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from ptd.arrays import Bool, Float32, Float64, Int32
from ptd.gridding.above_ground import NOTHING
from ptd.gridding.shape import gradients, multidirectional_hillshade, slope_deg
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.points import PointBlock
from tiler.core.products import (
    BEYOND,
    CANOPY,
    FILLED,
    HOLE,
    INTERPOLATED,
    MASK_VALUES,
    MEASURED,
    OUTSIDE,
    SURVEYED,
    VOID,
    WATER,
)
from tiler.core.raster import NODATA
from tiler.grid.block import full_halo, rasterise_window
from tiler.grid.block_surroundings import EditsNear, PointsNear, WatersNear
from tiler.grid.canopy import OPEN
from tiler.grid.coarse import pixels_touching
from tiler.grid.records import Facets
from tiler.grid.steps import Counts, Position
from tiler.grid.voids import hole_cells, holes_of_block

FIRST_SHARE = 4
"""Divisor of the cap for the first search of points, as few blocks need the whole cap."""


def hillshade(terrain: Float64, place: Position) -> tuple[Float64, Counts]:
    """Return the shade of the terrain, which is read with a margin of a pixel."""
    return multidirectional_hillshade(*gradients(terrain, place.pixel_in_heights)), {}


def slope(terrain: Float64, place: Position) -> tuple[Float64, Counts]:
    """Return the slope of the terrain in degrees, which is read with a margin of a pixel."""
    return slope_deg(*gradients(terrain, place.pixel_in_heights)), {}


def ndsm(surface: Float64, terrain: Float64) -> tuple[Float64, Counts]:
    """Return surface minus terrain. The surface is not below the terrain, except in voids that were filled."""
    return surface - terrain, {}


def density(points: PointsNear, place: Position) -> tuple[Float64, Counts]:
    """Return ground points per square metre."""
    counts: Float64 = points.ground_per_pixel() / place.pixel_m2
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
    survey: Float32,
    points: PointsNear,
    waters: WatersNear,
    failed: Bool,
    area: Bool,
) -> tuple[Float64, Counts]:
    """Return where the height of each pixel comes from (`tiler.core.products`).

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


def surface(
    points: PointsNear,
    terrain: Float64,
    survey: Float32,
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
    return np.where(np.isnan(terrain), heights, np.maximum(heights, terrain))


def surface_heights(
    points: PointsNear, bare: Bool, facets: Facets, reach: int, spike: Fraction
) -> tuple[Float64, Bool, Counts]:
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
    block = pixels_touching(points.spec, window)
    returns = points.returns(block, reach, spike)[0].reshape(-1, 3).T
    returns = returns[:, returns[2] != NOTHING]
    inside = PointBlock(returns).inside(window, points.frame.origin)
    return np.ascontiguousarray(returns[:, inside])


def outline(
    heights: Float64,
    survey: Float32,
    area: Bool,
    edits: EditsNear,
    waters: WatersNear | None = None,
    canopy: Float64 | None = None,
    below: Float64 | None = None,
    *,
    cut: bool,
    finds_water: bool,
) -> tuple[Float32, Counts]:
    """Return a model that ends at the outline of the survey, with level water.

    Facets span a concave border of the survey, so land
    that was never surveyed would get a height from the border. Facets also span rivers that
    leave the survey. Water keeps its height there.

    Parameters
    ----------
    heights : float64 (height, width)
    survey : float32 (height + 2, width + 2)
    area : bool (height + 2, width + 2)
        Pixels in the area of the run. Holes outside it do not count.
    edits : EditsNear
        They set heights of the terrain after water and canopy.
    waters : WatersNear, optional
        Only the terrain has them.
    canopy : float64 (height, width), optional
        Canopy. Where it hides the ground, pixels get no height.
    below : float64 (height, width), optional
        Heights below a canopy, which replace those of the model, NaN where the model stays as it is.
    cut : bool
        Whether heights beyond the survey are removed.
    finds_water : bool
        Whether the run found the water itself. Drawn water gets no height outside the survey where the model has none.

    Returns
    -------
    heights : float32 (height, width)
    counts : dict
        ``cut``: number of pixels that lost their height other than to a canopy. ``water``: key of the area of each body
        of water, and the number of its pixels. ``edited``: key of each edit of pixels, and the number of pixels that it
        changed. ``bare``: cells with pixels in places without returns that have a height
        and are not in water (`hole_cells`). ``surveyed``, ``voided``, ``holes``, ``edit_holes``: see `holes_of_block`.
    """
    nodata = np.float32(NODATA)
    had = ~np.isnan(heights)
    values = np.where(had, heights, nodata).astype(np.float32)
    if canopy is not None:
        values[canopy > OPEN] = nodata
    if below is not None:
        values = np.where(np.isnan(below), values, below).astype(np.float32)
    beyond, bare = survey[1:-1, 1:-1] == BEYOND, survey[1:-1, 1:-1] >= VOID
    water: list[tuple[str, int]] = []
    if waters is not None and waters.waters is not None:
        wet = waters.inside
        water = waters.set_heights(values, had | ~beyond | finds_water)
        beyond &= ~wet
        bare &= ~wet
    # Surfaces keep the heights of roofs and crowns.
    edited = [] if waters is None else edits.set_heights(values)
    n_cut = 0
    if cut:
        n_cut = int(np.count_nonzero(had & beyond & (values != nodata)))
        values[beyond] = nodata
    known = values != nodata
    holes = holes_of_block(known, survey >= SURVEYED, edits, area)
    return values, {
        "cut": n_cut,
        "water": water,
        "edited": edited,
        "bare": hole_cells(bare & known & area[1:-1, 1:-1], edits.block, survey < SURVEYED),
        **holes,
    }
