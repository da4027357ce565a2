"""Division of the survey into filter tiles: sets of buckets with a window that fits into the memory of a worker.

The survey is divided in one of two ways:

- The tiles are the cells of a lattice, and cells that do not fit are quartered. All passes use
  these tiles if the user chose a tile size. Otherwise only passes that read every point use them.
- The survey is halved until each tile fits and each worker has a tile. Passes on candidates or
  elected points (one point per cell) use these tiles. They are larger, because their windows
  need less memory, and because passes on elected points have halos of up to 678 m.

The tiles depend on the numbers of points in the buckets. They also depend on the memory of the
first run on the store, but not on the memory of later runs, so that the tiles stay the same.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple

from ptd.tin.mesh import MAX_EXTENT
from tiler.core.lattice import Cell, Lattice
from tiler.plan import Plan, PlannedPass
from tiler.plan.memory import filter_bytes, tile_peak
from tiler.plan.method import MAX_HALF, MAX_HALO_FACTOR, widest_halo
from tiler.plan.sizes import SPARSE_TILE_M

MAX_WINDOW = MAX_EXTENT // 2
"""The side of a window, before the method widens the window, is at most this long in counts.

A TIN is exact up to `MAX_EXTENT`.
"""

NEAR_HALF = 0.1
"""A tile that is too large is divided into halves, each with half of the points.

The halves may differ from that by this share of all points.
"""

EQUAL_HALF = 0.05
"""Like `NEAR_HALF`, for tiles that are halved only to occupy all workers.

It is smaller, because the slowest tile determines the total time.
"""

DIVISOR_OF_ZERO = 1 << 62
"""Power of two that counts as the largest divisor of the number 0, see `_halves`.

Any power of two divides 0, so this is larger than the divisors of all other numbers.
"""


class BucketPoints(NamedTuple):
    """Numbers of points of a bucket: all points, candidates, and points that a pass elected."""

    n: int
    n_candidates: int
    n_elected: int = 0


Records = Mapping[Cell, BucketPoints]


@dataclass(frozen=True)
class Tile:
    """Buckets of a tile.

    Attributes
    ----------
    name : str
        For a tile of a lattice: the name of its cell, and for a quarter also its level and cell. For a tile of a survey
        that was halved: the name of the south-west bucket of its rectangle, and numbers of columns and rows.
    cells : tuple of Cell
        Sorted buckets whose centres lie in the tile.
    halo, max_halo : int
        First and largest halo in counts.
    """

    name: str
    cells: tuple[Cell, ...]
    halo: int
    max_halo: int


def tiles_of(plan: Plan, records: Records, step: PlannedPass) -> Iterator[Tile]:
    """Yield the tiles of a pass."""
    if plan.joins(step):
        n_candidates = sum(record.n_candidates for record in records.values())
        n_tiles = plan.method.n_joined_tiles(n_candidates)
        yield from _halved(plan, records, step, sorted(records), n_tiles)
        return
    size = plan.frame.counts(plan.method.tile)
    groups = _by_centre(plan.buckets, records, size)
    for cell in sorted(groups):
        yield from _fitting(plan, records, step, groups[cell], cell.name, size, 0)


def _halved(
    plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], n_tiles: int
) -> Iterator[Tile]:
    """Yield the tiles of some buckets: one tile, or the tiles of both halves.

    Buckets are halved if the tile or its window is too wide, or if the window needs too much
    memory. They are also halved if ``n_tiles`` is above 1 and the windows of the halves are
    smaller (`MAX_HALF`).
    """
    halo = _halo(plan, step)
    bounds = plan.buckets.hull(cells)
    side = max(bounds.x1 - bounds.x0, bounds.y1 - bounds.y0)
    too_large = (
        side > plan.frame.counts(Fraction(SPARSE_TILE_M))
        or _too_wide(plan, cells, halo)
        or _bytes(plan, records, step, cells, halo) > plan.tile_memory_of(step)
    )
    if len(cells) > 1 and (too_large or n_tiles > 1):
        halves = _halves(records, cells, NEAR_HALF if too_large else EQUAL_HALF)
        whole, *parts = (_area_m2(plan, records, part, halo) for part in (cells, *halves))
        if too_large or max(parts) <= MAX_HALF * whole:
            for half in halves:
                yield from _halved(plan, records, step, half, n_tiles // 2)
            return
    columns = [cell.ix for cell in cells]
    rows = [cell.iy for cell in cells]
    corner = Cell(min(columns), min(rows))
    name = f"{corner.name}.{max(columns) - corner.ix + 1}x{max(rows) - corner.iy + 1}"
    yield Tile(name, tuple(sorted(cells)), halo, _widest(plan, records, step, cells, halo))


def _halves(records: Records, cells: Sequence[Cell], tolerance: float) -> list[list[Cell]]:
    """Divide buckets by a line across the longer side.

    A line is suitable if each side has half of the points, with a deviation of at most
    ``tolerance`` of all points. Of the suitable lines, the line whose number is divisible by
    the highest power of two is chosen, so that a survey that grows keeps most of its tiles. If
    no line is suitable, the line with the smallest deviation is chosen.
    """
    columns = [cell.ix for cell in cells]
    rows = [cell.iy for cell in cells]
    axis = "ix" if max(columns) - min(columns) >= max(rows) - min(rows) else "iy"
    points_of_line: Counter[int] = Counter()
    for cell in cells:
        points_of_line[getattr(cell, axis)] += records[cell].n_candidates + 1
    ranked = []
    before = 0
    total = points_of_line.total()
    for previous_line, line in pairwise(sorted(points_of_line)):
        before += points_of_line[previous_line]
        deviation = abs(before / total - 0.5)
        divisor = 0
        if deviation <= tolerance:
            # The largest power of two that divides the number of the line.
            divisor = line & -line or DIVISOR_OF_ZERO
        ranked.append((-divisor, deviation, line))
    cut = min(ranked)[-1]
    first = [cell for cell in cells if getattr(cell, axis) < cut]
    second = [cell for cell in cells if getattr(cell, axis) >= cut]
    return [first, second]


def _fitting(
    plan: Plan,
    records: Records,
    step: PlannedPass,
    cells: Sequence[Cell],
    name: str,
    size: Fraction,
    level: int,
) -> Iterator[Tile]:
    """Yield a tile, or the tiles of its quarters if its window is too wide or needs too much memory.

    A bucket belongs to the quarter with its centre.
    """
    halo = _halo(plan, step)
    too_full = _bytes(plan, records, step, cells, halo) > plan.tile_memory_of(step)
    if len(cells) > 1 and (too_full or _too_wide(plan, cells, halo)):
        quarters = _by_centre(plan.buckets, cells, size / 2)
        root = name.split(".")[0]
        for quarter in sorted(quarters):
            quarter_name = f"{root}.{level + 1}{quarter.name}"
            yield from _fitting(
                plan, records, step, quarters[quarter], quarter_name, size / 2, level + 1
            )
        return
    yield Tile(name, tuple(sorted(cells)), halo, _widest(plan, records, step, cells, halo))


def _halo(plan: Plan, step: PlannedPass) -> int:
    return math.ceil(plan.frame.counts(Fraction(step.halo_m)))


def _too_wide(plan: Plan, cells: Sequence[Cell], halo: int) -> bool:
    window = plan.buckets.hull(cells).pad(MAX_HALO_FACTOR * halo)
    return max(window.x1 - window.x0, window.y1 - window.y0) > MAX_WINDOW


def _widest(
    plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], halo: int
) -> int:
    # Halos of elected points may use all memory, so that as few labels as possible stay uncertified.
    memory = plan.method.tile_memory if step.fits_surfaces else plan.tile_memory_of(step)
    return widest_halo(
        step, halo, lambda wider: _bytes(plan, records, step, cells, wider) <= memory
    )


def _by_centre(
    lattice: Lattice, cells: Iterable[Cell], size: Fraction
) -> dict[Cell, list[Cell]]:
    """Group buckets by cells with a side of ``size`` counts. A bucket belongs to the cell with its centre."""
    cells_by_centre: dict[Cell, list[Cell]] = defaultdict(list)
    half = Fraction(1, 2)
    for cell in cells:
        column = math.floor((cell.ix + half) * lattice.size / size)
        row = math.floor((cell.iy + half) * lattice.size / size)
        cells_by_centre[Cell(column, row)].append(cell)
    return cells_by_centre


def _area_m2(plan: Plan, records: Records, cells: Sequence[Cell], halo: int) -> float:
    """Return the area of the window of a tile in m2, without its parts beyond all buckets with points."""
    window = plan.buckets.hull(cells).pad(halo)
    near = plan.buckets.hull(plan.buckets.among(window, records))
    return near.intersection(window).area() * float(plan.frame.metres_xy) ** 2


def _bytes(
    plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], halo: int
) -> int:
    """Estimate the peak bytes of a worker for a tile with a halo, from the known points of the window."""
    lattice = plan.buckets
    window = lattice.hull(cells).pad(halo)
    near = lattice.among(window, records)
    if step.pass_.elected:
        points = sum(records[cell].n_elected for cell in near)
    elif plan.on_candidates and not step.pass_.every_point:
        points = sum(records[cell].n_candidates for cell in near)
    else:
        points = sum(records[cell].n for cell in near)
    area_m2 = len(near) * plan.grid.bucket_m**2
    bucket_points = float(max(records[cell].n for cell in cells))
    bucket_points *= (1 + 2 * step.pass_.label_margin_m / plan.grid.bucket_m) ** 2
    cell_m = plan.method.candidate_cell_m
    if step.pass_.raster_cell_m:
        # A raster also has cells in buckets without points.
        area_m2 = _area_m2(plan, records, cells, halo)
        cell_m = 0.0
    elif step.pass_.elected:
        # Without a cell, `filter_bytes` uses the known number of points instead of the largest
        # possible number.
        cell_m = 0.0
    window_bytes = filter_bytes(points, area_m2, cell_m, step, plan.grid.fine_m)
    return tile_peak(window_bytes, bucket_points, step, plan.method.tile_memory)
