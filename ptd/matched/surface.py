"""Ground surface from cells: hulls that bend more where the cells show it, then the mean of the cells near them.

1. A hull below the cells bends as much as the cells show (`ptd.matched.bent_hull`).
2. The mean residual of the cells near the surface is added `ROUNDS` times, at two scales. In
   the last rounds cells that rise next to objects count less. The noise is the root mean square
   of the residuals below the surface, because cells above it may be plants.
3. Ground grows to the edges of terraces and banks (`ptd.matched.growth`). Then the mean
   residual is added at a still smaller scale, so that the surface comes nearer to each cell's
   own height.

Gaussian sums over cells are cut off at a fixed radius, so cells beyond `reach_cells` do not
change the surface.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from ptd.arrays import Bool, Float64, Int32
from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale
from ptd.ground.cut_off_land import REACH_CELLS, on_summits, without_thin
from ptd.ground.morphology import CellRaster
from ptd.matched import bent_hull, growth
from ptd.matched.bent_hull import (
    RemainingCells,
    gaussian_radius,
    ramp,
    share_radius,
    slope_radius,
    smoothed,
)
from ptd.matched.cells import CELL_M, EMPTY
from ptd.matched.hull import LOWEST, Envelope, lower_envelope

ROUNDS = 6
SCALES_M, SCALES_CELLS = (3.0, 1.5), (2.0, 1.0)
"""Standard deviations in metres, and their minimum in cells, of the surroundings whose mean
residual is added. The mean of few cells is uncertain."""
FEW = 0.05
"""Weight of a residual of 0, so that few cells move the surface little."""
PLAIN_ROUNDS, BESIDE = 3, 0.2
"""Number of rounds with equal weights, and later weight of cells above the surface that touch
one too high to be ground. They are the rounded edges of cars, walls and plants. In the first
rounds the surface still climbs onto banks."""
FINE_ROUNDS, FINE_M, FINE_CELLS, FINE_BESIDE = 2, 1.0, 1.0, 0.1
"""Settings of the last rounds.

They are the number of rounds, the standard deviation (in metres, and its minimum in cells) of
the surroundings whose mean residual is added, and the weight of cells that rise next to
objects. Where the ground bends, at the foot of a bank, a cell's own height is more accurate
than a wide mean, because it is the median of many points. The weight is less than `BESIDE`,
because fewer cells are averaged.
"""
EDGE_ROUNDS = 2
"""Number of times that the mean residual is added, at the smaller scale, where ground grew to
an edge."""
ABOVE_M, ABOVE_SIGMAS, BELOW_M, BELOW_SIGMAS = 0.1, 2.5, 0.3, 3.0
"""Largest distances of cells near the surface, above and below it: metres, plus a multiple of
the local noise."""
ABOUT_SLOPE = 0.15
"""Addition to these distances in metres per unit of slope. It counts twice below the surface,
because ground on slopes would be lost there."""
GAP, NARROWEST, GAP_TERRAIN = (0.1, 0.55), 0.25, 0.5
"""Settings of the band of ground among low plants.

- `GAP`: contrasts up to which the band above the surface is whole, and at which it becomes
  narrowest.
- `NARROWEST`: smallest factor by which the band is multiplied.
- `GAP_TERRAIN`: weight of cells that are terrain as a whole, which is less because they may be
  banks.
"""
NOISE_M, NOISE_MOST, NOISE_FEW = 4.0, 2.5, 0.02
"""Standard deviation of the surroundings from which noise is computed, its limit as a multiple
of the place's noise, and the weight of the place's noise."""
SUMMIT_M, THICK_M = 18.0, 2.5
"""Distances along rows and columns: of the edges that decide whether a cell belongs to a ridge,
and of the cells that must belong to it too (`ptd.ground.cut_off_land`). Thin strips are the lower
parts of facades."""
MILLIMETRES = Scale()
EXTENDED_M = (1.0, 6.0)
"""Standard deviations of the surroundings whose mean continues the surface beyond its cells.
Ground exists only within the first: farther away a single cell would give the ground below a
whole roof."""


class Surface(NamedTuple):
    """The ground surface of a raster of cells.

    Attributes
    ----------
    height : float64 [rows, columns]
        Height of the surface in metres, NaN where no cell is near.
    sigma : float64 [rows, columns]
        Noise of the cells about the surface in metres.
    narrowing : float64 [rows, columns]
        Factor of the band of ground: 1 where there is a gap above the ground, and less the more cells lie just above
        it; NaN where there is no ground.
    """

    height: Float64
    sigma: Float64
    narrowing: Float64


def _scales(cell_m: float) -> list[float]:
    """Return the standard deviations, in cells, of the surroundings whose mean residual is added."""
    return [max(m / cell_m, least) for m, least in zip(SCALES_M, SCALES_CELLS, strict=True)]


def _fine_scale(cell_m: float) -> float:
    """Return the standard deviation, in cells, of the surroundings in the last rounds."""
    return max(FINE_M / cell_m, FINE_CELLS)


def reach_cells(cell_m: float, *, summits: bool = True) -> int:
    """Return the distance in cells beyond which heights do not change the surface, with or without summits."""
    about = max(slope_radius(cell_m), gaussian_radius(NOISE_M / cell_m))
    about += share_radius(bent_hull.CONTRAST_M, cell_m)
    rounds = (
        ROUNDS * sum(gaussian_radius(cells) for cells in _scales(cell_m))
        + ROUNDS
        - PLAIN_ROUNDS
    )
    edges = growth.reach_cells(cell_m) + (1 + EDGE_ROUNDS) * gaussian_radius(
        _scales(cell_m)[-1]
    )
    fine = FINE_ROUNDS * (gaussian_radius(_fine_scale(cell_m)) + 1)
    extended = gaussian_radius(max(EXTENDED_M) / cell_m)
    ridges = round(SUMMIT_M / cell_m) + REACH_CELLS + 2 * _thick_cells(cell_m)
    cut_cells = replace(bent_hull.STIFF, cell_m=cell_m).cut_cells
    bent = bent_hull.reach_cells(cell_m)
    return cut_cells + bent + 2 * about + rounds + edges + ridges * summits + fine + extended


def ground_surface(
    heights: Int32,
    terrain: Bool,
    sigma_m: float | Float64,
    scale: Scale,
    row: int,
    column: int,
    cell_m: float = CELL_M,
    bare: Bool | None = None,
) -> Surface:
    """Fit the ground surface to the heights of cells.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights, in vertical counts, of the cells that do not belong to large objects; `EMPTY` elsewhere.
        Cells at the raster's edges must be empty.
    terrain : bool [rows, columns]
        Cells of surfaces that are terrain as a whole (`ptd.matched.objects`).
    sigma_m : float or float64 [rows, columns]
        Noise of the place in metres.
    scale : Scale
    row, column : int
        Row and column of the first cell on its lattice.
    cell_m : float
        Size of the cells in metres.
    bare : bool [rows, columns], optional
        Cells that no canopy covers, where ridges above the hulls are put back. None by default.
    """
    # A hull may cut through isolated groups of few cells.
    group, _ = scipy.ndimage.label(heights != EMPTY, np.ones((3, 3)))
    few = replace(bent_hull.STIFF, cell_m=cell_m).cut_cells
    many = np.bincount(group.ravel())[group] > few
    heights = np.where(many, heights, EMPTY).astype(np.int32)
    there = heights != EMPTY
    metres = 1.0 / scale.counts_z(1.0)
    cells = RemainingCells(np.where(there, heights * metres, 0.0), there, cell_m)

    def hull(envelope: Envelope) -> Float64:
        lowest = lower_envelope(heights, replace(envelope, cell_m=cell_m), scale, row, column)
        return np.where(there & (lowest != LOWEST), lowest * metres, 0.0)

    start = bent_hull.bent_hull(cells, terrain, hull, sigma_m)
    height, sigma, narrowing = _refined(cells, terrain, start, sigma_m, bare)
    return _extended(cells, height, sigma, narrowing)


def noise_reach_cells(cell_m: float) -> int:
    """Return the distance in cells beyond which cells do not change the result of `with_noise`."""
    about = max(slope_radius(cell_m), gaussian_radius(NOISE_M / cell_m))
    return (
        about
        + share_radius(bent_hull.CONTRAST_M, cell_m)
        + gaussian_radius(max(EXTENDED_M) / cell_m)
    )


def with_noise(
    heights: Int32,
    ground: Float64,
    sigma_m: float | Float64,
    scale: Scale,
    cell_m: float = CELL_M,
) -> Surface:
    """Complete the surface of another method: measure noise and narrowing, and extend it beyond its cells.

    Parameters
    ----------
    heights : int32 [rows, columns]
        Heights of the cells in vertical counts; `EMPTY` elsewhere. Cells at the raster's edges must
        be empty.
    ground : float64 [rows, columns]
        Height of the ground at the cells in vertical counts, NaN where unknown.
    sigma_m : float or float64 [rows, columns]
        Noise of the place in metres.
    scale : Scale
    cell_m : float
        Size of the cells in metres.
    """
    there = (heights != EMPTY) & ~np.isnan(ground)
    metres = 1.0 / scale.counts_z(1.0)
    cells = RemainingCells(np.where(there, heights * metres, 0.0), there, cell_m)
    below: Float64 = np.where(there, ground * metres, 0.0)
    sigma, narrowing, _, _ = _noise_and_band(cells, np.zeros_like(there), below, sigma_m)
    return _extended(cells, below, sigma, narrowing)


def _refined(
    cells: RemainingCells,
    terrain: Bool,
    surface: Float64,
    sigma_m: float | Float64,
    bare: Bool | None,
) -> tuple[Float64, Float64, Float64]:
    """Move a surface to the mean of the cells near it.

    Returns the surface, the noise of the cells, and the narrowing of the band in plants
    (`Surface`).
    """
    _, _, above, below = _noise_and_band(cells, terrain, surface, sigma_m)
    for k in range(ROUNDS):
        weight = _weights(cells, surface, above, below, 1.0 if k < PLAIN_ROUNDS else BESIDE)
        for std in _scales(cells.cell_m):
            mean = smoothed(weight * (cells.height - surface), std) / (
                smoothed(weight, std) + FEW
            )
            surface = surface + np.where(cells.there, mean, 0.0)
    sigma, narrowing, above, below = _noise_and_band(cells, terrain, surface, sigma_m)
    surface = _to_edges(cells, terrain, surface, sigma, narrowing, above, below)
    if bare is not None and (bare & cells.there).any():
        surface = _with_summits(cells, surface, above, below, bare)
    std = _fine_scale(cells.cell_m)
    for _ in range(FINE_ROUNDS):
        weight = _weights(cells, surface, above, below, FINE_BESIDE)
        mean = smoothed(weight * (cells.height - surface), std) / (smoothed(weight, std) + FEW)
        surface = surface + np.where(cells.there, mean, 0.0)
    return surface, sigma, narrowing


def _weights(
    cells: RemainingCells, surface: Float64, above: Float64, below: Float64, beside: float
) -> Float64:
    """Return the weights of cells: 1 for those near the surface, 0 for all others.

    Cells near and above the surface that touch one too high to be ground have the weight
    ``beside``.
    """
    residual = cells.height - surface
    weight = np.where(cells.there & (residual < above) & (residual > -below), 1.0, 0.0)
    if beside < 1.0:
        objects = scipy.ndimage.maximum_filter(
            cells.there & (residual >= above), 3, mode="constant"
        )
        weight[objects & (residual > 0.0)] *= beside
    return weight


def _to_edges(
    cells: RemainingCells,
    terrain: Bool,
    surface: Float64,
    sigma: Float64,
    narrowing: Float64,
    above: Float64,
    below: Float64,
) -> Float64:
    """Return the surface after growth to the edges of terraces and banks, changed only near cells that joined."""
    residual = cells.height - surface
    ground = cells.there & (residual < above) & (residual > -below)
    higher = np.where(cells.there & (residual >= above), residual, np.nan)
    joined = growth.grown(
        cells.height, cells.there, ground, higher, terrain, sigma, narrowing, cells.cell_m
    )
    joins = ~np.isnan(joined)
    if not joins.any():
        return surface
    surface = np.where(joins, joined, surface)
    weight = (ground | joins).astype(np.float64)
    std = _scales(cells.cell_m)[-1]
    near = cells.there & scipy.ndimage.maximum_filter(
        joins, 2 * gaussian_radius(std) + 1, mode="constant"
    )
    for _ in range(EDGE_ROUNDS):
        mean = smoothed(weight * (cells.height - surface), std)
        surface = surface + np.where(near, mean / (smoothed(weight, std) + FEW), 0.0)
    return surface


def _with_summits(
    cells: RemainingCells, surface: Float64, above: Float64, below: Float64, bare: Bool
) -> Float64:
    """Return the surface with the height of each bare cell that belongs to a ridge or summit above it."""
    residual = cells.height - surface
    lost = (bare & (residual >= above))[cells.there]
    ground = ((residual > -below) & (residual < above))[cells.there]
    rows, columns = np.nonzero(cells.there)
    x, y = np.rint(1000 * cells.cell_m * np.stack([columns + 0.5, rows + 0.5])).astype(np.int32)
    points = Xyz(x, y, np.rint(1000 * cells.height[cells.there]).astype(np.int32))
    raster = CellRaster(x, y, CellLattice.of(cells.cell_m, MILLIMETRES))
    around = round(SUMMIT_M / cells.cell_m)
    found = on_summits(points, lost, ground, raster, MILLIMETRES, cells.cell_m, around)
    found = without_thin(found, raster, _thick_cells(cells.cell_m))
    raised = surface.copy()
    raised[rows[found], columns[found]] = cells.height[rows[found], columns[found]]
    return raised


def _thick_cells(cell_m: float) -> int:
    """Return the distance in cells of the cells that must belong to a ridge, too."""
    return max(math.floor(THICK_M / cell_m), 1)


def _noise_and_band(
    cells: RemainingCells, terrain: Bool, surface: Float64, sigma_m: float | Float64
) -> tuple[Float64, Float64, Float64, Float64]:
    """Return noise and narrowing of the band of cells near a surface, and its extent above and below the surface."""
    slope, residual = cells.slope(surface), cells.height - surface
    sigma = _noise(cells, residual, sigma_m)
    above = ABOVE_M + ABOVE_SIGMAS * sigma + ABOUT_SLOPE * slope
    below = BELOW_M + BELOW_SIGMAS * sigma + 2 * ABOUT_SLOPE * slope
    on = cells.around(
        cells.there & (residual > -below) & (residual < above), bent_hull.CONTRAST_M
    )
    just_above = cells.there & (residual >= above) & (residual < 2 * above)
    next_above = cells.around(
        just_above * (1.0 - (1.0 - GAP_TERRAIN) * terrain), bent_hull.CONTRAST_M
    )
    narrowing = 1.0 - (1.0 - NARROWEST) * ramp(next_above / np.maximum(on, 1e-3), GAP)
    return sigma, narrowing, above * narrowing, below * (2.0 - narrowing)


def _noise(cells: RemainingCells, residual: Float64, sigma_m: float | Float64) -> Float64:
    """Return the noise around each cell: the root mean square of the residuals below the surface.

    The place's noise counts as a further residual, so it prevails where there are few. The
    result is limited.
    """
    below = cells.there & (residual < 0.0) & (residual > -6.0 * sigma_m)
    weight = cells.smoothed(below.astype(np.float64), NOISE_M)
    squares = cells.smoothed(np.where(below, residual * residual, 0.0), NOISE_M)
    local = np.sqrt((squares + NOISE_FEW * sigma_m**2) / (weight + NOISE_FEW))
    return np.minimum(local, NOISE_MOST * sigma_m)


def _extended(
    cells: RemainingCells, surface: Float64, sigma: Float64, narrowing: Float64
) -> Surface:
    """Return the surface at cells, the mean of near cells around them, and NaN beyond."""
    there = cells.there
    heights = np.where(there, surface, np.nan)
    for std_m in EXTENDED_M:
        weight = cells.smoothed(there.astype(np.float64), std_m)
        mean = cells.smoothed(np.where(there, surface, 0.0), std_m) / np.maximum(weight, 1e-12)
        heights = np.where(np.isnan(heights) & (weight > 1e-6), mean, heights)
        if std_m == EXTENDED_M[0]:
            narrowing = np.where(np.isnan(heights), np.nan, narrowing)
    return Surface(heights, sigma, narrowing)
