"""The stage grid of a run: the terrain's raster and those of the other products, block by block."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from tiler.config import NO_WATER
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.lattice import Bounds, Cell
from tiler.core.mask_values import MASK_VALUES, OUTSIDE
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.errors import DamagedError, ProcessingError
from tiler.grid import DEEP_M, BlankBlocks, blank_blocks
from tiler.plan import KEEP
from tiler.plan.advice import roofs_in_terrain
from tiler.runs.compiling import grid_kernels
from tiler.runs.job import Job
from tiler.runs.stage_runner import Join, run_stage
from tiler.runs.worker import compute
from tiler.schedule import Task, digest_of
from tiler.stages.corrections import Corrections, tell_of_pixels
from tiler.stages.filter import MATCHED, kind_of
from tiler.stages.gridding import Gridding, Raster
from tiler.stages.raster_table import wanted
from tiler.stages.raster_tasks import WHOLE
from tiler.stages.shared_tins import joined_blocks
from tiler.stages.tasks import Assembled
from tiler.stages.water import find_waters, tell_of_waters
from tiler.store import Commits, open_store

MATCHED_SURFACE, MATCHED_EROSION = "median", Fraction(1, 2)
"""How the surface of matched clouds is made unless the user says it: noise is averaged, and the skirts of
walls, which no filter tells from ground, are left out."""
BLANK_BLOCKS = 256
"""Blocks of an earlier run that one task removes."""


def grid(job: Job, assembled: Assembled, labels: dict[Cell, str], corrections: Corrections) -> Gridding:
    """All rasters that the products need, block by block."""
    _settle_surface(job)
    gridding = Gridding(job.plan, assembled, labels, _holes(job), decks=corrections.decks)
    for raster in wanted(job.plan.config):
        name = raster.name
        if name == "dtm-outlined" and job.plan.config.water != NO_WATER:
            gridding.waters = find_waters(job, gridding)
        tasks = [corrections.of_raster(job.plan, name, task) for task in raster.tasks(raster, gridding)]
        join = partial(joined_blocks, job.plan, assembled.records) if name == "dtm" else None
        gridding.made[name] = _make(job, raster, gridding.spec_of(raster), tasks, join)
        if name == "dtm":
            tell_of_pixels(job, gridding.made[name])
            _tell_of_terrain(job, gridding.spec, tasks, gridding.made[name])
            _advise(job, gridding.spec, gridding.made[name])
    if job.plan.config.water != NO_WATER:
        tell_of_waters(job, gridding.waters, gridding.made["dtm-outlined"])
    _tell_of_outline(job, gridding)
    if "dsm" in gridding.made:
        _tell_of_surface(job, gridding.made["dsm"])
    if "mask" in gridding.made:
        _tell_of_mask(job, gridding.spec, gridding.made["mask"])
    return gridding


def _settle_surface(job: Job) -> None:
    """Decide what makes the surface where the user does not: matched clouds are noisy, their walls have skirts."""
    plan, config = job.plan, job.plan.config
    if config.method == KEEP or kind_of(job) != MATCHED:
        return
    surface = config.surface or MATCHED_SURFACE
    erode = MATCHED_EROSION if config.erode is None else config.erode
    if (surface, erode) != (config.surface, config.erode):
        job.note(
            f"decided: the surface is the {surface} of the heights in half a pixel, without ground within "
            f"{float(erode):g} m of objects, as the cloud is matched (--surface, --erode)"
        )
    job.plan = replace(plan, config=config.updated(surface=surface, erode=erode))


def _holes(job: Job) -> list[Bounds]:
    """Where tiles or buckets failed, absolute counts."""
    found = [
        f["bounds"]
        for f in job.record.failed
        if f["stage"].startswith(("assemble", "filter")) and f["bounds"]
    ]
    return [Bounds(*(round(edge * COUNTS_PER_UNIT) for edge in bounds)) for bounds in found]


def _make(job: Job, raster: Raster, spec: RasterSpec, tasks: list[Task], join: Join | None) -> Commits:
    """Make one raster of the store."""
    name, stage = raster.name, raster.stage
    done, stale = job.sorted_out(stage, tasks)
    job.take_back(stage, stale)
    job.store.create_raster(name, spec.height, spec.width, raster.fill)
    if WHOLE not in done:
        stored = {spec.block_at(*place, BLOCK_PIXELS).name for place in job.store.stored_blocks(name)}
        lost = {key for key, (_, record) in done.items() if record.get("filled")} - stored
        if lost:
            job.note(f"{len(lost)} blocks of {name} are gone from the store; they are made again")
        job.take_back(stage, lost)
        _blank(job, name, spec, stored - done.keys())
    job.store.put_state(f"raster-{name}", spec.to_json())
    made = run_stage(job, stage, tasks, grid_kernels(job.plan.config.interpolation), join=join)
    if tasks and not made:
        raise ProcessingError(f"no block of {name} could be made; the first: {job.record.first_error(stage)}")
    return made


def _blank(job: Job, name: str, spec: RasterSpec, keys: Collection[str]) -> None:
    """Have the workers remove blocks that an earlier run wrote: this one may not write them again."""
    blocks, tasks = [spec.block_named(key, BLOCK_PIXELS) for key in sorted(keys)], []
    for start in range(0, len(blocks), BLANK_BLOCKS):
        work = BlankBlocks(name, tuple(blocks[start : start + BLANK_BLOCKS]))
        digest = digest_of(work)
        tasks.append(Task("blank", digest, digest, blank_blocks, work))
    for outcome in job.crew.executor().run(compute, job.store.url, tasks) if tasks else ():
        if outcome.record is None and not outcome.again:
            raise ProcessingError(f"{name}: blocks of an earlier run cannot be removed: {outcome.error}")


def _advise(job: Job, spec: RasterSpec, made: Commits) -> None:
    """Look for roofs in the terrain, where a parameter of the method could have kept them out of it."""
    building = job.plan.parameters.get("max_building_size_m")
    if building is None:
        return
    found = job.store.get_state("advice")
    if job.record.stages["grid-dtm"]["computed"] or not found or found["building_m"] != building:
        filled = tuple(key for key, (_, record) in made.items() if record["filled"])
        work = FindRoofs(spec, filled, building, job.plan.parameters.get("roof_size_m"))
        found = {"building_m": building, "texts": _roofs_left(job, work)}
        job.store.put_state("advice", found)
    job.facts["advice"] = found["texts"]
    for line in found["texts"]:
        job.listener("warning", {"text": line})


@dataclass(frozen=True)
class FindRoofs:
    """Where roofs are looked for in the terrain, see `roofs_in_terrain`; ``filled``: names of blocks with heights."""

    spec: RasterSpec
    filled: tuple[str, ...]
    building_m: float
    roof_m: float | None


def find_roofs(store_url: str, work: FindRoofs) -> dict[str, Any]:
    """On a worker, which has loaded the kernels that this needs: ``texts``, warnings of roofs in the terrain."""
    blocks = (work.spec.block_named(key, BLOCK_PIXELS) for key in work.filled)
    text = roofs_in_terrain(open_store(store_url), "dtm", work.spec, blocks, work.building_m, work.roof_m)
    return {"texts": [] if text is None else [text]}


def _roofs_left(job: Job, work: FindRoofs) -> list[str]:
    """Have a worker look for roofs."""
    task = Task("advice", "roofs", digest_of(work), find_roofs, work)
    *_, last = job.crew.executor().run(compute, job.store.url, [task])
    if last.damaged:
        raise DamagedError(
            f"{job.store.url}: {', '.join(last.damaged)}: damaged or gone; run again", last.damaged
        )
    if last.record is None:
        raise ProcessingError(f"roofs in the terrain cannot be looked for: {last.error}")
    found: list[str] = last.record["texts"]
    return found


def _tell_of_outline(job: Job, gridding: Gridding) -> None:
    made = gridding.made.get("dtm-outlined")
    if not made:
        return
    cut, added = (sum(record[name] for _, record in made.values()) for name in ("cut", "added"))
    job.facts["dtm"]["filled"] += added - cut
    if job.plan.config.outline != "survey":
        return
    gap = gridding.made["survey"][WHOLE][1]["gap"] * float(gridding.coarse_m)
    job.facts["outline"] = {"gap_m": gap, "cell_m": float(gridding.coarse_m), "cut_pixels": cut}
    if cut:
        job.note(
            f"{cut:,} pixels beyond the survey have no height: gaps in the points of up to {gap:g} m count as "
            "surveyed (--outline hull keeps these heights)"
        )


def _tell_of_surface(job: Job, made: Mapping[str, Any]) -> None:
    records = [record for _, record in made.values()]
    totals = {key: sum(record[key] for record in records) for key in ("filled", "measured", "deep")}
    job.facts["dsm"] = totals
    if totals["deep"]:
        job.note(
            f"in {totals['deep']:,} pixels all returns lie more than {DEEP_M:g} m below the terrain (low noise, or "
            "steep ground that was taken for it): the surface model has the terrain's height there"
        )


def _tell_of_mask(job: Job, spec: RasterSpec, made: Mapping[str, Any]) -> None:
    totals = np.sum([record["values"] for _, record in made.values()], axis=0).tolist()
    totals[OUTSIDE] += spec.height * spec.width - sum(record["pixels"] for _, record in made.values())
    job.facts["mask"] = {text.split(":")[0]: totals[value] for value, text in MASK_VALUES.items()}


def _tell_of_terrain(job: Job, spec: RasterSpec, tasks: list[Task], made: Mapping[str, Any]) -> None:
    if job.plan.thin_ground and job.plan.config.surface_percent is None:
        job.note(
            "decided: one ground point in each quarter of a pixel makes the surface, as all of them would need more "
            "memory in the densest place (--memory)"
        )
    records = [record for _, record in made.values()]
    job.facts["dtm"] = {
        "width": spec.width,
        "height": spec.height,
        "resolution_m": float(job.plan.resolution),
        **{k: sum(r[k] for r in records) for k in ("filled", "marked")},
        "blocks": len(tasks),
        "blocks_done_again": sum(r["tries"] > 1 for r in records),
        "thinned": any(task.arguments.thin for task in tasks),
    }
    if records and job.facts["dtm"]["filled"] == 0:
        text = f"the terrain model has no height at all: {_why_empty(job)}"
        job.record.notes.append(text)
        job.listener("warning", {"text": text})


def _why_empty(job: Job) -> str:
    """Why no pixel has a height, and what to do."""
    config, stored = job.plan.config, job.facts["counts"]["stored"]
    if config.method != KEEP and job.facts["counts"]["kept_out"] == stored:
        return (
            f"none of the {stored:,} points takes part in the filter: all are withheld, skipped, or of a class that is "
            "kept (`tiler info` shows the classes); --keep-classes none filters the classes too"
        )
    what = (
        f"points of class {', '.join(map(str, config.ground_classes))}"
        if config.method == KEEP
        else "ground points"
    )
    return f"no three {what} lie within --max-edge {float(config.max_edge):g} m of one another"
