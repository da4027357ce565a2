"""Tasks and decisions on the water of a run: bodies from a file or from the data, and their levels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from tiler.config import AUTO_WATER
from tiler.core.area_index import AreaIndex
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Cell, row_by_row
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.water import LAKE, Water, Waters, lengths_along
from tiler.core.words import counted
from tiler.grid.coarse import padded
from tiler.grid.records import LevelRecord
from tiler.grid.tasks.gridding import GridContext, Place
from tiler.grid.tasks.survey import block_names, near_places
from tiler.grid.tasks.water_facts import report_levels
from tiler.grid.tasks.water_search import area_sums
from tiler.grid.water_find import MIN_LENGTH, BodyCells, describe_body
from tiler.grid.water_level import POCKET_PIXELS, level_water
from tiler.grid.water_search import SearchRasters
from tiler.grid.water_shore import BANK_MARGIN
from tiler.io.result_folder import WATER
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, calling

FINDING, STAGE = "water-search", "water"
"""Names of the stages: outlines of bodies of water, and levels of bodies."""
CELLS, CROWNS = "water-cells", "water-crowns"
"""Rasters of the labels of water, and of the crowns near water."""
SOURCES = ("occupancy", "water-ground", "domain")
"""Rasters that the search for water reads."""
MAX_SLOPE = 1 / 30
"""A river falls at most this much per length. Steeper areas without returns are ravines."""
SHORE_MARGIN = POCKET_PIXELS + 2
"""The level of a body of water may depend on pixels up to this distance from the body, in
pixels."""


def find_waters(job: Job, context: GridContext) -> Waters:
    """Find the bodies of water and their levels, and put them into the store for the tasks."""
    auto = context.plan.config.water == AUTO_WATER
    bodies = _bodies_in_data(job, context) if auto else context.plan.inputs.waters
    tasks = list(level_tasks(context, bodies))
    made = run_stage(job, STAGE, tasks) if tasks else {}
    levelled: list[Water] = []
    records: dict[int, LevelRecord] = {}
    for body in bodies:
        record = LevelRecord.of(made[_key(body)][1]) if _key(body) in made else None
        if record is not None:
            records[body.number] = record
        if body.levelled:
            levelled.append(body)
        elif record is not None and record.body is not None:
            levelled.append(Water.from_json(record.body))
    without_level = {b.number for b in bodies} - {b.number for b in levelled}
    if without_level and not auto:
        names = ", ".join(map(str, sorted(without_level)))
        job.note(
            f"--water: no terrain along the shore of body {names}: it is left out; give it a `level`"
        )
    waters = Waters(tuple(b for b in levelled if not auto or _is_gentle(context, b)))
    if auto and waters.bodies:
        n_lakes = sum(b.kind == LAKE for b in waters.bodies)
        n_rivers = len(waters.bodies) - n_lakes
        counts = []
        if n_lakes:
            counts.append(counted(n_lakes, "lake"))
        if n_rivers:
            counts.append(counted(n_rivers, "river or canal", "rivers or canals"))
        job.note(
            f"decided: found {' and '.join(counts)} and flattened the terrain there (edit {WATER} and give it with "
            "--water to change this, or use --water none)"
        )
    if auto and not context.returns_show_water:
        job.note(
            "decided: only class 9 of the input is water, as holes and false heights of a photogrammetric cloud may be "
            "anywhere (give drawn water with --water FILE)"
        )
    report_levels(job, waters, records)
    job.store.put_waters(waters)
    return waters


def _bodies_in_data(job: Job, context: GridContext) -> tuple[Water, ...]:
    """Return the bodies of water in the data, without levels, from the north-west."""
    tasks = list(_body_tasks(context))
    made = run_stage(job, FINDING, tasks) if tasks else {}
    found = [stored["body"] for _, stored in made.values()]
    bodies = [Water.from_json(body) for body in found if body is not None]
    bodies.sort(key=lambda body: (-body.area.bounds.y1, body.area.bounds.x0, body.area.key))
    return tuple(replace(body, number=number) for number, body in enumerate(bodies, start=1))


def _body_tasks(context: GridContext) -> Iterator[Task]:
    """Yield a task for each connected area of water that is large enough."""
    config, coarse = context.plan.config, context.coarse
    min_m2 = min(config.water_min_lake, MIN_LENGTH * config.water_min_river_width**2)
    areas = context.areas(CELLS).areas
    for name, (n_cells, n_known, hundredths) in area_sums(context, CELLS).items():
        if n_cells * context.coarse_m**2 < min_m2:
            continue
        pieces = areas[name]
        places = sorted({(piece.row, piece.col) for piece in pieces})
        # `finish_water` adds up the confidences of the cells in hundredths. Not all cells have
        # a confidence.
        confidence = round(hundredths / 100 / max(n_known, 1), 2)
        cells = BodyCells(
            pieces, CELLS, CROWNS, SearchRasters(*SOURCES), context.rule, coarse, float(config.water_min_island)
        )  # fmt: skip
        call = calling(
            describe_body,
            cells=cells,
            confidence=confidence,
            lake_m2=float(config.water_min_lake),
            river_width_m=float(config.water_min_river_width),
        )
        near = block_names(near_places(coarse, places))
        rasters = [context.checksums(raster, near) for raster in (CELLS, CROWNS, *SOURCES)]
        labels = context.label_digests(_buckets_near(context, places))
        key = f"{block_names(places)[0]}a{name.label}"
        yield Task.of(FINDING, key, call, rasters, labels, pixels=n_cells)


def _buckets_near(context: GridContext, places: list[Place]) -> list[Cell]:
    """Return the buckets in and near some blocks of coarse cells."""
    buckets, coarse = context.plan.buckets, context.coarse
    cells: set[Cell] = set()
    for place in places:
        block = padded(coarse.block_at(*place, BLOCK_PIXELS), BANK_MARGIN)
        cells.update(buckets.among(coarse.block_bounds(block), context.labels))
    return sorted(cells, key=row_by_row)


def _is_gentle(context: GridContext, body: Water) -> bool:
    """Return whether a body is level, or falls no more steeply than a river (`MAX_SLOPE`)."""
    high, low = body.range
    if body.flow is None or high == low:
        return True
    units = context.plan.frame.units
    length = lengths_along(body.flow)[-1] / COUNTS_PER_UNIT * float(units.horizontal)
    return bool((high - low) * float(units.vertical) <= MAX_SLOPE * length)


def level_tasks(context: GridContext, bodies: tuple[Water, ...]) -> Iterator[Task]:
    """Yield a task for each body without a level."""
    spec = context.spec
    pad = int(SHORE_MARGIN * spec.lattice.size) + 1
    auto = context.plan.config.water == AUTO_WATER
    index = AreaIndex([body.area for body in bodies])
    for body in bodies:
        if body.levelled:
            continue
        near = body.area.bounds.pad(pad)
        other_areas = tuple(
            bodies[i].area for i in index.overlapping(near) if bodies[i] is not body
        )
        names = (*SOURCES[:2], CROWNS)
        cells = names if all(name in context.made for name in names) else None
        call = calling(
            level_water,
            body=body,
            others=other_areas,
            heights="dtm",
            spec=spec,
            cells=cells,
            coarse=context.coarse,
            joins_pockets=auto,
        )
        pixels = [block.name for block in spec.blocks_within(near, BLOCK_PIXELS)]
        blocks = [block.name for block in context.coarse.blocks_within(near, BLOCK_PIXELS)]
        yield Task.of(
            STAGE,
            _key(body),
            call.without("body", "others"),
            [body.digest, body.number, *(other.key for other in other_areas)],
            context.checksums("dtm", pixels),
            [context.checksums(name, blocks) for name in cells or ()],
            bounds=body.area.bounds,
        )


def _key(body: Water) -> str:
    return f"w{body.number:06d}"
