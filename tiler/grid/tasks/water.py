"""Water of a run: tasks and decisions on bodies from a file or from the data, their levels, and what run.json says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from fractions import Fraction

import numpy as np

from tiler.config import AUTO_WATER
from tiler.core.area import AreaIndex
from tiler.core.breaklines import rings_of_areas
from tiler.core.lattice import COUNTS_PER_UNIT, Cell, row_by_row
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.results import Doubt, StationResult, WaterResult
from tiler.core.units import length_text
from tiler.core.water import LAKE, RIVER, Station, Water, Waters, lengths_along
from tiler.core.words import counted, listed
from tiler.grid.coarse import padded
from tiler.grid.records import LevelRecord
from tiler.grid.tasks.gridding import GridContext, Place
from tiler.grid.tasks.steps import block_names, near_places
from tiler.grid.tasks.water_search import area_sums
from tiler.grid.water_find import MIN_LENGTH, BodyCells, describe_body
from tiler.grid.water_level import NOISE_M, POCKET_PIXELS, level_water
from tiler.grid.water_search import SearchRasters
from tiler.grid.water_shore import BANK_MARGIN
from tiler.io.result_folder import WATER
from tiler.observe.events import Warned
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, calling
from tiler.store import Commits

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
    tasks = list(_level_tasks(context, bodies))
    made = run_stage(job, STAGE, tasks) if tasks else {}
    records = {
        body.number: LevelRecord.of(made[_key(body)][1])
        for body in bodies
        if _key(body) in made
    }
    levelled: list[Water] = []
    for body in bodies:
        record = records.get(body.number)
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
    _report_levels(job, waters, records)
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
    blocks = [padded(coarse.block_at(*at, BLOCK_PIXELS), BANK_MARGIN) for at in places]
    bounds = [coarse.block_bounds(block) for block in blocks]
    cells = {cell for near in bounds for cell in buckets.among(near, context.labels)}
    return sorted(cells, key=row_by_row)


def _is_gentle(context: GridContext, body: Water) -> bool:
    """Return whether a body is level, or falls no more steeply than a river (`MAX_SLOPE`)."""
    high, low = body.range
    if body.flow is None or high == low:
        return True
    units = context.plan.frame.units
    length = lengths_along(body.flow)[-1] / COUNTS_PER_UNIT * float(units.horizontal)
    return bool((high - low) * float(units.vertical) <= MAX_SLOPE * length)


def _level_tasks(context: GridContext, bodies: tuple[Water, ...]) -> Iterator[Task]:
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


MIN_CONFIDENCE = 0.8
"""A body of water with a confidence below this causes a warning."""
MAX_FLOATING = 0.005
"""A body of water causes a warning if more than this share of its shore lies below its
level."""


def _report_levels(job: Job, waters: Waters, records: Mapping[int, LevelRecord]) -> None:
    """Report the rivers whose levels are known at too few positions, and warn about bodies that need to be checked.

    Parameters
    ----------
    job : Job
    waters : Waters
    records : mapping
        Record of each body by its number. Bodies with a given level have none.
    """
    unit = job.plan.frame.units.vertical
    doubts: list[Doubt] = []
    level: list[str] = []
    for body in waters.bodies:
        record = records.get(body.number)
        if body.kind == RIVER and body.flow is None and record is not None:
            level.append(_named(body))
        doubts += _doubts(body, record, unit)
    if level:
        job.note(
            f"decided: level water, as heights are known at fewer than two positions along it: {listed(level, 5)}"
        )
    job.results.water_doubts = doubts
    for doubt in doubts:
        job.listener(Warned(doubt.text))


def _doubts(body: Water, record: LevelRecord | None, unit: Fraction) -> list[Doubt]:
    """Return warnings about a body of water, each with a text and a position (x, y)."""
    doubts: list[tuple[str, tuple[float, float]]] = []
    if body.confidence is not None and body.confidence < MIN_CONFIDENCE:
        text = (
            f"{_named(body)} is water with {body.confidence:.0%} certainty; check it, and if it is not water delete it "
            "from water.gpkg and give that file with --water"
        )
        doubts.append((text, _first_vertex(body)))
    share, lowest = (0.0, None) if record is None else record.floating
    if share > MAX_FLOATING and lowest is not None:
        x, y = (value / COUNTS_PER_UNIT for value in lowest)
        text = (
            f"{_named(body)}: {share:.1%} of its shore lies more than {length_text(NOISE_M, unit)} below its level, "
            f"the lowest at ({x:.1f}, {y:.1f}); check its level and its outline there (edit water.gpkg and give it "
            "with --water)"
        )
        doubts.append((text, (x, y)))
    if record is not None and record.uneven:
        text = (
            f"{_named(body)}: its returns differ in height by more than waves, as if from two flight strips; the lower "
            "level is used (to change it, set `level` in water.gpkg and give it with --water)"
        )
        doubts.append((text, _first_vertex(body)))
    return [Doubt(text, list(position)) for text, position in doubts]


def _first_vertex(body: Water) -> tuple[float, float]:
    """Return the first vertex of the outline of a body in units of the CRS."""
    x, y = body.area.polygons[0][0][0].tolist()
    return x / COUNTS_PER_UNIT, y / COUNTS_PER_UNIT


def _named(body: Water) -> str:
    x, y = _first_vertex(body)
    return f"{body.kind} {body.number} at ({x:.1f}, {y:.1f})"


def report_waters(job: Job, waters: Waters, terrain: Commits) -> None:
    """Add the bodies of water to run.json, each with its number of pixels of the terrain."""
    pixels: dict[str, int] = {}
    for _, counts in terrain.values():
        for area, count in counts["water"]:
            pixels[area] = pixels.get(area, 0) + count
    pixel_m2 = float(job.plan.grid.resolution) ** 2
    rings = rings_of_areas([body.area for body in waters.bodies])
    job.results.water = [
        replace(_result(body, pixels.get(body.area.key, 0), pixel_m2), rings=rings_of_body)
        for body, rings_of_body in zip(waters.bodies, rings, strict=True)
    ]


def _result(body: Water, pixels: int, pixel_m2: float) -> WaterResult:
    high, low = body.range
    return WaterResult(
        number=body.number,
        kind=body.kind,
        level=high,
        level_end=low,
        pixels=pixels,
        area_m2=pixels * pixel_m2,
        sure=body.confidence,
        bounds=[v / COUNTS_PER_UNIT for v in body.area.bounds.to_json()],
        stations=_stations(body),
    )


def _stations(body: Water) -> list[StationResult]:
    """Return the stations of a river, in units of the CRS."""
    if not body.stations:
        return []
    along = lengths_along(np.array([station[:2] for station in body.stations]))
    return [_station(s, float(a)) for s, a in zip(body.stations, along, strict=True)]


def _station(station: Station, along: float) -> StationResult:
    left, right = (
        None if z is None else z / COUNTS_PER_UNIT for z in (station.left, station.right)
    )
    level = station.level / COUNTS_PER_UNIT
    return StationResult(along / COUNTS_PER_UNIT, station.seen, level, left, right)


FINDING, STAGE = "water-search", "water"
"""Names of the stages: outlines of bodies of water, and levels of bodies."""
CELLS, CROWNS = "water-cells", "water-crowns"
"""Rasters of the labels of water, and of the crowns near water."""
