"""Stage ingest of a run, which decodes the sources and assembles their points into buckets."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from functools import reduce
from pathlib import Path

from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell
from tiler.core.points import sum_by_class
from tiler.core.records import SpoolRecord, TileRecord, buckets_in
from tiler.core.results import ClassCounts, FetchedBytes, PointCounts, Stray, SurveyResult
from tiler.core.selection import WITHHELD
from tiler.core.units import in_unit_of_crs
from tiler.core.words import counted, listed
from tiler.errors import InputError, ProcessingError
from tiler.ingest.assemble import BucketParts
from tiler.ingest.spool import OUTSIDE_AREA
from tiler.ingest.strays import Strays
from tiler.ingest.tasks.points import (
    assemble_tasks,
    fragments_of,
    parts_of_buckets,
    spool_tasks,
    strays_of,
)
from tiler.ingest.tasks.surveys import (
    FoundSurveys,
    Surveys,
    found_surveys,
    survey_results,
    survey_tasks,
    with_outranked,
)
from tiler.inputs import FAR
from tiler.io.locations import is_url, with_slashes
from tiler.observe.events import Detail, Note, TaskFailed, Warned
from tiler.plan import KEEP, Plan, bounds_of, settled_by_points, sparse_raster_remedy
from tiler.runs.compiling import SORT_KERNELS
from tiler.runs.found import IngestResult, Source, by_source, source_of, surveys_of_sources
from tiler.runs.job import Job
from tiler.runs.stage_runner import run_stage
from tiler.schedule import Task
from tiler.store import BucketInfo, Commits

OWN_FAULTS = (
    "ProcessingError",
    "StoreError",
    "CorruptStoreError",
    "OSError",
    "PermissionError",
    "FileNotFoundError",
)
"""Kinds of errors that are not caused by an input. A faulty input raises InputError, or ends
its process."""

MAX_STEP_M = 0.15
"""Largest step in metres between two surveys that is not warned of."""
SPARSE = 4
"""Ratio of densities from which a warning tells that the sparser survey counts before the denser one."""
MIN_STEP_CELLS = 100
"""Minimum number of cells from which a step is warned of."""

MANY = 0.05
"""Share of the points above which a note reports that a class is excluded from filtering, since
producers may use the number of the class differently."""


def spool(job: Job, sources: list[Source]) -> tuple[Commits, list[Source]]:
    """Decode the sources into the spool. Return the commits of the good sources, and these sources.

    A source is left out as bad if one of its pieces failed or its points are misplaced.

    Raises
    ------
    InputError
        No source is left, all points were dropped, or a source is misplaced and the run stops on errors.
    ProcessingError
        A task failed because of the store or the system, or any task failed and the run stops on errors.
    """
    spooled = run_stage(job, "spool", spool_tasks(job.plan, sources, _keeps_records(job)))
    failed = [task for task in job.record.failed if task.stage == "spool"]
    _raise_system_faults(failed)
    bad = {source_of(task.key): task.error for task in failed}
    job.record.failed = [task for task in job.record.failed if task.stage != "spool"]
    bad |= _misplaced(job, [s for s in sources if s.name not in bad], spooled)
    good = [s for s in sources if s.name not in bad]
    left_out = [(str(s.info.path), bad[s.name]) for s in sources if s.name in bad]
    for path, error in left_out:
        job.record.leave_out(path, error)
    # The error of a worker that died does not contain the path of the file.
    lines = [f"{path}: left out: {error.removeprefix(f'{path}: ')}" for path, error in left_out]
    if not good:
        raise InputError(f"no input could be read; the first error: {lines[0]}")
    for text in lines:
        job.listener(Warned(text))
    spooled = {k: c for k, c in spooled.items() if source_of(k) not in bad}
    records = [SpoolRecord.of(stored) for _, stored in spooled.values()]
    dropped: Counter[str] = Counter()
    unselected: Counter[str] = Counter()
    for record in records:
        dropped.update(record.dropped)
        unselected.update(record.unselected)
    read, stored = (
        sum(record.read for record in records),
        sum(record.stored for record in records),
    )
    rounding = max(record.largest_rounding for record in records)
    job.results.counts = PointCounts(
        read=read,
        stored=stored,
        dropped=dict(dropped),
        unselected={key: count for key, count in unselected.items() if count},
        largest_rounding=rounding,
    )
    stored_of = {
        name: sum(r.stored for r in pieces) for name, pieces in by_source(spooled).items()
    }
    job.results.inputs = [
        {**s.info.to_json(), "content": s.content, "stored": stored_of.get(s.name, 0)}
        for s in sources
    ]
    if any(is_url(s.info.path) for s in sources):
        points = sum(record.fetched for record in records)
        job.results.fetched = FetchedBytes(
            plan=sum(s.fetched for s in job.plan.inputs.sources), points=points
        )
    if rounding > 0:
        job.note(
            f"the filter's coordinates were rounded by up to {rounding:.3g} CRS units; classified clouds keep the "
            "exact ones",
            Detail,
        )
    for reason, count in dropped.items():
        job.note(f"{count:,} points left out: {reason}")
    reasons = dict(job.plan.config.selection.options)
    if unselected[WITHHELD]:
        reasons[WITHHELD] = "flag withheld (--withheld keep treats these points like others)"
    for key, reason in reasons.items():
        job.note(
            f"{reason}: {unselected[key]:,} of the points read are neither filtered nor gridded; the clouds keep them"
        )
    if stored == 0:
        files = listed([str(s.info.path) for s in good], 5, "files")
        raise InputError(
            f"{files}: all {read:,} points were dropped ({', '.join(dropped)}): nothing is left to make a terrain of; "
            "check their coordinates and the offsets of their headers"
        )
    return spooled, good


def _raise_system_faults(failed: Sequence[TaskFailed]) -> None:
    """Raise ProcessingError if a task failed because of the store or the system."""
    for task in failed:
        if task.kind in OWN_FAULTS:
            raise ProcessingError(f"{task.title} {task.key}: {task.error}")


def _keeps_records(job: Job) -> bool:
    """Return whether records are kept for the classified clouds.

    They are kept only in a store on this machine, where reading them costs nothing.
    """
    return job.plan.writes_clouds and not job.plan.config.salvage and not is_url(job.store.url)


def _misplaced(job: Job, sources: list[Source], spooled: Commits) -> dict[str, str]:
    """Return the reason for each misplaced source by its name.

    The points of such a source lie beyond the frame, or so far outside its expected bounds that
    the raster would be too large. Raise InputError if the run stops on errors, or no source is
    left.
    """
    records = by_source(spooled)
    # Sources without pieces have no part near the area.
    sources = [s for s in sources if s.name in records]
    held = {
        s.name: sum(r.stored + r.dropped.get(OUTSIDE_AREA, 0) for r in records[s.name])
        for s in sources
    }
    if not any(held.values()):
        return {}
    reasons = {
        s.name: f"all its {s.info.points:,} points lie beyond the range of a run; check its scales and offsets"
        for s in sources
        if not held[s.name]
    }
    if job.plan.config.sheets is None:
        reasons |= _far_away(
            job.plan, None if is_url(job.products) else Path(job.products), sources, spooled
        )
    if reasons and (job.plan.config.on_error == "stop" or len(reasons) == len(sources)):
        source = next(s for s in sources if s.name in reasons)
        raise InputError(f"{source.info.path}: {reasons[source.name]}")
    return reasons


def _far_away(
    plan: Plan, out: Path | None, sources: list[Source], spooled: Commits
) -> dict[str, str]:
    """Return a reason for each source with points far outside of the bounds in its header, by its name.

    The result is empty unless the raster of all points would be too large.
    """
    records, lattice = by_source(spooled), plan.buckets
    expected = {
        s.name: bounds_of(s.info).pad(lattice.p + int(FAR) * COUNTS_PER_UNIT) for s in sources
    }
    doubtful = [
        s
        for s in sources
        if any(
            r.bounds and expected[s.name].union(Bounds.from_json(r.bounds)) != expected[s.name]
            for r in records[s.name]
        )
    ]
    strays = strays_of(plan, doubtful, spooled)
    extents: dict[str, Bounds] = {}
    for source in doubtful:
        source_strays = strays.get(source.number, Strays())
        cells = {
            Cell(ix, iy) for r in records[source.name] for ix, iy, _ in r.buckets
        } - source_strays.alone
        hull = lattice.hull(cells) if cells else expected[source.name]
        hull = hull if source_strays.extent is None else hull.intersection(source_strays.extent)
        if expected[source.name].union(hull) != expected[source.name]:
            extents[source.name] = hull
    extent = reduce(Bounds.union, extents.values(), plan.inputs.extent)
    if plan.inputs.area is not None:
        extent = extent.intersection(plan.inputs.area.bounds)
    wider = dataclasses.replace(plan, inputs=dataclasses.replace(plan.inputs, extent=extent))
    remedy = sparse_raster_remedy(wider, out) if extents else None
    if remedy is None:
        return {}
    return dict.fromkeys(
        extents, f"holds points far outside of the bounds that its header gives: {remedy}"
    )


def assemble(job: Job, sources: list[Source], spooled: Commits) -> IngestResult:
    """Assemble the points into buckets, and report duplicates, strays and excluded classes."""
    fragments = fragments_of(spooled)
    buckets = parts_of_buckets(job.plan, fragments, strays_of(job.plan, sources, spooled))
    surveys = surveys_of_sources(job.plan, sources)
    found = FoundSurveys()
    if surveys:
        found = _find_surveys(job, sources, spooled, buckets, surveys)
        buckets = list(with_outranked(job.plan, buckets, found, surveys))
    tasks = list(assemble_tasks(job.plan, spooled, buckets))
    done, stale = job.split_commits("assemble", tasks)
    _forget_labels(job, stale)
    job.invalidate("assemble", stale)
    job.store.allocate(
        {cell: sum(stop - start for _, start, stop in runs) for cell, runs in fragments.items()}
    )
    _bring_back(job, sources, [task for task in tasks if task.key not in done])
    commits = run_stage(job, "assemble", tasks, SORT_KERNELS)
    assembled = IngestResult.of(commits)
    if not commits:
        raise ProcessingError(
            f"no bucket could be written; the first error: {job.record.first_error('assemble')}"
        )
    area = job.plan.inputs.area
    if area is not None and area.bounds.intersection(assembled.bounds).empty:
        raise InputError(
            "no point of the clouds lies in the area, though some lie near it; give another area"
        )
    job.store.publish_index(
        {c: BucketInfo(r.n, r.n_candidates) for c, r in assembled.records.items()}
    )
    records = assembled.records.values()
    within = sum(record.duplicates["within"] for record in records)
    between = sum(record.duplicates["between"] for record in records)
    taking = sum(record.n_participating for record in records)
    job.results.counts = dataclasses.replace(
        job.results.counts,
        duplicates_within_files=within,
        duplicates_between_files=between,
        participating=taking,
        kept_out=job.results.counts.stored - taking,
        buckets=len(assembled.records),
    )
    _settle_grid(job, assembled, complete=len(commits) == len(tasks))
    _report_unfiltered(job, assembled)
    _report_strays(job, sources, assembled)
    if surveys:
        _report_surveys(job, assembled, surveys, found, spooled)
    if within or between:
        job.note(
            f"{counted(within + between, 'duplicate point')} left out of the filter; each gets the class of the point "
            "that it repeats",
            Detail,
        )
    return assembled


def _find_surveys(
    job: Job,
    sources: list[Source],
    spooled: Commits,
    buckets: list[BucketParts],
    surveys: Surveys,
) -> FoundSurveys:
    """Find where each survey has points. Raise ProcessingError if a task failed, since more points would count."""
    tasks = list(survey_tasks(job.plan, spooled, buckets, surveys))
    done, _ = job.split_commits("surveys", tasks)
    _bring_back(job, sources, [task for task in tasks if task.key not in done])
    commits = run_stage(job, "surveys", tasks)
    if len(commits) < len(tasks):
        raise ProcessingError(
            f"the cells of surveys could not be found; the first error: {job.record.first_error('surveys')}"
        )
    return found_surveys(commits, buckets, surveys)


def _report_surveys(
    job: Job,
    assembled: IngestResult,
    surveys: Surveys,
    found: FoundSurveys,
    spooled: Commits,
) -> None:
    """Report what each survey gives, and the steps between surveys."""
    stored = {
        int(name[1:]): sum(record.stored for record in pieces)
        for name, pieces in by_source(spooled).items()
    }
    records = assembled.records.values()
    results = survey_results(job.plan, found, records, surveys, stored)
    job.results.surveys = results
    n_hidden = sum(result.points - result.used for result in results)
    job.results.counts = dataclasses.replace(
        job.results.counts, unselected={**job.results.counts.unselected, "priority": n_hidden}
    )
    job.note(
        f"--priority {job.plan.config.priority}: {n_hidden:,} of the points read are neither filtered nor gridded, "
        "because another survey counts at their place; the clouds keep them"
    )
    for number, result in enumerate(results):
        _report_steps(job, result)
        denser = [
            other for other in results[:number] if SPARSE * other.density < result.density
        ]
        if denser and result.used < result.points:
            others = ", ".join(f"{o.name} ({o.density:.2g} points/m2)" for o in denser)
            job.doubt(
                f"{others} counts before {result.name} ({result.density:.2g} points/m2), which is much denser; "
                "give --priority FILE if the denser survey is better"
            )


def _report_steps(job: Job, result: SurveyResult) -> None:
    """Report the steps of a survey to those that count more. Warn of large ones."""
    if result.used < result.points and not result.steps:
        job.note(
            f"survey {result.name}: no step to other surveys was measured, as no flat cell has three points of both"
        )
    for step in result.steps:
        side = "below" if step.median_m < 0 else "above"
        text = (
            f"survey {result.name} lies {abs(step.median_m):.2f} m {side} {step.other} (median of "
            f"{counted(step.cells, 'flat cell')} with points of both, MAD {step.mad_m:.2f} m)"
        )
        if abs(step.median_m) <= MAX_STEP_M or step.cells < MIN_STEP_CELLS:
            job.note(text)
            continue
        remedy = "check whether both have the same vertical datum, and shift one of them"
        job.doubt(in_unit_of_crs(f"{text}; {remedy}", job.plan.frame.units))


def _settle_grid(job: Job, assembled: IngestResult, complete: bool) -> None:
    """Decide the default pixel from the points, and report it if it is not that of the plan."""
    records = assembled.records
    n_dropped = sum(
        n for reason, n in job.results.counts.dropped.items() if reason != OUTSIDE_AREA
    )
    n_points = sum(record.n for record in records.values()) + n_dropped
    measured = {cell: record.n_measured for cell, record in records.items()}
    before = job.plan.notes
    job.plan = settled_by_points(job.plan, job.store, measured, n_points, complete)
    for text in job.plan.notes:
        if text not in before:
            job.note(text)


def _report_unfiltered(job: Job, assembled: IngestResult) -> None:
    """Count the input points per class, and report classes with many points that are not filtered."""
    config = job.plan.config
    input_counts = sum_by_class(bucket.classes for bucket in assembled.records.values())
    unfiltered_classes = () if config.method == KEEP else config.keep_classes
    unfiltered_counts = {
        code: n
        for code, n in input_counts.items()
        if int(code) in unfiltered_classes and int(code) not in config.drop_classes
    }
    job.results.classes = ClassCounts(input=input_counts, no_part=unfiltered_counts)
    points = sum(input_counts.values())
    for code, n in unfiltered_counts.items():
        if n > MANY * points:
            other_classes = (
                ",".join(str(c) for c in config.keep_classes if c != int(code)) or "none"
            )
            job.note(
                f"{n / points:.1%} of the points ({n:,}) are of class {code} and are not filtered, so they keep it; if "
                f"the class has another meaning in these clouds, use --keep-classes {other_classes} to filter them"
            )


def _bring_back(job: Job, sources: list[Source], todo: list[Task]) -> None:
    """Decode again the pieces that buckets need and that `tiler clean` removed."""
    needed = {
        piece
        for task in todo
        for bucket in task.arguments["buckets"]
        for piece, *_ in bucket.fragments
    }
    gone = needed - job.store.pieces() if needed else set()
    if gone:
        job.note(
            f"{len(gone)} parts of the decoded points are gone from the store; they are decoded again",
            Note,
        )
        job.invalidate("spool", gone)
        run_stage(job, "spool", spool_tasks(job.plan, sources, _keeps_records(job)))


def _report_strays(job: Job, sources: list[Source], assembled: IngestResult) -> None:
    """List the stray points in run.json, and report their number."""
    paths = {source.number: with_slashes(source.info.path) for source in sources}
    strays: list[Stray] = []
    for record in assembled.records.values():
        for number, row, x, y, z in record.strays:
            strays.append(Stray(paths[number], row, x, y, z))
    job.results.counts = dataclasses.replace(job.results.counts, strays=len(strays))
    job.results.strays = strays
    if strays:
        job.note(
            "not filtered, because far from all others or outside of the bounds of their file: "
            f"{counted(len(strays), 'point')} (strays in run.json)"
        )


def _forget_labels(job: Job, stale: Commits) -> None:
    """Invalidate the tiles of rewritten buckets, since a bucket that is moved to other rows loses its labels."""
    cells = {
        tuple(bucket.cell) for _, stored in stale.values() for bucket in buckets_in(stored)
    }
    for number in range(job.store.get_state("passes") or 0):
        stage = f"filter{number}"
        tiles = job.store.committed(stage) if cells else {}
        keys = []
        for key, (_, stored) in tiles.items():
            if not cells.isdisjoint(map(tuple, TileRecord.of(stored).cells)):
                keys.append(key)
        job.invalidate(stage, keys)
