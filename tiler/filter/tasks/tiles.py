"""Division of the survey into filter tiles: sets of buckets with a window that fits the memory of a worker.

The tiles of a lattice, quartered where they do not fit, serve passes that read every point or elected points, and all
passes if the user asked for a tile size. Passes on candidates (one in each fine cell) get larger tiles, as their halos
cost little: the survey is halved until each tile fits and each worker has one.

The cuts depend only on the number of points in the windows, which is known once the buckets are assembled, and on the
memory of the first run on the store. Later runs with another memory find the same tiles.
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
from tiler.plan.halos import MAX_HALO_FACTOR, widest_halo
from tiler.plan.memory import BASE_BYTES, bucket_bytes, filter_bytes, held_bytes
from tiler.plan.sizes import SPARSE_TILE_M

MAX_WINDOW = MAX_EXTENT // 2
"""Longest side of a window in counts for which a TIN is exact even if the method widens the window."""

NEAR_HALF = 0.1
"""Largest deviation from half of the points for the parts of a tile that is too large, as a share."""

EQUAL_HALF = 0.05
"""Largest deviation for tiles that are divided among workers, as the slowest tile decides the total time."""

ROUNDEST = 1 << 62
"""Power of two that counts as the largest divisor of the line 0, see `_halves`."""


class BucketPoints(NamedTuple):
    """Numbers of points of a bucket: all, candidates, and those that a pass elected."""

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
        Name of the tile's cell of the tile lattice. A part of a divided tile adds its level and place.
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
    """Yield the tiles of a pass, from the west."""
    if plan.joins(step):
        held = sum(record.n_candidates for record in records.values())
        yield from _halved(plan, records, step, sorted(records), plan.n_joined_tiles(held))
        return
    size = plan.meta.frame.counts(plan.tile)
    groups = _by_centre(plan.meta.bucket, records, size)
    for cell in sorted(groups):
        yield from _fitting(plan, records, step, groups[cell], cell.name, size, 0)


def _halved(
    plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], wanted: int
) -> Iterator[Tile]:
    """Yield a tile, halved while more tiles are needed or its window is too wide or has too many points."""
    halo = _halo(plan, step)
    across = plan.meta.bucket.hull(cells)
    wide = max(across.x1 - across.x0, across.y1 - across.y0) > plan.meta.frame.counts(Fraction(SPARSE_TILE_M))
    large = (
        wide
        or _too_wide(plan, cells, halo)
        or _bytes(plan, records, step, cells, halo) > plan.tile_memory_of(step)
    )
    if len(cells) > 1 and (large or wanted > 1):
        for half in _halves(records, cells, NEAR_HALF if large else EQUAL_HALF):
            yield from _halved(plan, records, step, half, wanted // 2)
        return
    columns = [cell.ix for cell in cells]
    rows = [cell.iy for cell in cells]
    corner = Cell(min(columns), min(rows))
    name = f"{corner.name}.{max(columns) - corner.ix + 1}x{max(rows) - corner.iy + 1}"
    yield Tile(name, tuple(sorted(cells)), halo, _widest(plan, records, step, cells, halo))


def _halves(records: Records, cells: Sequence[Cell], near: float) -> list[list[Cell]]:
    """Divide buckets by a line across the longer side.

    Candidate lines leave half of the points on each side, within ``near`` of all points. The line with the roundest
    number wins (the one divisible by the highest power of two), so that a survey that grows keeps most of its tiles. If
    there is no such line, the line nearest to half wins.
    """
    columns = [cell.ix for cell in cells]
    rows = [cell.iy for cell in cells]
    axis = "ix" if max(columns) - min(columns) >= max(rows) - min(rows) else "iy"
    held: Counter[int] = Counter()
    for cell in cells:
        held[getattr(cell, axis)] += records[cell].n_candidates + 1
    lines = []
    below = 0
    total = held.total()
    for previous_line, line in pairwise(sorted(held)):
        below += held[previous_line]
        off = abs(below / total - 0.5)
        round_to = (line & -line or ROUNDEST) if off <= near else 0
        lines.append((off > near, -round_to, off, line))
    cut = min(lines)[-1]
    west = [cell for cell in cells if getattr(cell, axis) < cut]
    east = [cell for cell in cells if getattr(cell, axis) >= cut]
    return [west, east]


def _fitting(
    plan: Plan,
    records: Records,
    step: PlannedPass,
    cells: Sequence[Cell],
    name: str,
    size: Fraction,
    level: int,
) -> Iterator[Tile]:
    """Yield a tile, quartered while its window is too wide or has too many points. Buckets stay whole."""
    halo = _halo(plan, step)
    too_full = _bytes(plan, records, step, cells, halo) > plan.tile_memory
    if len(cells) > 1 and (too_full or _too_wide(plan, cells, halo)):
        quarters = _by_centre(plan.meta.bucket, cells, size / 2)
        root = name.split(".")[0]
        for quarter in sorted(quarters):
            below = f"{root}.{level + 1}{quarter.name}"
            yield from _fitting(plan, records, step, quarters[quarter], below, size / 2, level + 1)
        return
    yield Tile(name, tuple(sorted(cells)), halo, _widest(plan, records, step, cells, halo))


def _halo(plan: Plan, step: PlannedPass) -> int:
    return math.ceil(plan.meta.frame.counts(Fraction(step.halo_m)))


def _too_wide(plan: Plan, cells: Sequence[Cell], halo: int) -> bool:
    window = plan.meta.bucket.hull(cells).pad(MAX_HALO_FACTOR * halo)
    return max(window.x1 - window.x0, window.y1 - window.y0) > MAX_WINDOW


def _widest(plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], halo: int) -> int:
    most = plan.tile_memory_of(step)
    return widest_halo(step, halo, lambda wider: _bytes(plan, records, step, cells, wider) <= most)


def _by_centre(lattice: Lattice, cells: Iterable[Cell], size: Fraction) -> dict[Cell, list[Cell]]:
    """Group buckets by the cell of ``size`` counts that contains their centre."""
    cells_by_centre: dict[Cell, list[Cell]] = defaultdict(list)
    half = Fraction(1, 2)
    for cell in cells:
        column = math.floor((cell.ix + half) * lattice.size / size)
        row = math.floor((cell.iy + half) * lattice.size / size)
        cells_by_centre[Cell(column, row)].append(cell)
    return cells_by_centre


def _bytes(plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], halo: int) -> int:
    """Estimate the peak bytes of a worker for a tile with a halo, from the known points of the window."""
    lattice = plan.meta.bucket
    window = lattice.hull(cells).pad(halo)
    near = lattice.among(window, records)
    if step.pass_.elected:
        held = [records[cell].n_elected for cell in near]
    elif plan.on_candidates and not step.pass_.every_point:
        held = [records[cell].n_candidates for cell in near]
    else:
        held = [records[cell].n for cell in near]
    area = len(held) * plan.bucket_m**2
    bucket = float(max(records[cell].n for cell in cells))
    kept = 0
    if step.pass_.label_margin_m:
        bucket *= (1 + 2 * step.pass_.label_margin_m / plan.bucket_m) ** 2
        kept = held_bytes(plan.tile_memory)
    if step.pass_.raster_cell_m:
        across = lattice.hull(near).intersection(window).area() * float(plan.meta.frame.metres_xy) ** 2
        window_bytes = filter_bytes(sum(held), across, 0.0, step, plan.fine_m)
    elif step.pass_.elected:  # the number of elected points is known
        window_bytes = filter_bytes(sum(held), area, 0.0, step, plan.fine_m)
    else:
        window_bytes = filter_bytes(sum(held), area, plan.candidate_cell_m, step, plan.fine_m)
    return int(BASE_BYTES + window_bytes + bucket_bytes(bucket) + kept)
