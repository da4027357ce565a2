"""Features of the cells of a surface, for the last look at points (`ptd.matched.last_look`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ptd.cells import Int32, Int64
from ptd.ground.morphology import Bool

HIGH_MM = 1000
"""Height above the surface up to which low plants are distinguished from what is certainly not
ground."""

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Around:
    """Features of the cells of a surface and their surroundings.

    Attributes
    ----------
    features : int32 [cells, 1 + len(CELL_FEATURES)]
        Features by rows of cells. The first is the largest distance of ground from the surface, in millimetres.
    columns : int
        Number of cells in a row.
    """

    features: Int32
    columns: int


CELL_FEATURES = (
    "noise", "slope", "bend_2", "bend_5", "bend_10", "low_5", "low_10", "high_5", "high_10", "ground_5",
)  # fmt: skip
"""Features of a cell. The first five are noise and slope of the surface, and its height above
its mean within 2, 5 and 10 m. The others are the shares of low plants and of higher objects
among the cells within 5 and 10 m, and of ground within 5 m."""
CELL_REACH_M = 10.0
"""Distance beyond which cells do not change these features."""
STEEPEST = 5.0
"""Limit at which slopes are cut off."""


def reach_cells(cell_m: float) -> int:
    """Return the distance in cells, including a point's own, beyond which the surface does not change its label."""
    return math.ceil(CELL_REACH_M / cell_m) + 1


def around_cells(
    heights_m: Float64,
    there: Bool,
    ground_m: Float64,
    sigma_m: Float64,
    band_m: Float64,
    cell_m: float,
) -> Around:
    """Compute the features of each cell.

    Parameters
    ----------
    heights_m : float64 [rows, columns]
        Heights of the cells in metres.
    there : bool [rows, columns]
        Mask of the cells that have a height.
    ground_m : float64 [rows, columns]
        Height of the surface in metres, NaN where unknown.
    sigma_m, band_m : float64 [rows, columns]
        Noise, and largest distance of ground from the surface, in metres.
    cell_m : float
        Size of the cells in metres.
    """
    known = there & ~np.isnan(ground_m)
    surface = np.where(np.isnan(ground_m), 0, np.rint(1000 * np.nan_to_num(ground_m))).astype(
        np.int64
    )
    residual = np.where(known, np.rint(1000 * heights_m) - surface, 0).astype(np.int64)
    band = np.maximum(np.rint(1000 * np.nan_to_num(band_m)), 1).astype(np.int64)

    def share(which: Bool, metres: float) -> Int64:
        r = round(metres / cell_m)
        return 1000 * _boxes(which, r) // np.maximum(_boxes(known, r), 1)

    def bend(metres: float) -> Int64:
        r = round(metres / cell_m)
        near = np.maximum(_boxes(known, r), 1)
        bend_mm: Int64 = np.clip(
            surface - _boxes(np.where(known, surface, 0), r) // near, -30_000, 30_000
        )
        return bend_mm

    low = known & (residual > band) & (residual < HIGH_MM)
    high = known & (residual >= HIGH_MM)
    ground = known & (np.abs(residual) < band)
    north, east = np.gradient(ground_m, cell_m)
    slope = np.where(
        known, np.nan_to_num(np.rint(1000 * np.minimum(np.hypot(north, east), STEEPEST))), 0
    )
    features = (
        band, np.rint(1000 * sigma_m), slope, bend(2.0), bend(5.0), bend(CELL_REACH_M), share(low, 5.0),
        share(low, CELL_REACH_M), share(high, 5.0), share(high, CELL_REACH_M), share(ground, 5.0),
    )  # fmt: skip
    return Around(
        np.stack(features, axis=-1).reshape(-1, len(features)).astype(np.int32), there.shape[1]
    )


def _boxes(values: npt.NDArray[np.generic], r: int) -> Int64:
    """Return sums over the squares with 2 r + 1 cells on a side, with values of 0 beyond the raster."""
    padded = np.pad(values.astype(np.int64), ((r + 1, r), (r + 1, r)))
    sums = padded.cumsum(axis=0).cumsum(axis=1)
    k = 2 * r + 1
    box_sums: Int64 = sums[k:, k:] - sums[:-k, k:] - sums[k:, :-k] + sums[:-k, :-k]
    return box_sums
