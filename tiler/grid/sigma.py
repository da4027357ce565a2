"""Raster of the standard error of the terrain's heights."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.mask_values import CANOPY, FILLED, WATER
from tiler.core.nodata import NODATA
from tiler.core.sigma_groups import COVERED_SHARE, EDGES_M, GROUPS
from tiler.grid.checksum import checksum
from tiler.grid.sigma_measures import Measures, measures_of
from tiler.grid.sigma_model import standard_error_m
from tiler.grid.work import PointsBlock
from tiler.store import open_store

Float64 = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class SigmaBlock(PointsBlock):
    """Arguments of `sigma_block`.

    Attributes
    ----------
    terrain, mask : str
        Rasters of the delivered heights, and of their origin (the mask).
    kind : str or None
        Source of the cloud as methods name it (`ptd.passes.RunHints`); None if it is not known.
    cap : Fraction
        Largest distance to ground in counts. Larger distances count as this one.
    """

    terrain: str
    mask: str
    kind: str | None
    cap: Fraction


def sigma_block(store_url: str, work: SigmaBlock) -> dict[str, Any]:
    """Write one block of the standard error in vertical units. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``pixels``, ``filled`` (pixels with a height); ``groups``: number and sum of squares (mm2) of the pixels of each
        group (`tiler.core.sigma_groups.GROUPS`); ``histogram``: number of its pixels by `EDGES_M`; ``checksum``.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    there = store.read_block(work.terrain, block) != np.float32(NODATA)
    values = np.full(there.shape, NODATA, np.float32)
    record: dict[str, Any] = {"groups": {}, "histogram": {}}
    if there.any():
        mask = store.read_block(work.mask, block)
        measures = measures_of(store, work.rule, spec, block, work.terrain, work.cap)
        sigma_m = standard_error_m(measures, mask, work.kind)
        unit_m = float(store.meta.frame.units.vertical)
        values = np.where(there, sigma_m / unit_m, NODATA).astype(np.float32)
        for name, pixels in _groups(measures, mask, there).items():
            record["groups"][name] = _squares(sigma_m[pixels])
            record["histogram"][name] = _histogram(sigma_m[pixels])
    store.write_block(work.name, block, values)
    filled = int(np.count_nonzero(there))
    return {"pixels": values.size, "filled": filled, **record, "checksum": checksum(values)}


def _groups(found: Measures, mask: npt.NDArray[np.float32], there: Bools) -> dict[str, Bools]:
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
