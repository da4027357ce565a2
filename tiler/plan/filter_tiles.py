"""Cuts the survey into filter tiles, each a set of buckets whose window fits the memory of a worker.

How a tile is cut depends on the number of points in its window alone, which is known once the buckets are assembled.
The memory is that of the first run on the store: later ones with more or less of it find the same tiles.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ptd.tin.mesh import MAX_EXTENT
from tiler.core.lattice import Cell, Lattice
from tiler.plan import Plan, PlannedPass
from tiler.plan.memory import BASE_BYTES, bucket_bytes, filter_bytes, held_bytes, nested
from tiler.plan.model import MAX_HALO_FACTOR

WIDEST_WINDOW = MAX_EXTENT // 2
"""Counts of a window's side with which a TIN is exact, however the method widens it."""

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
    size = plan.meta.frame.counts(plan.tile)
    groups = _by_centre(plan.meta.bucket, records, size)
    for cell in sorted(groups):
        yield from _fitting(plan, records, step, groups[cell], cell.name, size, 0)


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
    halo = math.ceil(plan.meta.frame.counts(Fraction(step.halo_m)))
    window = plan.meta.bucket.hull(cells).pad(MAX_HALO_FACTOR * halo)
    wide = max(window.x1 - window.x0, window.y1 - window.y0) > WIDEST_WINDOW
    if len(cells) > 1 and (wide or _bytes(plan, records, step, cells, halo) > plan.tile_memory):
        quarters = _by_centre(plan.meta.bucket, cells, size / 2)
        root = name.split(".")[0]
        for place in sorted(quarters):
            below = f"{root}.{level + 1}{place.name}"
            yield from _fitting(plan, records, step, quarters[place], below, size / 2, level + 1)
        return
    widest = halo
    while (
        not step.fixed
        and 0 < widest < MAX_HALO_FACTOR * halo
        and _bytes(plan, records, step, cells, 2 * widest) <= plan.tile_memory
    ):
        widest *= 2
    yield Tile(name, tuple(sorted(cells)), halo, widest)


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
    column = "n_candidates" if not step.every_point and nested(plan.candidate_cell_m) else "n"
    if step.elected:
        column = "n_elected"
    window = lattice.hull(cells).pad(halo)
    near = lattice.among(window, records)
    held = [records[cell][column] for cell in near]
    area = len(held) * plan.bucket_m**2
    bucket, kept = max(records[cell]["n"] for cell in cells), 0
    if step.margin_m:
        bucket *= (1 + 2 * step.margin_m / plan.bucket_m) ** 2
        kept = held_bytes(plan.tile_memory)
    if step.raster_cell_m:
        across = lattice.hull(near).intersection(window).area() * float(plan.meta.frame.metres_xy) ** 2
        window_bytes = filter_bytes(sum(held), across, 0.0, step)
    else:
        thinned = 0.0 if step.elected else plan.candidate_cell_m  # the number of elected points is known
        window_bytes = filter_bytes(sum(held), area, thinned, step)
    return int(BASE_BYTES + window_bytes + bucket_bytes(bucket) + kept)
