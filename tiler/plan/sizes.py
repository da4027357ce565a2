"""Sizes of buckets, tiles and pixels that follow from the points, and the origin of the counts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import reduce

import numpy as np

from ptd.matched.evidence import DIM
from tiler.config import RunConfig
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.units import length_text
from tiler.inputs import SourceInfo
from tiler.plan.density_map import DensityMap
from tiler.plan.memory import ASSEMBLY_POINT_BYTES, BASE_BYTES, PlannedPass, filter_bytes
from tiler.store import StoreMeta

BUCKET_POINTS = 100_000
"""Approximate mean number of points in a bucket."""
BUCKETS_M = (8, 16, 32, 64, 128, 256, 512, 1024)
"""Possible sides of a bucket, in metres."""
FETCHED_BUCKET_M = 32
"""Largest bucket in metres if only a part of a file at a URL is fetched. Buckets at the edge
are fetched completely."""
TILE_M = 512
"""Largest side of a tile in metres, unless the cloud is sparse."""
TILE_POINTS = 500_000
"""Approximate number of points in a tile of a sparse cloud. Fewer points are not worth a
task."""
SPARSE_TILE_M = 4096
"""Largest side of a tile of a sparse cloud, in metres."""

FINE_PIXELS_M = (Fraction(1, 10), Fraction(1, 4), Fraction(1, 2))
"""Default pixels of dense photogrammetric clouds, in metres."""
PIXELS_FT = (Fraction(1, 10), Fraction(1, 5), Fraction(1, 2), *map(Fraction, (1, 2, 5, 10)))
"""Default pixels in a CRS with another unit than the metre, in that unit."""
USUAL_FT = Fraction(2)
"""Pixel, in the unit of the CRS, that replaces the pixel of 1 m if that unit is not the
metre."""
MATCHED_POINTS = 9.0
"""Minimum mean number of points per pixel of a photogrammetric cloud. The mean of several
heights is more accurate than a single height, and smaller pixels would not show more relief."""
MOSTLY_VOID = 0.5
"""Minimum share of the files' bounds that a sample of the points covers if the area of the
bounds is used. Below it, the area that the sample covers is used, although it is only
approximate."""


def covered_m2(
    bounds: Iterable[Sequence[float]],
    points: int,
    density_map: DensityMap,
    metres: float,
    notes: list[str],
) -> float:
    """Return the area in m2 that the points cover.

    It is the area of the bounds of the files or, if these are mostly void, of a sample.
    Overlaps count once.

    Parameters
    ----------
    bounds : iterable of 6 float
        Lowest x, y, z and highest x, y, z of each file with points, in units of the CRS.
    points : int
        Number of points of all files.
    density_map : DensityMap
    metres : float
        Metres per unit of the CRS.
    notes : list of str
        List to which a note on the decision is appended.
    """
    whole = _area_of_union(
        [(b[0], b[1], max(b[3], b[0] + 1), max(b[4], b[1] + 1)) for b in bounds]
    )
    whole *= metres**2
    sample = density_map.covered_m2
    if not 0 < sample < MOSTLY_VOID * whole:
        return whole
    notes.append(
        f"the bounds of the files are mostly void ({points / whole:.2g} points/m2 within them, "
        f"{points / sample:.2g} points/m2 where a sample lies): sizes follow from the sample"
    )
    return sample


def _area_of_union(boxes: Sequence[Sequence[float]]) -> float:
    """Return the area that rectangles (x0, y0, x1, y1) cover together."""
    if len(boxes) == 1:  # This avoids the import, which takes longer than the rest of a plan.
        ((x0, y0, x1, y1),) = boxes
        return (x1 - x0) * (y1 - y0)
    import shapely

    return float(shapely.union_all(shapely.box(*np.array(boxes).T)).area)


def union_bounds(sources: Iterable[SourceInfo]) -> Bounds:
    """Return the smallest bounds that contain some sources. Each source must have points."""
    return reduce(Bounds.union, map(bounds_of, sources))


def bounds_of(source: SourceInfo) -> Bounds:
    """Return the bounds of a source in absolute counts. The source must have points."""
    assert source.bounds is not None  # The caller selects sources with points.
    x0, y0, _, x1, y1, _ = source.bounds
    low = (math.floor(v * COUNTS_PER_UNIT) for v in (x0, y0))
    high = (math.ceil(v * COUNTS_PER_UNIT) + 1 for v in (x1, y1))
    return Bounds(*low, *high)


def middle(extent: Bounds) -> tuple[float, float]:
    """Return the middle of an extent in units of the CRS."""
    return (extent.x0 + extent.x1) / 2 / COUNTS_PER_UNIT, (
        extent.y0 + extent.y1
    ) / 2 / COUNTS_PER_UNIT


def origin_of(extent: Bounds) -> tuple[int, int]:
    """Return the rounded middle of the extent, from which int32 counts extend equally far to all sides."""
    step = 1000 * COUNTS_PER_UNIT
    return (extent.x0 + extent.x1) // 2 // step * step, (
        extent.y0 + extent.y1
    ) // 2 // step * step


def bucket_m(density: float, density_map: DensityMap, memory: int) -> int:
    """Return the side of a bucket in metres.

    A bucket has about `BUCKET_POINTS` points on average, and in the densest place no more
    points than fit into memory.
    """
    side = math.sqrt(BUCKET_POINTS / density)
    preferred_m = min(BUCKETS_M, key=lambda b: abs(math.log(b / side)))
    max_points = (memory - BASE_BYTES) / ASSEMBLY_POINT_BYTES
    fitting = [
        b for b in BUCKETS_M if b <= preferred_m and density_map.max_points(b) <= max_points
    ]
    return max(fitting, default=BUCKETS_M[0])


def tile_m(
    memory: int, density: float, cell_m: float, passes: Iterable[PlannedPass], meta: StoreMeta
) -> Fraction:
    """Return the side in metres of the largest tile that fits into three quarters of the memory.

    The side is at most `TILE_M`, or in sparse clouds the side of a tile of `TILE_POINTS`.
    Passes that read every point are ignored if there are other passes: their halos are small,
    so their tiles can be divided if they do not fit. Other passes have halos of hundreds of
    metres, so small tiles would multiply their work.
    """
    passes = tuple(passes)
    passes = tuple(step for step in passes if not step.pass_.every_point) or passes
    # If `BASE_BYTES` leaves less than a quarter of the memory, a quarter is assumed.
    budget = max(memory - BASE_BYTES, memory // 4) * 3 / 4
    fine_m = meta.fine.size * meta.frame.metres_xy
    sides = [
        math.sqrt(budget / filter_bytes(density, 1.0, cell_m, step, fine_m)) - 2 * step.halo_m
        for step in passes
    ]
    max_side = min(max(TILE_M, math.sqrt(TILE_POINTS / density)), SPARSE_TILE_M)
    side = min([max_side, *sides])
    bucket = meta.bucket.size * meta.frame.metres_xy
    return max(Fraction(max(side, 0.0)) // bucket, 1) * bucket


def resolution_of(
    config: RunConfig, density: float, kind: str | None, unit: Fraction, notes: list[str]
) -> Fraction:
    """Return the side of a pixel in metres, as given by the user, or else a default.

    The default is 1 m, or about the mean spacing of the points if that is coarser, up to
    ``--max-edge``. For photogrammetric clouds it is the finest of `FINE_PIXELS_M` with at least
    `MATCHED_POINTS` points.

    If the unit of the CRS is not the metre, the default is one of `PIXELS_FT` in that unit, and
    2 ft replace 1 m. Then sheets of round numbers of feet have whole numbers of pixels.

    Parameters
    ----------
    config : RunConfig
    density : float
        Points per m2.
    kind : {"lidar", "dim"} or None
        Source of the clouds, given by the user or decided from their points; None if unknown.
    unit : Fraction
        Metres per unit of the CRS.
    notes : list of str
        List to which a note on the decision is appended.
    """
    if config.resolution is not None:
        return config.resolution
    spacing = 1 / math.sqrt(density)
    finest = _finest_pixel(density, unit) if kind == DIM else None
    if finest is not None:
        n_points = density * float(finest) ** 2
        notes.append(
            f"decided: pixels of {length_text(finest, unit)}, which contain about {n_points:.0f} points each, "
            "because image matching smooths smaller details (--resolution)"
        )
        return finest
    if spacing <= 1.05:
        usual = Fraction(1) if unit == 1 else USUAL_FT * unit
        notes.append(
            f"decided: pixels of {length_text(usual, unit)}, the default for clouds of this density (--resolution)"
        )
        return usual
    if spacing > config.max_edge:
        notes.append(
            f"decided: pixels of {length_text(config.max_edge, unit)}, although points are "
            f"{length_text(round(spacing, 2), unit)} apart, because facets with edges above "
            f"--max-edge {float(config.max_edge):g}m have no heights; set --resolution and --max-edge"
        )
        return config.max_edge
    resolution = Fraction(math.ceil(2 * spacing), 2)
    if unit != 1:
        multiple_of_10 = math.ceil(spacing / unit / 10) * 10 * unit
        resolution = next(
            (side * unit for side in PIXELS_FT if side * unit >= spacing), multiple_of_10
        )
    notes.append(
        f"decided: pixels of {length_text(resolution, unit)}, because the points are "
        f"{length_text(round(spacing, 2), unit)} apart (--resolution)"
    )
    return resolution


def _finest_pixel(density: float, unit: Fraction) -> Fraction | None:
    """Return the finest pixel of a photogrammetric cloud in metres, round in units of the CRS.

    None if the points are too few for a fine pixel.
    """
    sides = (
        FINE_PIXELS_M
        if unit == 1
        else tuple(side * unit for side in PIXELS_FT if side <= USUAL_FT)
    )
    return next((side for side in sides if density * float(side) ** 2 >= MATCHED_POINTS), None)
