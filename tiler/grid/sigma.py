"""The standard error of the terrain's heights, pixel by pixel."""

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
    """Work: one block of the standard error.

    Attributes
    ----------
    terrain, mask : str
        Rasters of the delivered heights, and of where they come from.
    kind : str or None
        What made the cloud, as methods name it (`ptd.passes.RunHints`); None: not known.
    cap : Fraction
        Counts: ground that is farther than this counts as this far.
    """

    terrain: str
    mask: str
    kind: str | None
    cap: Fraction


def sigma_block(store_url: str, work: SigmaBlock) -> dict[str, Any]:
    """Write one block of the standard error in the unit of the heights; a `tiler.schedule.task.Work`.

    Returns
    -------
    dict
        ``pixels``, ``filled`` (pixels with a height); ``groups``: pixels and sum of squares (mm2) of each of
        `tiler.core.sigma_groups.GROUPS`; ``histogram``: of each of these, pixels by the `EDGES_M`; ``checksum``.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    there = store.read_block(work.terrain, block) != np.float32(NODATA)
    values = np.full(there.shape, NODATA, np.float32)
    record: dict[str, Any] = {"groups": {}, "histogram": {}}
    if there.any():
        mask = store.read_block(work.mask, block)
        found = measures_of(store, work.rule, spec, block, work.terrain, work.cap)
        sigma_m = standard_error_m(found, mask, work.kind)
        unit_m = float(store.meta.frame.units.vertical)
        values = np.where(there, sigma_m / unit_m, NODATA).astype(np.float32)
        for name, pixels in _groups(found, mask, there).items():
            record["groups"][name] = _squares(sigma_m[pixels])
            record["histogram"][name] = _histogram(sigma_m[pixels])
    store.write_block(work.name, block, values)
    filled = int(np.count_nonzero(there))
    return {"pixels": values.size, "filled": filled, **record, "checksum": checksum(values)}


def _groups(found: Measures, mask: npt.NDArray[np.float32], there: Bools) -> dict[str, Bools]:
    """Pixels of water, of covered and of open ground."""
    wet = there & (mask == WATER)
    covered = (found.near_objects >= COVERED_SHARE) | (mask == CANOPY) | (mask == FILLED)
    covered &= there & ~wet
    return dict(zip(GROUPS, (there & ~wet & ~covered, covered, wet), strict=True))


def _squares(sigma_m: Float64) -> list[int]:
    """Number of pixels, and sum of squares in mm2."""
    return [sigma_m.size, int(np.rint((1000 * sigma_m) ** 2).astype(np.int64).sum())]


def _histogram(sigma_m: Float64) -> list[int]:
    """Pixels between one of `EDGES_M` and the next, those beyond the ends with the first and last."""
    bins = np.searchsorted(EDGES_M[1:-1], sigma_m, side="right")
    counts: list[int] = np.bincount(bins, minlength=len(EDGES_M) - 1).tolist()
    return counts
