"""The water of a run: bodies from a file or from the data, their levels, and what the rasters take of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tiler.config import AUTO_WATER
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.water import LAKE, Water, Waters, lengths_along
from tiler.grid import FindWater, LevelWater, find_bodies, level_water
from tiler.io.result_folder import WATER
from tiler.plan.memory import BASE_BYTES
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, digest_of
from tiler.stages.filter import MATCHED, kind_of
from tiler.stages.gridding import Gridding
from tiler.stages.map_lines import add_rings
from tiler.stages.raster_tasks import WHOLE
from tiler.store import Commits
from tiler.version import __version__

FINDING, STAGE = "water-search", "water"
CELL_BYTES = 60
"""Of a coarse cell while water is looked for: measured 45."""
MANY_CELLS = 1 << 21
"""Coarse cells whose search takes more memory than other tasks leave free in a worker: 90 MB."""
STEEPEST = 1 / 30
"""Fall of a river over its length, at most."""
SHORE_REACH = 4
"""Pixels around a body of water that its level may depend on."""


def find_waters(job: Job, g: Gridding) -> Waters:
    """The bodies of water with their levels, kept in the store for the tasks."""
    auto = g.plan.config.water == AUTO_WATER
    bodies = _found(job, g) if auto else g.plan.waters
    tasks = list(level_tasks(g, bodies))
    made = run_stage(job, STAGE, tasks) if tasks else {}
    levelled = []
    for body in bodies:
        record = made.get(_key(body), (None, {}))[1]
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
        job.note(
            f"decided: water found, {lakes} lakes and {len(waters.bodies) - lakes} rivers or canals, level in the "
            f"terrain ({WATER} can be edited and given back by --water; --water none leaves the terrain as it is)"
        )
    job.store.put_waters(waters)
    return waters


def _found(job: Job, g: Gridding) -> tuple[Water, ...]:
    """The bodies that the data show, without levels."""
    config, frame = g.plan.config, g.plan.meta.frame
    needed = BASE_BYTES + CELL_BYTES * g.coarse.height * g.coarse.width
    if needed > g.plan.memory:
        job.note(
            f"water is not looked for, which takes {needed / 2**20:,.0f} MiB here: give more --memory, or a file to "
            "--water"
        )
        return ()
    work = FindWater(
        "dtm", g.spec, tuple(sorted(g.made["dtm"])), "occupancy", g.coarse,
        gap=float(config.max_edge / g.coarse_m), trusted=kind_of(job) != MATCHED,
        lake_m2=float(config.water_min_lake), river_width_m=float(config.water_min_river_width),
        island_m2=float(config.water_min_island),
    )  # fmt: skip
    seen = [g.checksums(name) for name in ("dtm", "occupancy")]
    digest = digest_of(__version__, work, seen, str(frame.units.vertical))
    cells = g.coarse.height * g.coarse.width
    task = Task(FINDING, WHOLE, digest, find_bodies, work, cells, starts_small=cells > MANY_CELLS)
    made = run_stage(job, FINDING, [task])
    return tuple(Water.from_json(body) for body in made[WHOLE][1]["bodies"]) if made else ()


def _gentle(g: Gridding, body: Water) -> bool:
    """Whether a river falls no more than rivers of that width do: a ravine without returns is none."""
    high, low = body.range
    if body.flow is None or high == low:
        return True
    units = g.plan.meta.frame.units
    length = lengths_along(body.flow)[-1] / COUNTS_PER_UNIT * float(units.horizontal)
    return bool((high - low) * float(units.vertical) <= STEEPEST * length)


def level_tasks(g: Gridding, bodies: tuple[Water, ...]) -> Iterator[Task]:
    """One for each body whose height is not known."""
    spec = g.spec
    pad = int(SHORE_REACH * spec.lattice.size) + 1
    for body in bodies:
        if body.levelled:
            continue
        near = body.area.bounds.pad(pad)
        others = tuple(b.area for b in bodies if b is not body and b.area.bounds.overlaps(near))
        work = LevelWater(body, others, "dtm", spec)
        seen = g.checksums("dtm", (block.name for block in spec.blocks_within(near, BLOCK_PIXELS)))
        digest = digest_of(__version__, body.digest, body.number, [other.key for other in others], spec, seen)
        yield Task(STAGE, _key(body), digest, level_water, work)


def _key(body: Water) -> str:
    return f"w{body.number:06d}"


def tell_of_waters(job: Job, waters: Waters, terrain: Commits) -> None:
    """Say in run.json what the water is, and how many pixels of the terrain each body has."""
    pixels: dict[int, int] = {}
    for _, record in terrain.values():
        for number, count in record.get("water", ()):
            pixels[number] = pixels.get(number, 0) + count
    square = float(job.plan.resolution) ** 2
    facts = [_fact(body, pixels.get(body.number, 0), square) for body in waters.bodies]
    add_rings(facts, [body.area for body in waters.bodies])
    job.facts["water"] = facts


def _fact(body: Water, pixels: int, square: float) -> dict[str, Any]:
    high, low = body.range
    return {
        "number": body.number,
        "kind": body.kind,
        "level": high,
        "level_end": low,
        "pixels": pixels,
        "area_m2": pixels * square,
        "sure": body.sure,
        "bounds": [v / COUNTS_PER_UNIT for v in body.area.bounds.to_json()],
    }
