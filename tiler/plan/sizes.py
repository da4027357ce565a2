"""Sizes that follow from the points: buckets, tiles, pixels, and where the counts of a run begin."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import reduce

import numpy as np

from tiler.config import RunConfig
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds
from tiler.ingest import Patch, SourceInfo
from tiler.plan.density_map import DensityMap
from tiler.plan.memory import ASSEMBLY_POINT_BYTES, BASE_BYTES, PlannedPass, filter_bytes
from tiler.store import StoreMeta

BUCKET_POINTS = 100_000
BUCKETS_M = (8, 16, 32, 64, 128, 256, 512, 1024)
FETCHED_BUCKET_M = 32
"""At most, where only a part of a file at a URL is fetched: buckets are whole, also at the edge of that part."""
TILE_M = 512
TILE_POINTS = 500_000
"""Points of a tile of a sparse cloud, whose side is `SPARSE_TILE_M` at most: a task costs more than a few points do."""
SPARSE_TILE_M = 4096

FAR_FROM_MEAN = 2.0
"""From so many times the mean over the files' bounds on the density of the sample counts, rough as it is."""

SMALLEST_M2 = 1.0
"""Area of a patch at least, as of the bounds of a file."""


def density_of(
    points: int, covered_m2: float, patches: Sequence[Patch], metres: float, notes: list[str]
) -> float:
    """Points per m2: the mean over the bounds of the files, or where those are mostly void that of the median patch.

    Patches are of single files: that files lie on each other is no reason for more.
    """
    mean = points / covered_m2
    if not patches:
        return mean
    areas = [max((p.x1 - p.x0) * (p.y1 - p.y0) * metres**2, SMALLEST_M2) for p in patches]
    held = np.array([p.points for p in patches])
    densities = held / areas
    order = np.argsort(densities, kind="stable")
    half = np.searchsorted(np.cumsum(held[order]), held.sum() / 2)
    sample = float(densities[order[half]])
    if sample <= FAR_FROM_MEAN * mean:
        return mean
    notes.append(
        f"{sample:.2g} points/m2 in a sample, {mean:.2g} over the bounds of the files, which are mostly void: "
        "sizes follow from the sample"
    )
    return sample


def extent_of(sources: Sequence[SourceInfo], metres: float) -> tuple[Bounds, float]:
    """Union of the sources' bounds in absolute counts, and the area that they cover in m2 (overlaps count twice)."""
    boxes = [source.bounds for source in sources if source.bounds is not None]
    area = sum(max(x1 - x0, 1.0) * max(y1 - y0, 1.0) * metres**2 for x0, y0, _, x1, y1, _ in boxes)
    return hull_of(sources), area


def hull_of(sources: Iterable[SourceInfo]) -> Bounds:
    """The smallest bounds that hold some sources, all of which have points."""
    return reduce(Bounds.union, map(bounds_of, sources))


def bounds_of(source: SourceInfo) -> Bounds:
    """The bounds of a source that has points, in absolute counts."""
    assert source.bounds is not None  # the caller's choice
    x0, y0, _, x1, y1, _ = source.bounds
    low = (math.floor(v * COUNTS_PER_UNIT) for v in (x0, y0))
    high = (math.ceil(v * COUNTS_PER_UNIT) + 1 for v in (x1, y1))
    return Bounds(*low, *high)


def origin_of(extent: Bounds) -> tuple[int, int]:
    """The middle of the extent, on a round number: int32 counts then reach equally far to all sides."""
    step = 1000 * COUNTS_PER_UNIT
    return (extent.x0 + extent.x1) // 2 // step * step, (extent.y0 + extent.y1) // 2 // step * step


def bucket_m(density: float, density_map: DensityMap, memory: int) -> int:
    """Side of a bucket in metres: about `BUCKET_POINTS` on the mean, and in the fullest place no more than fit."""
    side = math.sqrt(BUCKET_POINTS / density)
    wanted = min(BUCKETS_M, key=lambda b: abs(math.log(b / side)))
    most = (memory - BASE_BYTES) / ASSEMBLY_POINT_BYTES
    fitting = [b for b in BUCKETS_M if b <= wanted and density_map.fullest(b) <= most]
    return max(fitting, default=BUCKETS_M[0])


def tile_m(
    memory: int, density: float, cell_m: float, passes: Iterable[PlannedPass], meta: StoreMeta
) -> Fraction:
    """Largest tile whose windows use three quarters of the memory left after start-up.

    At most `TILE_M`, where the points are sparse the side of `TILE_POINTS`: a window of little work is worth no task.
    Passes that look at every point have no influence where there are others: they need little around a tile, and their
    tiles are divided where they do not fit, but small tiles cost the others with their halos of hundreds of metres.
    """
    passes = tuple(passes)
    passes = tuple(step for step in passes if not step.work.every_point) or passes
    budget = max(memory - BASE_BYTES, memory // 4) * 3 / 4
    fine_m = meta.fine.size * meta.frame.metres_xy
    sides = [
        math.sqrt(budget / filter_bytes(density, 1.0, cell_m, step, fine_m)) - 2 * step.halo_m
        for step in passes
    ]
    most = min(max(TILE_M, math.sqrt(TILE_POINTS / density)), SPARSE_TILE_M)
    side = min(sides, default=most)
    bucket = meta.bucket.size * meta.frame.metres_xy
    return max(min(Fraction(most), Fraction(max(side, 0.0))) // bucket, 1) * bucket


def resolution_of(config: RunConfig, density: float, notes: list[str]) -> Fraction:
    """1 m, or the mean spacing of the points where that is coarser, up to ``--max-edge``."""
    if config.resolution is not None:
        return config.resolution
    spacing = 1 / math.sqrt(density)
    if spacing <= 1.05:
        return Fraction(1)
    if spacing > config.max_edge:
        notes.append(
            f"decided: pixels of {float(config.max_edge):g} m, though points are {spacing:.2g} m apart: --max-edge "
            f"{float(config.max_edge):g} m lets no height reach that far; set --resolution and --max-edge"
        )
        return config.max_edge
    resolution = Fraction(math.ceil(2 * spacing), 2)
    notes.append(
        f"decided: pixels of {float(resolution):g} m, as the points are {spacing:.2g} m apart (--resolution)"
    )
    return resolution
