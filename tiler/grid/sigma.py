"""Raster of the standard error of the terrain's heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import sqrt

import numpy as np
import numpy.typing as npt

from tiler.core.mask_values import CANOPY, FILLED, WATER
from tiler.core.nodata import NODATA
from tiler.core.sigma_groups import COVERED_SHARE, EDGES_M, GROUPS
from tiler.core.terrain_results import SigmaGroup, SigmaResult
from tiler.grid.below_canopy import BEND_M
from tiler.grid.checksum import checksum
from tiler.grid.records import SigmaRecord
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
        Rasters of the delivered heights, and of the mask.
    below : str or None
        Raster of the terrain below a canopy. There, ground farther than `BEND_M` counts as if it were as near as this.
    kind : str or None
        Source of the cloud as methods name it (`ptd.passes.RunHints`); None if it is not known.
    cap : Fraction
        Largest distance to ground in counts. Larger distances count as this one.
    """

    terrain: str
    mask: str
    below: str | None
    kind: str | None
    cap: Fraction


def sigma_block(store_url: str, work: SigmaBlock) -> SigmaRecord:
    """Write one block of the standard error in vertical units. This is a `tiler.schedule.task.Work`.

    Returns
    -------
    SigmaRecord
        Record of the block.
    """
    store, spec, block = open_store(store_url), work.spec, work.block
    there = store.read_block(work.terrain, block) != np.float32(NODATA)
    values = np.full(there.shape, NODATA, np.float32)
    groups: dict[str, list[int]] = {}
    histogram: dict[str, list[int]] = {}
    if there.any():
        mask = store.read_block(work.mask, block)
        measures = measures_of(store, work.rule, spec, block, work.terrain, work.cap)
        if work.below is not None:
            from_crowns = store.read_block(work.below, block) != np.float32(NODATA)
            limit_m = np.where(from_crowns, BEND_M, np.inf)
            measures = measures._replace(distance=np.minimum(measures.distance, limit_m))
        sigma_m = standard_error_m(measures, mask, work.kind)
        unit_m = float(store.meta.frame.units.vertical)
        values = np.where(there, sigma_m / unit_m, NODATA).astype(np.float32)
        for name, pixels in _groups(measures, mask, there).items():
            groups[name] = _squares(sigma_m[pixels])
            histogram[name] = _histogram(sigma_m[pixels])
    store.write_block(work.name, block, values)
    filled = int(np.count_nonzero(there))
    return SigmaRecord(
        pixels=values.size,
        filled=filled,
        groups=groups,
        histogram=histogram,
        checksum=checksum(values),
    )


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


def sigma_result(kind: str | None, records: Sequence[SigmaRecord]) -> SigmaResult:
    """Return the summary of the standard error from the records of its blocks.

    ``kind`` is the kind of cloud whose constants were used, or None for the larger error of both kinds.
    """
    groups = {name: _group(name, records) for name in GROUPS}
    return SigmaResult(kind, list(EDGES_M), **groups)


def _group(name: str, records: Sequence[SigmaRecord]) -> SigmaGroup:
    """Return the pixels, the expected RMSE and the histogram of a group of ground."""
    pixels, squares, histogram = 0, 0, [0] * (len(EDGES_M) - 1)
    for record in records:
        if name not in record.groups:
            continue
        n, sum_mm2 = record.groups[name]
        pixels, squares = pixels + n, squares + sum_mm2
        histogram = [a + b for a, b in zip(histogram, record.histogram[name], strict=True)]
    rmse_m = None
    if pixels:
        rmse_m = round(sqrt(squares / pixels) / 1000, 4)
    return SigmaGroup(pixels, rmse_m, histogram)
