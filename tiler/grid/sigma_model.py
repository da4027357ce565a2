"""Standard error of a height from measures around it: a sum of variances, each with a constant.

The constants are fitted by ``python -m tests.benchmarks.sigma_constants`` to scenes whose
terrain is known. Their accuracy on scenes that were left out of the fit is in
``docs/benchmarks.md``. LiDAR and photogrammetric clouds have different constants. For a cloud of
unknown source the larger variance counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from tiler.core.mask_values import CANOPY, WATER
from tiler.grid.sigma_measures import Measures

LASER, MATCHED = "lidar", "dim"
"""Kinds of clouds, as methods name them (`ptd.passes.RunHints`)."""
GAP_M = 0.5
"""Distance below which a ground point counts as if it were in the pixel."""

MAX_TREND_M = 10.0
"""Upper limit of the gap in the term `Weights.trend_gap`, as the window of the trend reaches
only 8.5 m."""
FLOOR_M2 = 0.02**2
"""Least variance: strips, grids and geoids differ by some centimetres, which is not in any
measure."""
LINEAR = 0.5
"""Mean variance at a random position in a triangle whose corners have noise of variance 1."""

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Weights:
    """Factors of the terms of the variance (see `terms`).

    Attributes
    ----------
    always, canopy, water : m2
    roughness, trend_objects : no unit
    gap_roughness, trend_gap : 1/m
    gap_slope, gap_objects : m
    """

    always: float
    roughness: float
    gap_roughness: float
    gap_slope: float
    gap_objects: float
    trend_objects: float
    trend_gap: float
    canopy: float
    water: float


WEIGHTS: Mapping[str, Weights] = {
    LASER: Weights(
        always=FLOOR_M2,
        roughness=LINEAR,
        gap_roughness=0.609,
        gap_slope=0.0,
        gap_objects=0.0587,
        trend_objects=0.429,
        trend_gap=0.286,
        canopy=0.0,
        water=0.0466,
    ),
    MATCHED: Weights(
        always=FLOOR_M2,
        roughness=0.905,
        gap_roughness=0.0266,
        gap_slope=0.379,
        gap_objects=0.00361,
        trend_objects=0.523,
        trend_gap=0.881,
        canopy=0.345,
        water=0.0466,
    ),
}
"""Weights by kind of cloud, fitted by ``tests/benchmarks/sigma_constants.py``."""


def terms(found: Measures, mask: npt.NDArray[np.floating]) -> dict[str, Float64]:
    """Return the terms of the variance by the names of `Weights`, without their weights.

    In water, gaps and objects do not count, as its level comes from the shores.
    """
    wet = mask == WATER
    gap = np.where(wet, 0.0, np.maximum(found.distance - GAP_M, 0.0))
    objects = np.where(wet, 0.0, found.around_objects)
    rough, off = found.roughness**2, found.off_trend**2
    return {
        "always": np.ones_like(gap),
        "roughness": rough,
        "gap_roughness": gap * rough,
        "gap_slope": gap * found.slope,
        "gap_objects": gap * objects,
        "trend_objects": off * objects,
        "trend_gap": off * np.minimum(gap, MAX_TREND_M),
        "canopy": (mask == CANOPY).astype(np.float64),
        "water": wet.astype(np.float64),
    }


def standard_error_m(
    found: Measures, mask: npt.NDArray[np.floating], kind: str | None
) -> Float64:
    """Return the standard error of heights in metres.

    Parameters
    ----------
    found : Measures
    mask : float, the shape of the measures
        Values of the mask.
    kind : str or None
        Source of the cloud: `LASER`, `MATCHED`, or None if it is not known.
    """
    parts = terms(found, mask)
    variances = [
        weighed(parts, weights) for name, weights in WEIGHTS.items() if kind in (name, None)
    ]
    sigma: Float64 = np.sqrt(np.maximum.reduce(variances))
    return sigma


def weighed(parts: Mapping[str, Float64], weights: Weights) -> Float64:
    """Return the variance in square metres."""
    total = np.zeros_like(parts["always"])
    for name, weight in asdict(weights).items():
        total += weight * parts[name]
    return total
