"""Sizes that follow from the headers: extent, density of the points, buckets, tiles and pixels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import cache, reduce

import numpy as np

from ptd.arrays import Float64, Int64, UInt64
from ptd.matched.evidence import DIM
from tiler.config import RunConfig
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.units import length_text
from tiler.inputs import DensityPatch, SourceInfo
from tiler.plan.memory import ASSEMBLY_POINT_BYTES, BASE_BYTES, filter_bytes
from tiler.plan.method import PlannedPass
from tiler.store import StoreMeta

CELL_M = 64.0
"""Side of a cell of the density map in metres, about that of a bucket."""
MAX_CELLS = 1_000_000
"""Approximate maximum number of cells of the map. Larger surveys get larger cells."""
PARTS = 8
"""Number of parts along the side of a cell. Each of the 64 parts has a bit, which is set if
points cover the part."""
_BATCH = 4096
"""Number of rectangles processed together, which limits the memory."""

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


def bounds_of(source: SourceInfo) -> Bounds:
    """Return the bounds of a source in absolute counts. The source must have points."""
    assert source.bounds is not None  # The caller selects sources with points.
    x0, y0, _, x1, y1, _ = source.bounds
    low = (math.floor(v * COUNTS_PER_UNIT) for v in (x0, y0))
    high = (math.ceil(v * COUNTS_PER_UNIT) + 1 for v in (x1, y1))
    return Bounds(*low, *high)


def union_bounds(sources: Iterable[SourceInfo]) -> Bounds:
    """Return the smallest bounds that contain some sources. Each source must have points."""
    return reduce(Bounds.union, map(bounds_of, sources))


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


class DensityMap:
    """Approximate numbers of points in the cells of a coarse lattice.

    Parameters
    ----------
    patches : iterable of DensityPatch
        Rectangles in units of the CRS. The points of a rectangle are assumed to be evenly distributed.
    metres : float
        Metres per unit of the CRS.

    Attributes
    ----------
    covered_m2 : float
        Approximate area of the patches in m2. Overlaps count once.
    """

    def __init__(self, patches: Iterable[DensityPatch], metres: float) -> None:
        rectangles = [
            (p.x0 * metres, p.y0 * metres, p.x1 * metres, p.y1 * metres, p.points)
            for p in patches
        ]
        boxes = np.array(rectangles, np.float64).reshape(-1, 5)
        width = boxes[:, 2] - boxes[:, 0]
        height = boxes[:, 3] - boxes[:, 1]
        area = float(np.sum(width * height))
        length = float(np.sum(width + height))
        self._cell = CELL_M
        while area / self._cell**2 + length / self._cell > MAX_CELLS:
            self._cell *= 2
        self._points = float(boxes[:, 4].sum())
        batches = np.split(boxes, range(_BATCH, len(boxes), _BATCH))
        shares = [_shares(batch, self._cell) for batch in batches]
        cells, points, bits = (np.concatenate(columns) for columns in zip(*shares, strict=True))
        self._cells, self._points_of_cell = _summed(cells, points)
        self.covered_m2 = _covered(cells, bits) * (self._cell / PARTS) ** 2
        # The results are cached, because a plan and each write of run.json ask for the same few
        # sides again.
        self.max_points = cache(self._max_points)
        self.squares = cache(self._squares)

    def _squares(
        self, side_m: float, low: tuple[float, float], high: tuple[float, float]
    ) -> float:
        """Estimate the number of squares of side ``side_m`` with points, between two corners in metres.

        The lattice of the squares starts at 0.
        """
        inside = np.all((self._cells + 1) * self._cell > low, axis=1)
        inside &= np.all(self._cells * self._cell < high, axis=1)
        cells, points = self._cells[inside], self._points_of_cell[inside]
        if side_m <= self._cell:
            # A point occupies one square, and a cell with many points has at most all its
            # squares occupied.
            return float(np.minimum(points, (self._cell / side_m) ** 2).sum())
        # A cell occupies the squares in which its four corners lie, up to four.
        corners = ((0, 0), (0, 0.99), (0.99, 0), (0.99, 0.99))
        squares = [(cells + corner) * self._cell // side_m for corner in corners]
        _, square_points = _summed(np.concatenate(squares).astype(np.int64), np.tile(points, 4))
        return float(np.minimum(square_points, 1.0).sum())

    def _max_points(self, side_m: float) -> float:
        """Estimate the number of points in the densest square of a side in metres."""
        if side_m <= self._cell:
            return float(self._points_of_cell.max(initial=0.0)) * (side_m / self._cell) ** 2
        # Points are counted in squares of whole cells, on four lattices shifted by half a
        # square, and scaled by area.
        count = int(side_m // self._cell)
        most = 0.0
        for east in {0, count // 2}:
            for north in {0, count // 2}:
                _, points = _summed(
                    (self._cells + (east, north)) // count, self._points_of_cell
                )
                most = max(most, float(points.max(initial=0.0)))
        return min(most * (side_m / (count * self._cell)) ** 2, self._points)


def _summed(cells: Int64, weights: Float64) -> tuple[Int64, Float64]:
    """Return the distinct cells, int64 (n, 2), and the sum of the weights of each."""
    if len(cells) == 0:
        return cells, weights
    low = cells.min(axis=0)
    height = int(cells[:, 1].max() - low[1]) + 1
    # A cell becomes a single number, because sorting pairs takes ten times as long.
    numbers, cell_index = np.unique(
        (cells[:, 0] - low[0]) * height + cells[:, 1] - low[1], return_inverse=True
    )
    distinct = np.stack(np.divmod(numbers, height), axis=1) + low
    return distinct, np.bincount(cell_index, weights).astype(np.float64)


def _covered(cells: Int64, bits: UInt64) -> int:
    """Count the covered parts of cells. A cell may occur several times."""
    if len(cells) == 0:
        return 0
    order = np.lexsort(cells.T)
    first = np.append(True, np.any(np.diff(cells[order], axis=0), axis=1))
    union = np.bitwise_or.reduceat(bits[order], np.flatnonzero(first))
    return int(np.unpackbits(union.view(np.uint8)).sum())


def _shares(boxes: Float64, cell: float) -> tuple[Int64, Float64, UInt64]:
    """Distribute the points of rectangles to cells, in proportion to area.

    Returns
    -------
    cells : int64 (n, 2)
        Column and row of a cell, for each rectangle that intersects it.
    points : float64 (n,)
        Points of the rectangle in the cell.
    bits : uint64 (n,)
        Bits of the parts of the cell that the rectangle covers.
    """
    first = np.floor(boxes[:, :2] / cell).astype(np.int64)
    counts = np.floor(boxes[:, 2:4] / cell).astype(np.int64) - first + 1
    # Each pair of a rectangle and a cell that it intersects is a row.
    box, cell_number = _enumerated(counts.prod(axis=1))
    columns = counts[box, 0]
    cells = first[box] + np.stack([cell_number % columns, cell_number // columns], axis=1)
    low, high = boxes[box, :2], boxes[box, 2:4]
    west_south = cells * cell
    sides = np.minimum(west_south + cell, high) - np.maximum(west_south, low)
    area = np.maximum(sides, 1e-9).prod(axis=1)
    box_area = np.bincount(box, area, minlength=len(boxes))
    points = area / box_area[box] * boxes[box, 4]
    columns_covered, rows_covered = _parts(low - west_south, high - west_south, cell).T
    # A product with the lowest bits of the covered rows copies the bits of the covered columns
    # into each of these rows.
    return cells, points, columns_covered * _row_starts(rows_covered)


def _enumerated(
    counts: Int64,
) -> tuple[Int64, Int64]:
    """Return the owner of each item, and its position among the items of the owner.

    ``counts`` are the numbers of items per owner. (2, 3) gives 0 0 1 1 1 and 0 1 0 1 2.
    """
    ends = np.cumsum(counts)
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - (ends - counts)[owner]


def _parts(low: Float64, high: Float64, cell: float) -> UInt64:
    """Return the bits of the parts of a cell between two distances from its edge along an axis.

    Partly covered parts count.
    """
    first, last = (
        np.floor(v / cell * PARTS).clip(0, PARTS - 1).astype(np.uint64) for v in (low, high)
    )
    one = np.uint64(1)
    return np.asarray((one << (last + one)) - (one << first), np.uint64)


def _row_starts(bits: UInt64) -> UInt64:
    """Move each bit i to position ``i * PARTS``, the lowest of a row of `PARTS` bits."""
    rows = np.arange(PARTS, dtype=np.uint64)
    one = (bits[:, None] >> rows) & np.uint64(1)
    return np.asarray((one << (rows * np.uint64(PARTS))).sum(axis=1), np.uint64)


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
    if config.pixel is not None:
        return config.pixel
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
