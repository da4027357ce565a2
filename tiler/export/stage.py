"""Stage export of a run: writes the files for users, and archives outdated files of earlier runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tiler.core.products import CONTOURS, OUTLINED, SPOTS
from tiler.core.records import digest_of
from tiler.core.results import ContourResult, SpotCounts
from tiler.core.units import Sides, short_unit, sides_text
from tiler.core.words import listed
from tiler.errors import ProcessingError, write_error
from tiler.export.output_files import (
    CloudRecord,
    ContoursRecord,
    FileRecord,
    OutlineFileRecord,
    RasterFileRecord,
    SpotsRecord,
)
from tiler.export.stac import horizontal_code
from tiler.export.tasks.catalogue import (
    STAGE,
    catalogue_tasks,
    planned,
    survey_dates,
    written_clouds,
)
from tiler.export.tasks.changes import report_changes
from tiler.export.tasks.class_counts import report_earlier_classes, report_written_classes
from tiler.export.tasks.drawn import sheet_files, sheet_tasks, vector_tasks
from tiler.export.tasks.files import (
    classified_tasks,
    cog_tasks,
    index_tasks,
    inputs_of,
    legend_tasks,
    mosaic_tasks,
    overview_task,
)
from tiler.export.tasks.outdated import (
    archive_outdated,
    archive_sidecars,
    archive_unwritten,
    invalidate_changed_outputs,
)
from tiler.export.tasks.review import report_review, review_task
from tiler.export.tasks.sheets import cut
from tiler.io.locations import is_url, joined, sizes_at
from tiler.io.overwrite_check import check_links
from tiler.io.result_folder import LEGEND, OUTLINE, OVERVIEW, SHEETS, VIRTUAL, below
from tiler.observe.events import Detail
from tiler.runs.compiling import class_kernels
from tiler.runs.found import Gridded, Labelled, Source
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task
from tiler.store import Commits

PRODUCTS = (".tif", ".vrt", ".gpkg", ".vpc", ".json", LEGEND)
"""Endings of the files of products. The keys of their tasks are the names of the files, except those of sheets and
renamed rasters."""


@dataclass(frozen=True)
class FileTasks:
    """Tasks that write files.

    Attributes
    ----------
    cogs : list of Task
        GeoTIFFs.
    drawn : list of Task
        Legends of GeoTIFFs, and vector products.
    clouds : list of Task
        Classified clouds.
    overview : list of Task
        Overview of the classified clouds, if there are several.
    mosaics : list of Task
        VRT files of products that are divided into sheets.
    """

    cogs: list[Task]
    drawn: list[Task]
    clouds: list[Task]
    overview: list[Task]
    mosaics: list[Task]

    @property
    def at_once(self) -> list[Task]:
        """Tasks of the stage export, none of which needs the file of another one."""
        return [*self.cogs, *self.drawn, *self.overview, *self.clouds]


def export(
    job: Job,
    gridding: Gridded,
    sources: list[Source],
    spooled: Commits,
    labelled: Labelled,
) -> None:
    """Write the files for users: rasters, vector products, classified clouds, and the catalogue."""
    out = job.products
    if drawn := gridding.plan.inputs.sheets:
        name = job.store.put_areas([sheet.area for sheet in drawn])
        gridding = replace(gridding, drawn=name)
    gridding = replace(gridding, sheets=cut(job, gridding))
    if job.plan.config.sheets is not None:
        job.results.sheets = len(gridding.sheets)
    tasks = _file_tasks(job, gridding, sources, spooled, labelled)
    basis, paths = _basis(gridding), _paths(gridding, tasks, out)
    earlier = dict(job.results.digests)
    # The plan checked this as well, but the run may have taken hours since.
    check_links("-o", out, paths.values())
    archive_outdated(job, paths, basis)
    # Archiving may have removed the folder of the sheets, so the folders are made afterwards.
    _make_folders([*tasks.cogs, *tasks.drawn], out)
    with _crs_code(job) as crs_code:  # A thread searches for the code while the workers write.
        made = _write(job, "export", tasks.at_once, out, earlier)
    if tasks.overview and OVERVIEW not in made:
        # It would show earlier classes or other clouds than those beside it.
        archive_unwritten(job, OVERVIEW)
    job.store.drop_records()
    _report_files(job, tasks, made)
    mosaics = [*tasks.mosaics, *_cut_tasks(gridding, made, out, labelled.noise_m)]
    if mosaics or job.store.committed("mosaic"):
        mosaics += index_tasks(tasks.cogs, made, out)
        _make_folders(mosaics, out)
        made |= _write(job, "mosaic", mosaics, out, earlier)
    catalogue = list(catalogue_tasks(gridding, sources, labelled.kind, made, out, crs_code()))
    job.results.crs_code = crs_code()
    job.results.dates = survey_dates(written_clouds(job.plan, sources, made), sources)
    _make_folders(catalogue, out)
    made |= _write(job, STAGE, catalogue, out, earlier)
    _record_files(job, paths, basis)
    _validate_outputs_exist(job)
    products = [*tasks.cogs, *tasks.drawn, *mosaics, *catalogue]
    if not all(task.key in made for task in products):
        raise ProcessingError(
            f"{job.record.failed[-1].key} could not be written: {job.record.failed[-1].error}"
        )
    report_changes(job, gridding)


def _file_tasks(
    job: Job,
    gridding: Gridded,
    sources: list[Source],
    spooled: Commits,
    labelled: Labelled,
) -> FileTasks:
    """Return the tasks of all files but those of the index of the sheets and of the catalogue."""
    out = job.products
    digest = digest_of(sorted(source.content for source in sources))
    clouds: list[Task] = []
    overview: list[Task] = []
    if job.plan.writes_overview:
        overview.append(overview_task(gridding, sources, labelled.digests, out))
    if job.plan.writes_clouds:
        clouds += classified_tasks(gridding, sources, spooled, labelled.digests, out)
        report_earlier_classes(job, clouds)
    return FileTasks(
        cogs=list(cog_tasks(gridding, inputs_of(sources, spooled), digest, out)),
        drawn=[
            *legend_tasks(gridding, out),
            *vector_tasks(gridding, out, labelled.noise_m),
            review_task(job, gridding, out),
        ],
        clouds=clouds,
        overview=overview,
        mosaics=list(mosaic_tasks(gridding, digest, out)),
    )


def _cut_tasks(gridding: Gridded, made: Commits, out: str, noise_m: float) -> Iterator[Task]:
    """Yield the tasks that cut the vector products to sheets, with the intervals of those that were written."""
    found = {
        name: float(made[f"{name}.gpkg"][1]["interval"])
        for name in gridding.plan.config.drawn
        if f"{name}.gpkg" in made
    }
    yield from sheet_tasks(gridding, out, noise_m, found)


def _paths(gridding: Gridded, tasks: FileTasks, out: str) -> dict[str, str]:
    """Return the path in OUT of each file that the run writes, by the key of its task."""
    files = _files([*tasks.at_once, *tasks.mosaics])
    for name in gridding.plan.config.drawn:
        cut = sheet_files(gridding, name, out)
        files |= {key: file.location for key, (file, _) in cut.items()}
    paths = {key: below(out, location) for key, location in files.items()}
    if tasks.mosaics:
        paths[SHEETS] = SHEETS
    return {**paths, **planned(gridding)}


@contextmanager
def _crs_code(job: Job) -> Iterator[Callable[[], str | None]]:
    """Yield a function that returns the code of the horizontal CRS, for which a thread searches meanwhile.

    The store keeps the code, so that a run without new results does not search for it again.
    """
    known = job.store.get_state("crs")
    if known:
        yield lambda: known["code"]
        return
    with ThreadPoolExecutor(1) as meanwhile:
        search = meanwhile.submit(horizontal_code, job.plan.frame.crs_wkt)
        yield search.result
    job.store.put_state("crs", {"code": search.result()})


def _report_files(job: Job, tasks: FileTasks, made: Commits) -> None:
    """Add the results on classified clouds and vector products to run.json."""
    if tasks.clouds:
        report_written_classes(job, tasks.clouds, made)
    _report_contours(job)
    _report_spots(job)
    _report_outline(job)
    report_review(job)
    if job.results.fetched is not None:
        clouds = [
            CloudRecord.of(made[task.key][1]) for task in tasks.clouds if task.key in made
        ]
        fetched = sum(record.fetched or 0 for record in clouds)
        job.results.fetched = replace(job.results.fetched, classified=fetched)
    if job.plan.inputs.area is not None:
        terrain = [
            task.key
            for task in tasks.cogs
            if task.arguments["info"].product == "dtm" and task.key in made
        ]
        filled = sum(RasterFileRecord.of(made[key][1]).valid for key in terrain)
        job.results.dtm = replace(job.results.dtm, filled=filled)


def _record_files(job: Job, paths: Mapping[str, str], basis: str) -> None:
    """Record from which data the products were made, and which files may still be those of an earlier run."""
    # The virtual cloud is valid as long as the clouds are, which have no basis in run.json.
    products = [
        path for key, path in paths.items() if key.endswith(PRODUCTS) and path != VIRTUAL
    ]
    job.results.made_of = {**job.results.made_of, **dict.fromkeys(products, basis)}
    # If a task failed, the file of an earlier run may still be there.
    unwritten = [path for path in paths.values() if path not in job.results.outputs]
    sizes = sizes_at([joined(job.products, path) for path in unwritten])
    job.results.earlier_outputs = {
        path: None for path, size in zip(unwritten, sizes, strict=True) if size is not None
    }


def _make_folders(tasks: list[Task], out: str) -> None:
    for folder in {task.arguments["to"].out for task in tasks if not is_url(out)}:
        try:
            Path(folder).mkdir(exist_ok=True)
        except OSError as error:
            raise write_error(folder, error, Path(out)) from error


def _report_outline(job: Job) -> None:
    commit = job.store.committed("export").get(OUTLINE)
    outline = job.results.outline
    if commit is not None and outline is not None:
        record = OutlineFileRecord.of(commit[1])
        job.results.outline = replace(
            outline, rings=record.rings or [], polygons=record.polygons
        )


def _report_contours(job: Job) -> None:
    commit = job.store.committed("export").get(f"{CONTOURS}.gpkg")
    if CONTOURS not in job.plan.config.drawn or commit is None:
        return
    record, unit = ContoursRecord.of(commit[1]), short_unit(job.plan.frame.units.vertical)
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
            f"{record.cut:,}",
            Detail,
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
        files = listed([joined(job.products, path) for path in gone], 1, "files")
        raise ProcessingError(
            f"{files}: removed during the run; run again to make the missing files"
        )


def _basis(gridding: Gridded) -> str:
    """Return the digest of everything from which the products are made: points, labels and settings.

    Settings that only change the format of the files are not in it.
    """
    config = gridding.plan.config
    terrain = [[key, digest] for key, (digest, _) in sorted(gridding.made[OUTLINED].items())]
    into: Any = config.product_name
    if config.sheets is not None:
        drawn = [[sheet.name, sheet.area.key] for sheet in gridding.plan.inputs.sheets]
        cut = sides_text(config.sheets, str) if isinstance(config.sheets, Sides) else drawn
        into = [cut, config.sheet_template, config.product_name, config.empty_sheets]
    return digest_of(
        terrain,
        config.voids,
        config.outline,
        str(config.spike),
        into,
        gridding.plan.inputs.area_key,
        gridding.waters.stored_key,
    )


def _files(tasks: list[Task]) -> dict[str, str]:
    """Return the path or URL of the file that each task writes, by the key of the task."""
    values = {task.key: task.arguments for task in tasks}
    return {
        key: str(of_task["cloud"].out if "cloud" in of_task else of_task["to"].location)
        for key, of_task in values.items()
    }


def _write(
    job: Job, stage: str, tasks: list[Task], out: str, earlier: Mapping[str, str]
) -> Commits:
    """Write the files that are missing or were changed, and return the commits of all files that were written.

    ``earlier`` has the digests of the files before this run. If the run that wrote a file was killed, it has none.
    """
    files = _files(tasks)
    invalidate_changed_outputs(job, stage, files)
    has_clouds = any("cloud" in task.arguments for task in tasks)
    kernels = class_kernels(job.plan) if has_clouds else None
    written = run_stage(job, stage, tasks, kernels, writes_out=True)
    sizes, digests = dict(job.results.outputs), dict(job.results.digests)
    notes: dict[str, None] = {}
    for key, (_, stored) in written.items():
        path, record = below(out, files[key]), FileRecord.of(stored)
        sizes[path] = record.bytes
        if record.digest is not None:
            digests[path] = record.digest
        notes |= dict.fromkeys(record.notes or ())
    replaced = [path for path, digest in digests.items() if digest != earlier.get(path)]
    archive_sidecars(job, replaced)
    job.results.outputs, job.results.digests = sizes, digests
    for text in notes:
        job.note(text)
    return written
