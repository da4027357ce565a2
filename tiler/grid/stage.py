"""Stage grid of a run: the raster of the terrain and those of the other products, block by block."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from tiler.config import NO_WATER
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds
from tiler.core.products import OUTLINED
from tiler.core.raster import BLOCK_PIXELS, RasterSpec
from tiler.core.records import records_of
from tiler.core.results import Implausible, OutlineResult, TerrainResult
from tiler.core.selection import WITHHELD
from tiler.core.units import length_text
from tiler.core.words import counted, listed
from tiler.errors import ProcessingError
from tiler.grid.records import TerrainRecord
from tiler.grid.steps import erase_blocks
from tiler.grid.tasks.canopy import report_canopy
from tiler.grid.tasks.correct import report_edited_pixels
from tiler.grid.tasks.findings import advise, report_voids
from tiler.grid.tasks.gridding import GAP_M, Corrections, GridContext
from tiler.grid.tasks.raster_table import required_rasters
from tiler.grid.tasks.steps import Step
from tiler.grid.tasks.terrain import OnTin, join_blocks
from tiler.grid.tasks.water import find_waters, report_waters
from tiler.observe.events import Note, Warned
from tiler.plan import KEEP
from tiler.plan.model import MAX_GROUND
from tiler.runs.compiling import grid_kernels
from tiler.runs.found import Gridded, IngestResult, Labelled
from tiler.runs.job import Job
from tiler.runs.stage_runner import Join, run_stage
from tiler.schedule import Task, calling
from tiler.schedule.worker import compute
from tiler.store import Commits

MATCHED_SURFACE, MATCHED_EROSION = "median", Fraction(1, 2)
"""Defaults of `surface` and `erode` for photogrammetric clouds.

The median averages noise. Erosion removes the skirts of walls, which filters cannot distinguish
from ground.
"""
BLANK_BLOCKS = 256
"""Number of blocks of an earlier run that one task removes."""
MAX_CLASSES = 10
"""Maximum number of classes that the reason for an empty terrain lists."""


def grid(
    job: Job, assembled: IngestResult, labelled: Labelled, corrections: Corrections
) -> Gridded:
    """Make all rasters that the products need, block by block."""
    if labelled.matched and job.plan.config.method != KEEP:
        _settle_surface(job)
    gridding = GridContext(
        job.plan, assembled, labelled.digests, _holes(job), corrections=corrections,
        returns_show_water=not labelled.matched, kind=labelled.kind,
        canopy=labelled.canopy,
    )  # fmt: skip
    report_canopy(job, labelled)
    rasters = required_rasters(job.plan)
    for raster in rasters:
        name = raster.name
        if name == OUTLINED and job.plan.config.water != NO_WATER:
            gridding.waters = find_waters(job, gridding)
        tasks = list(raster.tasks(gridding))
        join = partial(join_blocks, job.plan, assembled.records) if name == "dtm" else None
        gridding.fills[name] = raster.fill
        gridding.made[name] = _make(job, raster, gridding.spec_of(raster.grid), tasks, join)
        if name == "dtm":
            _report_terrain(job, gridding, tasks, gridding.made[name])
    outlined = gridding.made[OUTLINED]
    report_edited_pixels(job, outlined)
    advise(job, labelled, gridding.spec, outlined, gridding.waters.stored_key)
    if job.plan.config.water != NO_WATER:
        report_waters(job, gridding.waters, outlined)
    job.results.dtm = replace(job.results.dtm, filled=gridding.delivered_heights("dtm"))
    _report_outline(job, gridding)
    report_voids(job, gridding, outlined)
    for raster in rasters:
        if isinstance(raster, Step) and raster.finish is not None:
            counts = gridding.counts(raster.name, raster.grid, raster.side)
            raster.finish(job, gridding, counts)
    return gridding.found()


def _settle_surface(job: Job) -> None:
    """Set defaults for the surface of a photogrammetric cloud: it is noisy, its walls have skirts."""
    plan, config = job.plan, job.plan.config
    surface = config.surface or MATCHED_SURFACE
    erode = MATCHED_EROSION if config.erode is None else config.erode
    if (surface, erode) != (config.surface, config.erode):
        erode_text = length_text(erode, plan.frame.units.horizontal)
        job.note(
            f"decided: the surface is the {surface} height of each cell half a pixel wide, without ground within "
            f"{erode_text} of objects, because the cloud is photogrammetric (--surface, --erode)"
        )
    job.plan = replace(plan, config=config.updated(surface=surface, erode=erode))


def _holes(job: Job) -> list[Bounds]:
    """Return the bounds in absolute counts where tiles or buckets failed."""
    return [
        Bounds(*(round(edge * COUNTS_PER_UNIT) for edge in task.bounds))
        for task in job.record.failed
        if task.stage.startswith(("assemble", "filter")) and task.bounds
    ]


def _make(
    job: Job, raster: OnTin | Step, spec: RasterSpec, tasks: list[Task], join: Join | None
) -> Commits:
    name, stage = raster.name, raster.stage
    done, stale = job.split_commits(stage, tasks)
    job.invalidate(stage, stale)
    job.store.create_raster(name, spec, raster.fill)
    written = {
        spec.block_at(*first_pixel, BLOCK_PIXELS).name
        for first_pixel in job.store.stored_blocks(name)
    }
    lost = {key for key, (_, stored) in done.items() if stored.get("filled")} - written
    if lost:
        job.note(
            f"{counted(len(lost), 'block')} of {name} missing from the store; made again", Note
        )
    job.invalidate(stage, lost)
    _blank(job, name, spec, written - done.keys())
    job.store.put_state(f"raster-{name}", spec.to_json())
    if not tasks:
        return {}
    made = run_stage(job, stage, tasks, grid_kernels(job.plan.config.interpolation), join=join)
    if not made:
        raise ProcessingError(
            f"no block of {name} could be made; the first error: {job.record.first_error(stage)}"
        )
    return made


def _blank(job: Job, name: str, spec: RasterSpec, keys: Collection[str]) -> None:
    """Remove, on the workers, blocks of an earlier run that this run does not write."""
    blocks, tasks = [spec.block_named(key, BLOCK_PIXELS) for key in sorted(keys)], []
    for start in range(0, len(blocks), BLANK_BLOCKS):
        some = blocks[start : start + BLANK_BLOCKS]
        call = calling(erase_blocks, name=name, blocks=some)
        tasks.append(Task.of("blank", f"{start:09d}", call))
    for outcome in job.executors.choose().run(compute, job.store.url, tasks) if tasks else ():
        if outcome.record is None and not outcome.again:
            raise ProcessingError(
                f"{name}: blocks of an earlier run cannot be removed: {outcome.error}"
            )


def _report_outline(job: Job, gridding: GridContext) -> None:
    made = gridding.made[OUTLINED]
    if not made or job.plan.config.outline != "survey":
        return
    cut = sum(counts["cut"] for _, counts in made.values())
    usual, widest = _gaps(gridding)
    job.results.outline = OutlineResult(
        gap_m=usual, widest_gap_m=widest, cell_m=float(gridding.coarse_m), cut_pixels=cut
    )
    if cut:
        unit = job.plan.frame.units.horizontal
        sparse = (
            f" ({length_text(widest, unit)} where points are sparse)" if widest > usual else ""
        )
        job.note(
            f"{counted(cut, 'pixel')} outside the survey left without a height; gaps of up to "
            f"{length_text(usual, unit)}{sparse} between points count as surveyed (--outline hull keeps these heights)"
        )


def _gaps(gridding: GridContext) -> tuple[float, float]:
    """Return the width in metres of the gaps inside the survey: in most windows with points, and the widest."""
    windows: Counter[float] = Counter()
    for counts in gridding.counts("survey-open").values():
        windows.update(dict(counts["gaps"]))
    if not windows:
        return float(GAP_M), float(GAP_M)
    size = float(gridding.coarse_m)
    usual = min(windows, key=lambda gap: (-windows[gap], gap))
    return usual * size, max(windows) * size


def _report_terrain(
    job: Job, gridding: GridContext, tasks: list[Task], made: Mapping[str, Any]
) -> None:
    spec = gridding.spec
    if job.plan.thin_ground and job.plan.config.surface_percent is None:
        reason = "the first run on this store decided it (--overwrite decides again)"
        if job.plan.exceeds_max_ground:
            reason = (
                f"more than {MAX_GROUND:,} points may lie in a part of a block and within --max-edge of it, which is "
                "too many for one TIN"
            )
        job.note(
            f"decided: one ground point per cell a quarter of a pixel wide makes the surface, because {reason}"
        )
    records = records_of(TerrainRecord, made)
    job.results.dtm = TerrainResult(
        width=spec.width,
        height=spec.height,
        resolution_m=float(job.plan.grid.resolution),
        filled=sum(record.filled for record in records),
        marked=sum(record.marked for record in records),
        blocks=len(tasks),
        blocks_done_again=sum(record.tries > 1 for record in records),
        thinned=any(task.arguments["work"].thin for task in tasks),
    )
    if records and job.results.dtm.filled == 0:
        text = f"the terrain model is empty: {_why_empty(job, gridding.assembled)}"
        job.record.notes.append(text)
        job.results.implausible = [Implausible("empty terrain model", text, "", None)]
        job.listener(Warned(text))


def _why_empty(job: Job, assembled: IngestResult) -> str:
    """Return why the terrain is empty, with a remedy if there is one."""
    config, counts, stored = job.plan.config, job.results.counts, job.results.counts.stored
    reasons = {WITHHELD: "the flag withheld", **config.selection.options}
    for key, reason in reasons.items():
        if counts.unselected.get(key, 0) >= stored:
            remedy = "use --withheld keep" if key == WITHHELD else "use another value"
            return f"{reason} excludes all {stored:,} points; {remedy}"
    if config.method == KEEP:
        existing = job.results.classes.input
        classes_text = ", ".join(map(str, config.ground_classes))
        if not any(str(code) in existing for code in config.ground_classes):
            texts = [f"{code} ({counted(n, 'point')})" for code, n in existing.items()]
            return (
                f"no point has class {classes_text}; the classes of the clouds are {listed(texts, MAX_CLASSES)}; "
                "give those of the ground with --ground-classes, or use --method auto"
            )
        ground_text = f"points of class {classes_text}"
    elif counts.kept_out == stored:
        return (
            f"none of the {stored:,} points takes part in the filter: all are withheld, skipped, left out by "
            "--returns or the like, or of a class that is kept (`tiler info` shows the classes); --keep-classes none "
            "filters the classes too"
        )
    else:
        ground_text = "ground points"
    if stored > 2 and _on_one_line(job, assembled):
        distance = length_text(job.plan.grid.resolution / 2, job.plan.frame.units.horizontal)
        return f"all {stored:,} points lie on one line (within {distance} of it); a terrain needs points of an area"
    return f"no three {ground_text} lie within --max-edge {float(config.max_edge):g} m of one another"


def _on_one_line(job: Job, assembled: IngestResult) -> bool:
    """Return whether all points lie within half a pixel of one line.

    Such a line is a diagonal of the bounds. Reading ends at the first bucket with points beside
    both diagonals, which is the first of all buckets in a usual cloud.
    """
    bounds, frame = assembled.bounds, job.plan.frame
    # The bounds are half-open.
    width, height = bounds.x1 - 1 - bounds.x0, bounds.y1 - 1 - bounds.y0
    limit = (
        float(frame.counts(job.plan.grid.resolution)) / 2 * max(math.hypot(width, height), 1)
    )
    diagonals = {(bounds.y0, height), (bounds.y1 - 1, -height)}
    for cell in assembled.records:
        x, y, _ = job.store.read_bucket(cell).xyz.astype(np.float64)
        x, y = x + (frame.origin[0] - bounds.x0), y + frame.origin[1]
        diagonals = {
            (start, rise)
            for start, rise in diagonals
            if (np.abs(x * rise - (y - start) * width) <= limit).all()
        }
        if not diagonals:
            return False
    return True
