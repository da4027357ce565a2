"""The stages grid and export of a run: the terrain's raster, the other products, and the files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ptd.warm import warm_gridding
from tiler.core.lattice import Cell
from tiler.core.raster import RasterSpec
from tiler.errors import ProcessingError
from tiler.job import Commits, Job, Warm
from tiler.plan import GRID_BLOCK, KEEP
from tiler.product_tasks import cog_task, fill_of, product_tasks, wanted
from tiler.schedule import Task, digest_of
from tiler.tasks import Assembled, Source, classified_tasks, grid_tasks, raster_spec


def grid(job: Job, assembled: Assembled, labels: dict[Cell, str]) -> dict[str, Commits]:
    """All rasters that the products need, block by block; name -> commits of its blocks."""
    spec = raster_spec(job.plan, assembled)
    made: dict[str, Commits] = {}
    for name in wanted(job.plan.config.products):
        if name == "dtm":
            tasks = list(grid_tasks(job.plan, assembled, labels, name))
            made[name] = _blocks(job, spec, name, tasks, warm_gridding)
            _tell_of_terrain(job, spec, tasks, made[name])
        else:
            tasks = list(product_tasks(name, job.plan, assembled, labels, made))
            made[name] = _blocks(job, spec, name, tasks)
    return made


def _blocks(job: Job, spec: RasterSpec, name: str, tasks: list[Task], warm: Warm | None = None) -> Commits:
    """Make one raster of the store."""
    stage, fill = f"grid-{name}", fill_of(name, job.plan)
    done, stale = job.sorted_out(stage, tasks)
    job.take_back(stage, stale)
    job.store.create_raster(name, spec.height, spec.width, fill)
    if job.store.get_state(f"raster-{name}"):  # an earlier run wrote blocks that this one may not write again
        for block in spec.blocks(GRID_BLOCK):
            if block.name not in done:
                job.store.write_block(name, block, np.full((block.height, block.width), fill, np.float32))
    job.store.put_state(f"raster-{name}", spec.to_json())
    made = job.perform(stage, tasks, warm)
    if tasks and not made:
        raise ProcessingError(f"no block of {name} could be made; the first: {job.failed[0]['error']}")
    return made


def _tell_of_terrain(job: Job, spec: RasterSpec, tasks: list[Task], made: Commits) -> None:
    records = [record for _, record in made.values()]
    job.facts["dtm"] = {
        "width": spec.width, "height": spec.height, "resolution_m": float(job.plan.resolution),
        **{k: sum(r[k] for r in records) for k in ("filled", "marked")},
        "blocks": len(tasks), "blocks_done_again": sum(r["tries"] > 1 for r in records),
        "thinned": any(task.arguments["thin_cell"] for task in tasks),
    }  # fmt: skip


def export(
    job: Job, assembled: Assembled, made: dict[str, Commits], sources: list[Source], spooled: Commits,
    labels: dict[Cell, str],
) -> None:  # fmt: skip
    """The files that people open."""
    out, spec = job.out.resolve(), raster_spec(job.plan, assembled)
    digest = digest_of(sorted(source.content for source in sources))
    products = job.plan.config.products
    tasks = [cog_task(job.plan, spec, made[name], digest, out, name) for name in products]
    if job.plan.config.method != KEEP:
        tasks += classified_tasks(job.plan, sources, spooled, labels, out)
    files = {
        t.key: Path(t.arguments["out"]) / t.key if t.key.endswith(".tif") else Path(t.arguments["out"])
        for t in tasks
    }
    for key, (_, record) in job.store.committed("export").items():
        if key in files and not (files[key].exists() and files[key].stat().st_size == record["bytes"]):
            job.store.uncommit("export", key)
    exported = job.perform("export", tasks)
    job.facts["outputs"] = {
        str(files[k].relative_to(out)): record["bytes"] for k, (_, record) in exported.items()
    }
    for _, record in exported.values():
        for text in record.get("notes", ()):
            job.note(text)
    for name in products:
        if f"{name}.tif" not in exported:
            raise ProcessingError(f"{name}.tif could not be written: {job.failed[-1]['error']}")
