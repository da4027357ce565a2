"""Water of a run: bodies from a file or from the data, and their levels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from tiler.config import AUTO_WATER
from tiler.core.area_index import AreaIndex
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Cell, row_by_row
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.water import LAKE, Water, Waters, lengths_along
from tiler.core.words import counted
from tiler.grid import DescribeBody, LevelWater, Sources, describe_body, level_water
from tiler.grid.coarse import padded
from tiler.grid.tasks.gridding import GridContext, Place
from tiler.grid.tasks.survey import names_of, near_places
from tiler.grid.tasks.water_facts import report_levels
from tiler.grid.tasks.water_search import area_sums
from tiler.grid.water_banks import BANK_MARGIN
from tiler.grid.water_find import MIN_LENGTH
from tiler.grid.water_pockets import POCKET_PIXELS
from tiler.io.result_folder import WATER
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, digest_of
from tiler.version import __version__

FINDING, STAGE = "water-search", "water"
CELLS, CROWNS = "water-cells", "water-crowns"
"""Rasters of the labels of water, and of the crowns near it."""
SOURCES = ("occupancy", "water-ground", "domain")
"""Rasters for the search for water."""
STEEPEST = 1 / 30
"""Largest fall of a river relative to its length."""
SHORE_REACH = POCKET_PIXELS + 2
"""Margin around a body of water, in pixels, on which its level may depend."""


def find_waters(job: Job, g: GridContext) -> Waters:
    """Find the bodies of water and their levels, and put them into the store for the tasks."""
    auto = g.plan.config.water == AUTO_WATER
    bodies = _found(job, g) if auto else g.plan.waters
    tasks = list(level_tasks(g, bodies))
    made = run_stage(job, STAGE, tasks) if tasks else {}
    levelled, records = [], dict[int, dict[str, Any]]()
    for body in bodies:
        record = records[body.number] = made.get(_key(body), (None, {}))[1]
        if body.levelled:
            levelled.append(body)
        elif record.get("body"):
            levelled.append(Water.from_json(record["body"]))
    left = {b.number for b in bodies} - {b.number for b in levelled}
    if left and not auto:
        names = ", ".join(map(str, sorted(left)))
        job.note(f"--water: no terrain along the shore of body {names}: it is left out; give it a `level`")
    waters = Waters(tuple(b for b in levelled if not auto or _gentle(g, b)))
    if auto and waters.bodies:
        lakes = sum(b.kind == LAKE for b in waters.bodies)
        rivers = counted(len(waters.bodies) - lakes, "river or canal", "rivers or canals")
        counts = [counted(lakes, "lake")] * (lakes > 0) + [rivers] * (lakes < len(waters.bodies))
        job.note(
            f"decided: found {' and '.join(counts)} and flattened the terrain there (edit {WATER} and give it with "
            "--water to change this, or use --water none)"
        )
    if auto and not g.trusted:
        job.note(
            "decided: only class 9 of the input is water, as holes and false heights of a photogrammetric cloud may be "
            "anywhere (give drawn water with --water FILE)"
        )
    report_levels(job, waters, records)
    job.store.put_waters(waters)
    return waters


def _found(job: Job, g: GridContext) -> tuple[Water, ...]:
    """Return the bodies of water in the data, without levels, from the north-west."""
    tasks = list(_body_tasks(g))
    made = run_stage(job, FINDING, tasks) if tasks else {}
    bodies = [Water.from_json(record["body"]) for _, record in made.values() if record["body"]]
    bodies.sort(key=lambda body: (-body.area.bounds.y1, body.area.bounds.x0, body.area.key))
    return tuple(replace(body, number=number) for number, body in enumerate(bodies, start=1))


def _body_tasks(g: GridContext) -> Iterator[Task]:
    """Yield a task for each connected area of water that is large enough."""
    config, coarse = g.plan.config, g.coarse
    min_m2 = min(config.water_min_lake, MIN_LENGTH * config.water_min_river_width**2)
    joined = g.areas(CELLS)
    for name, (cells, known, hundredths) in area_sums(joined, g.records(CELLS)).items():
        if cells * g.coarse_m**2 < min_m2:
            continue
        pieces = joined.areas[name]
        places = sorted({(piece.row, piece.col) for piece in pieces})
        work = DescribeBody(
            pieces, CELLS, CROWNS, Sources(*SOURCES), g.rule, coarse, sure=round(hundredths / 100 / max(known, 1), 2),
            lake_m2=float(config.water_min_lake), river_width_m=float(config.water_min_river_width),
            island_m2=float(config.water_min_island),
        )  # fmt: skip
        near = names_of(near_places(coarse, places))
        rasters = [g.checksums(raster, near) for raster in (CELLS, CROWNS, *SOURCES)]
        digest = digest_of(__version__, work, *rasters, g.seen(_buckets_near(g, places)))
        key = f"{names_of(places)[0]}a{name.label}"
        yield Task(FINDING, key, digest, describe_body, work, cells)


def _buckets_near(g: GridContext, places: list[Place]) -> list[Cell]:
    """Return the buckets of the points in blocks of coarse cells and near them."""
    buckets, coarse = g.plan.meta.bucket, g.coarse
    blocks = [padded(coarse.block_at(*place, BLOCK_PIXELS), BANK_MARGIN) for place in places]
    cells = {cell for block in blocks for cell in buckets.among(coarse.block_bounds(block), g.labels)}
    return sorted(cells, key=row_by_row)


def _gentle(g: GridContext, body: Water) -> bool:
    """Return whether a body falls no more steeply than rivers do, which excludes ravines without returns."""
    high, low = body.range
    if body.flow is None or high == low:
        return True
    units = g.plan.meta.frame.units
    length = lengths_along(body.flow)[-1] / COUNTS_PER_UNIT * float(units.horizontal)
    return bool((high - low) * float(units.vertical) <= STEEPEST * length)


def level_tasks(g: GridContext, bodies: tuple[Water, ...]) -> Iterator[Task]:
    """Yield a task for each body without a level."""
    spec = g.spec
    pad = int(SHORE_REACH * spec.lattice.size) + 1
    auto = g.plan.config.water == AUTO_WATER
    index = AreaIndex([body.area for body in bodies])
    for body in bodies:
        if body.levelled:
            continue
        near = body.area.bounds.pad(pad)
        other_areas = tuple(bodies[i].area for i in index.overlapping(near) if bodies[i] is not body)
        seen_cells = (*SOURCES[:2], CROWNS)
        cells = seen_cells if all(name in g.made for name in seen_cells) else None
        work = LevelWater(body, other_areas, "dtm", spec, cells, g.coarse, joins_pockets=auto)
        seen = [g.checksums("dtm", (block.name for block in spec.blocks_within(near, BLOCK_PIXELS)))]
        if cells is not None:
            under = [block.name for block in g.coarse.blocks_within(near, BLOCK_PIXELS)]
            seen += [g.checksums(name, under) for name in cells]
        digest = digest_of(
            __version__, body.digest, body.number, auto, [other.key for other in other_areas], spec, seen
        )
        yield Task(STAGE, _key(body), digest, level_water, work)


def _key(body: Water) -> str:
    return f"w{body.number:06d}"
