"""Cuts the survey into filter tiles, each a set of buckets whose window fits the memory of a worker.

Passes that read every point, or points that others made, and all passes where a size was asked for, have the tiles of a
lattice, quartered where they do not fit. Passes on candidates (one in each fine cell) have tiles as large as fit, at
least as many as there are workers: the whole survey is halved until that is so, and their halos cost little.

How a tile is cut depends on the number of points in its window alone, which is known once the buckets are assembled.
The memory is that of the first run on the store: later ones with more or less of it find the same tiles.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

from ptd.tin.mesh import MAX_EXTENT
from tiler.core.lattice import Cell, Lattice
from tiler.plan import Plan, PlannedPass
from tiler.plan.halos import MAX_HALO_FACTOR, widened
from tiler.plan.memory import BASE_BYTES, bucket_bytes, filter_bytes, held_bytes
from tiler.plan.sizes import SPARSE_TILE_M

WIDEST_WINDOW = MAX_EXTENT // 2
"""Counts of a window's side with which a TIN is exact, however the method widens it."""

NEAR_HALF, EQUAL_HALF = 0.1, 0.05
"""Share of the points by which the parts of a tile may differ from half: where it is divided as it is too large, and
where as each worker is to have one, when the slowest decides how long all take."""

ROUNDEST = 1 << 62
"""In place of the highest power of two that divides 0."""

Records = Mapping[Cell, Mapping[str, Any]]
"""Bucket -> what its assembly recorded: ``n`` points, ``n_candidates`` of them; ``n_elected``, once there are some."""


@dataclass(frozen=True)
class Tile:
    """The buckets of a tile.

    Attributes
    ----------
    name : str
        Of the cell of the tile lattice that it is; of a part of one that was divided also level and place.
    cells : tuple of Cell
        Its buckets, those whose centres it holds, sorted.
    halo, max_halo : int
        Counts around it that a pass sees to begin with, and with which it ends.
    """

    name: str
    cells: tuple[Cell, ...]
    halo: int
    max_halo: int


def tiles_of(plan: Plan, records: Records, step: PlannedPass) -> Iterator[Tile]:
    """The tiles of a pass, from the west."""
    if plan.joins(step):
        held = sum(record["n_candidates"] for record in records.values())
        yield from _halved(plan, records, step, sorted(records), plan.wanted_tiles(held))
        return
    size = plan.meta.frame.counts(plan.tile)
    groups = _by_centre(plan.meta.bucket, records, size)
    for cell in sorted(groups):
        yield from _fitting(plan, records, step, groups[cell], cell.name, size, 0)


def _halved(
    plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], wanted: int
) -> Iterator[Tile]:
    """A tile, or those of its halves where more are wanted, or its window is too wide or holds too many points."""
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
    columns, rows = ([getattr(cell, axis) for cell in cells] for axis in ("ix", "iy"))
    corner = Cell(min(columns), min(rows))
    name = f"{corner.name}.{max(columns) - corner.ix + 1}x{max(rows) - corner.iy + 1}"
    yield Tile(name, tuple(sorted(cells)), halo, _widest(plan, records, step, cells, halo))


def _halves(records: Records, cells: Sequence[Cell], near: float) -> list[list[Cell]]:
    """Buckets on the two sides of a line across the longer side.

    Of the lines that leave half of the points on each side, more or less ``near`` of all, the one with the roundest
    number (that is divisible by the highest power of two), so that a survey that grows keeps most of its tiles. Where
    there is none, the line nearest to half.
    """
    spans = {axis: {getattr(cell, axis) for cell in cells} for axis in ("ix", "iy")}
    axis = max(spans, key=lambda name: max(spans[name]) - min(spans[name]))
    held: Counter[int] = Counter()
    for cell in cells:
        held[getattr(cell, axis)] += records[cell]["n_candidates"] + 1
    lines, below, total = [], 0, held.total()
    for before, line in pairwise(sorted(held)):
        below += held[before]
        off = abs(below / total - 0.5)
        round_to = (line & -line or ROUNDEST) if off <= near else 0
        lines.append((off > near, -round_to, off, line))
    cut = min(lines)[-1]
    return [[c for c in cells if (getattr(c, axis) < cut) == west] for west in (True, False)]


def _fitting(
    plan: Plan,
    records: Records,
    step: PlannedPass,
    cells: Sequence[Cell],
    name: str,
    size: Fraction,
    level: int,
) -> Iterator[Tile]:
    """A tile, or its quarters where its window is too wide or holds too many points; one bucket is not divided."""
    halo = _halo(plan, step)
    too_full = _bytes(plan, records, step, cells, halo) > plan.tile_memory
    if len(cells) > 1 and (too_full or _too_wide(plan, cells, halo)):
        quarters = _by_centre(plan.meta.bucket, cells, size / 2)
        root = name.split(".")[0]
        for place in sorted(quarters):
            below = f"{root}.{level + 1}{place.name}"
            yield from _fitting(plan, records, step, quarters[place], below, size / 2, level + 1)
        return
    yield Tile(name, tuple(sorted(cells)), halo, _widest(plan, records, step, cells, halo))


def _halo(plan: Plan, step: PlannedPass) -> int:
    return math.ceil(plan.meta.frame.counts(Fraction(step.halo_m)))


def _too_wide(plan: Plan, cells: Sequence[Cell], halo: int) -> bool:
    window = plan.meta.bucket.hull(cells).pad(MAX_HALO_FACTOR * halo)
    return max(window.x1 - window.x0, window.y1 - window.y0) > WIDEST_WINDOW


def _widest(plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], halo: int) -> int:
    most = plan.tile_memory_of(step)
    return widened(step, halo, lambda wider: _bytes(plan, records, step, cells, wider) <= most)


def _by_centre(lattice: Lattice, cells: Iterable[Cell], size: Fraction) -> dict[Cell, list[Cell]]:
    """Buckets by the cell, of ``size`` counts, that holds their centre."""
    found: dict[Cell, list[Cell]] = defaultdict(list)
    for cell in cells:
        place = [math.floor((i + Fraction(1, 2)) * lattice.size / size) for i in (cell.ix, cell.iy)]
        found[Cell(*place)].append(cell)
    return found


def _bytes(plan: Plan, records: Records, step: PlannedPass, cells: Sequence[Cell], halo: int) -> int:
    """Peak bytes of a worker that does a tile with that halo: the points of its window are known."""
    lattice = plan.meta.bucket
    column = "n_candidates" if not step.work.every_point and plan.on_candidates else "n"
    if step.work.elected:
        column = "n_elected"
    window = lattice.hull(cells).pad(halo)
    near = lattice.among(window, records)
    held = [records[cell][column] for cell in near]
    area = len(held) * plan.bucket_m**2
    bucket, kept = max(records[cell]["n"] for cell in cells), 0
    if step.work.label_margin_m:
        bucket *= (1 + 2 * step.work.label_margin_m / plan.bucket_m) ** 2
        kept = held_bytes(plan.tile_memory)
    if step.work.raster_cell_m:
        across = lattice.hull(near).intersection(window).area() * float(plan.meta.frame.metres_xy) ** 2
        window_bytes = filter_bytes(sum(held), across, 0.0, step, plan.fine_m)
    else:
        thinned = 0.0 if step.work.elected else plan.candidate_cell_m  # the number of elected points is known
        window_bytes = filter_bytes(sum(held), area, thinned, step, plan.fine_m)
    return int(BASE_BYTES + window_bytes + bucket_bytes(bucket) + kept)
