"""Stage export of a run: writes the files for users, and archives outdated files of earlier runs."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from tiler.core.products import CONTOURS, SPOTS
from tiler.core.terrain_results import ContourResult, SpotCounts
from tiler.core.units_text import short_unit
from tiler.errors import ProcessingError, write_error
from tiler.export import WriteCog
from tiler.export.records import (
    CloudRecord,
    ContoursRecord,
    FileRecord,
    OutlineFileRecord,
    RasterFileRecord,
    SpotsRecord,
)
from tiler.export.stac import horizontal_code
from tiler.export.tasks.catalogue import STAGE, catalogue_tasks, planned
from tiler.export.tasks.class_counts import report_earlier_classes, report_written_classes
from tiler.export.tasks.drawn import vector_tasks
from tiler.export.tasks.files import (
    classified_tasks,
    cog_tasks,
    index_tasks,
    inputs_of,
    legend_tasks,
    mosaic_tasks,
)
from tiler.export.tasks.outdated import archive_outdated, invalidate_changed_outputs
from tiler.export.tasks.sheets import cut
from tiler.filter.tasks.labelled import Labelled
from tiler.grid.tasks.corrections import Corrections
from tiler.grid.tasks.gridding import GridContext
from tiler.ingest.tasks.points import Source
from tiler.io.locations import is_url, joined, sizes_at
from tiler.io.result_folder import LEGEND, OUTLINE, SHEETS, VIRTUAL, below
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task, digest_of
from tiler.store import Commits

PRODUCTS = (".tif", ".vrt", ".gpkg", ".vpc", ".json", LEGEND)
"""Endings of the files of products. Their tasks have the names of the files as keys."""


def export(
    job: Job,
    gridding: GridContext,
    sources: list[Source],
    spooled: Commits,
    labelled: Labelled,
    corrections: Corrections,
) -> None:
    """Write the files for users: rasters, vector products, classified clouds, and the catalogue."""
    out = job.products
    gridding.sheets = cut(job, gridding)
    if job.plan.config.sheets is not None:
        job.results.sheets = len(gridding.sheets)
    digest = digest_of(sorted(source.content for source in sources))
    tasks = [*cog_tasks(gridding, inputs_of(sources, spooled), digest, out), *legend_tasks(gridding, out)]
    tasks += vector_tasks(gridding, out, labelled.noise_m)
    rasters = list(tasks)
    clouds: list[Task] = []
    if job.plan.writes_clouds:
        edits = corrections.edits
        clouds += classified_tasks(
            job.plan,
            sources,
            spooled,
            labelled.digests,
            gridding.waters,
            None if edits is None else edits.key,
            out,
        )
        report_earlier_classes(job, clouds)
    tasks += clouds
    mosaics = list(mosaic_tasks(gridding, digest, out))
    basis = _basis(gridding)
    written = {key: below(out, location) for key, location in _files([*tasks, *mosaics]).items()}
    written |= {SHEETS: SHEETS} if mosaics else {}
    written |= planned(gridding)
    archive_outdated(job, written, basis)
    # Archiving may have removed the folder of the sheets, so the folders are made afterwards.
    _make_folders(rasters, out)
    # The store keeps the code, so that a run without new results does not search for it again.
    known = job.store.get_state("crs")
    with ThreadPoolExecutor(1) as meanwhile:  # The workers write at the same time.
        computed = None if known else meanwhile.submit(horizontal_code, job.plan.grid.meta.frame.crs_wkt)
        made = _write(job, "export", tasks, out)
    crs_code = known["code"] if computed is None else computed.result()
    if computed is not None:
        job.store.put_state("crs", {"code": crs_code})
    job.store.drop_records()
    if clouds:
        report_written_classes(job, clouds, made)
    _report_contours(job)
    _report_spots(job)
    _report_outline(job)
    if job.results.fetched is not None:
        written_clouds = [CloudRecord.of(made[task.key][1]) for task in clouds if task.key in made]
        classified_bytes = sum(record.fetched or 0 for record in written_clouds)
        job.results.fetched = replace(job.results.fetched, classified=classified_bytes)
    if mosaics or job.store.committed("mosaic"):
        mosaics += index_tasks(tasks, made, out)
        made |= _write(job, "mosaic", mosaics, out)
    catalogue = list(catalogue_tasks(gridding, sources, labelled.kind, made, out, crs_code))
    _make_folders(catalogue, out)
    made |= _write(job, STAGE, catalogue, out)
    files = [task.key for task in (*tasks, *mosaics, *catalogue) if task.key.endswith(PRODUCTS)]
    if gridding.plan.inputs.area is not None:
        terrain = [
            task.key
            for task in tasks
            if isinstance(task.arguments, WriteCog) and task.arguments.product == "dtm"
        ]
        filled = sum(RasterFileRecord.of(made[key][1]).valid for key in terrain if key in made)
        job.results.dtm = replace(job.results.dtm, filled=filled)
    # The virtual cloud is valid as long as the clouds are, which have no basis in run.json.
    rasters_of = (path for key, path in written.items() if key.endswith(PRODUCTS) and path != VIRTUAL)
    job.results.made_of = {**job.results.made_of, **dict.fromkeys(rasters_of, basis)}
    unwritten = [path for path in written.values() if path not in job.results.outputs]
    # If a task failed, the file of an earlier run may still be there.
    sizes = sizes_at([joined(out, path) for path in unwritten])
    job.results.earlier_outputs = {
        p: None for p, size in zip(unwritten, sizes, strict=True) if size is not None
    }
    _validate_outputs_exist(job)
    if not all(key in made for key in files):
        raise ProcessingError(
            f"{job.record.failed[-1].key} could not be written: {job.record.failed[-1].error}"
        )


def _make_folders(tasks: list[Task], out: str) -> None:
    for folder in {task.arguments.out for task in tasks if not is_url(out)}:
        try:
            Path(folder).mkdir(exist_ok=True)
        except OSError as error:
            raise write_error(folder, error, Path(out)) from error


def _report_outline(job: Job) -> None:
    commit = job.store.committed("export").get(OUTLINE)
    outline = job.results.outline
    if commit is not None and outline is not None:
        record = OutlineFileRecord.of(commit[1])
        job.results.outline = replace(outline, rings=record.rings or [], polygons=record.polygons)


def _report_contours(job: Job) -> None:
    commit = job.store.committed("export").get(f"{CONTOURS}.gpkg")
    if CONTOURS not in job.plan.config.drawn or commit is None:
        return
    record, unit = ContoursRecord.of(commit[1]), short_unit(job.plan.grid.meta.frame.units.vertical)
    job.results.contours = ContourResult(
        record.interval, record.lines, record.vertices, record.cut, record.short
    )
    if job.plan.config.contour_interval is None and record.low is not None:
        job.note(
            f"decided: contours every {record.interval:g} {unit}, as nearly all of the terrain lies between "
            f"{record.low:.1f} and {record.high:.1f} {unit} (--contour-interval)"
        )
    if record.cut:
        job.note(
            f"contour lines that are written in two parts, as whole lines need more memory (--memory): "
            f"{record.cut:,}"
        )


def _report_spots(job: Job) -> None:
    commit = job.store.committed("export").get(f"{SPOTS}.gpkg")
    if SPOTS in job.plan.config.drawn and commit is not None:
        record = SpotsRecord.of(commit[1])
        job.results.spots = SpotCounts(record.highs, record.lows)


def _validate_outputs_exist(job: Job) -> None:
    """Raise ProcessingError if files of the run were removed already, since a finished run must have them."""
    outputs = list(job.results.outputs)
    sizes = sizes_at([joined(job.products, path) for path in outputs])
    gone = [path for path, size in zip(outputs, sizes, strict=True) if size is None]
    if gone:
        more = f" and {len(gone) - 1:,} more files" if len(gone) > 1 else ""
        raise ProcessingError(
            f"{joined(job.products, gone[0])}{more}: removed during the run; run again to "
            "make the missing files"
        )


def _basis(gridding: GridContext) -> str:
    """Return the digest of everything from which the products are made: points, labels and settings.

    Settings that only change the format of the files are not in it.
    """
    config = gridding.plan.config
    terrain = [[key, digest] for key, (digest, _) in sorted(gridding.made["dtm"].items())]
    into = [str(config.sheets), config.sheet_name, config.empty_sheets] if config.sheets else None
    water = gridding.water_key
    return digest_of(
        terrain, config.voids, config.outline, str(config.spike), into, gridding.plan.inputs.area_key, water
    )


def _files(tasks: list[Task]) -> dict[str, str]:
    """Return the path or URL of the file that each task writes, by the key of the task."""
    return {
        t.key: joined(t.arguments.out, t.key) if t.key.endswith(PRODUCTS) else t.arguments.out for t in tasks
    }


def _write(job: Job, stage: str, tasks: list[Task], out: str) -> Commits:
    """Write the files that are missing or were changed, and return the commits of all files that were written."""
    files = _files(tasks)
    invalidate_changed_outputs(job, stage, files)
    written = run_stage(job, stage, tasks, writes_out=True)
    sizes, digests = dict(job.results.outputs), dict(job.results.digests)
    notes: dict[str, None] = {}
    for key, (_, stored) in written.items():
        path, record = below(out, files[key]), FileRecord.of(stored)
        sizes[path] = record.bytes
        if record.digest is not None:
            digests[path] = record.digest
        notes |= dict.fromkeys(record.notes or ())
    job.results.outputs, job.results.digests = sizes, digests
    for text in notes:
        job.note(text)
    return written
