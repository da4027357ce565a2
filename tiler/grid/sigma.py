"""Raster of the standard error of the terrain's heights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.mask_values import CANOPY, FILLED, WATER
from tiler.core.sigma_groups import COVERED_SHARE, EDGES_M, GROUPS
from tiler.core.terrain_results import SigmaGroup, SigmaResult
from tiler.grid.below_canopy import BEND_M
from tiler.grid.block_surroundings import PointsNear
from tiler.grid.sigma_measures import Measures, measures_of
from tiler.grid.sigma_model import standard_error_m
from tiler.grid.steps import Counts

Float64 = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


def sigma(
    points: PointsNear,
    terrain: Float64,
    mask: Float64,
    kind: str | None,
    below: Float64 | None = None,
    *,
    margin: int,
    cap: Fraction,
) -> tuple[Float64, Counts]:
    """Return the standard error of the heights in vertical units.

    Parameters
    ----------
    points : PointsNear
    terrain : float64 (height + 2 * margin, width + 2 * margin)
        Delivered heights of the block and around it.
    mask : float64 (height, width)
    kind : str or None
        Source of the cloud as methods name it (`ptd.passes.RunHints`); None if it is not known.
    below : float64 (height, width), optional
        Terrain below a canopy, if it is made. There, ground farther than `BEND_M` counts as if it were as near as this.
    margin : int
    cap : Fraction
        Largest distance to ground in counts. Larger distances count as this one.

    Returns
    -------
    errors : float64 (height, width)
    counts : dict
        ``groups``: number of pixels and sum of squares in mm2 by group (`tiler.core.sigma_groups.GROUPS`).
        ``histogram``: number of pixels by the classes of `tiler.core.sigma_groups.EDGES_M`, by group.
    """
    height, width = mask.shape
    there = ~np.isnan(terrain[margin : margin + height, margin : margin + width])
    if not there.any():
        return np.full(there.shape, np.nan), {"groups": {}, "histogram": {}}
    measures = measures_of(points, terrain, margin, cap)
    if below is not None:
        limit_m = np.where(np.isnan(below), np.inf, BEND_M)
        measures = measures._replace(distance=np.minimum(measures.distance, limit_m))
    sigma_m = standard_error_m(measures, mask, kind)
    groups = {name: sigma_m[pixels] for name, pixels in _groups(measures, mask, there).items()}
    values = np.where(there, sigma_m / float(points.frame.units.vertical), np.nan)
    return values, {
        "groups": {name: _squares(errors) for name, errors in groups.items()},
        "histogram": {name: _histogram(errors) for name, errors in groups.items()},
    }


def _groups(found: Measures, mask: Float64, there: Bools) -> dict[str, Bools]:
    """Return masks of the pixels of open ground, covered ground and water, by group."""
    wet = there & (mask == WATER)
    covered = (found.near_objects >= COVERED_SHARE) | (mask == CANOPY) | (mask == FILLED)
    covered &= there & ~wet
    return dict(zip(GROUPS, (there & ~wet & ~covered, covered, wet), strict=True))


def _squares(sigma_m: Float64) -> list[int]:
    """Return the number of pixels, and the sum of squares in mm2."""
    return [sigma_m.size, int(np.rint((1000 * sigma_m) ** 2).astype(np.int64).sum())]


def _histogram(sigma_m: Float64) -> list[int]:
    """Count the pixels between consecutive `EDGES_M`. The first and last bin include all values beyond the ends."""
    bins = np.searchsorted(EDGES_M[1:-1], sigma_m, side="right")
    counts: list[int] = np.bincount(bins, minlength=len(EDGES_M) - 1).tolist()
    return counts


def sigma_result(kind: str | None, counts: Sequence[Mapping[str, Any]]) -> SigmaResult:
    """Return the summary of the standard error from the counts of its blocks.

    ``kind`` is the kind of cloud whose constants were used, or None for the larger error of both kinds.
    """
    groups = {name: _group(name, counts) for name in GROUPS}
    return SigmaResult(kind, list(EDGES_M), **groups)


def _group(name: str, counts: Sequence[Mapping[str, Any]]) -> SigmaGroup:
    """Return the pixels, the expected RMSE and the histogram of a group of ground."""
    there = [of_block for of_block in counts if name in of_block["groups"]]
    pixels, squares = (sum(of_block["groups"][name][i] for of_block in there) for i in (0, 1))
    histogram = [0] * (len(EDGES_M) - 1)
    for of_block in there:
        histogram = [a + b for a, b in zip(histogram, of_block["histogram"][name], strict=True)]
    rmse_m = round(sqrt(squares / pixels) / 1000, 4) if pixels else None
    return SigmaGroup(pixels, rmse_m, histogram)
