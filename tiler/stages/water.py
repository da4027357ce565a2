"""The water of a run: bodies from a file or from the data, their levels, and what the rasters take of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.water import Water, Waters
from tiler.grid import LevelWater, level_water
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, digest_of
from tiler.stages.corrections import MOST_PLACES
from tiler.stages.gridding import Gridding
from tiler.store import Commits
from tiler.version import __version__

STAGE = "water"
SHORE_REACH = 4
"""Pixels around a body of water that its level may depend on."""


def find_waters(job: Job, g: Gridding) -> Waters:
    """The bodies of water with their levels, kept in the store for the tasks."""
    bodies = g.plan.waters
    made = run_stage(job, STAGE, level_tasks(g, bodies))
    found = []
    for body in bodies:
        record = made.get(_key(body), (None, {}))[1]
        levelled = body if body.levelled else record.get("body") and Water.from_json(record["body"])
        if levelled:
            found.append(levelled)
    if len(found) < len(bodies):
        names = ", ".join(str(b.number) for b in bodies if b.number not in {f.number for f in found})
        job.note(f"--water: no terrain along the shore of body {names}: it is left out; give it a `level`")
    waters = Waters(tuple(found))
    job.store.put_waters(waters)
    return waters


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
        blocks = (block.name for block in spec.blocks_within(near, BLOCK_PIXELS))
        seen = [[key, g.made["dtm"][key][1]["checksum"]] for key in blocks if key in g.made["dtm"]]
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
    rings = [[ring for rings in body.area.polygons for ring in rings] for body in waters.bodies]
    if sum(len(ring) for of_body in rings for ring in of_body) <= MOST_PLACES:
        for fact, of_body in zip(facts, rings, strict=True):
            fact["rings"] = [
                [*(ring / COUNTS_PER_UNIT).ravel().tolist(), *(ring[0] / COUNTS_PER_UNIT).tolist()]
                for ring in of_body
            ]
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
