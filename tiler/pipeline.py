"""The whole job in order: plan, ingest (spool, assemble), filter, grid, export, run.json. Read this page first."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from ptd.kernel import cache_refusal
from tiler.config import RunConfig
from tiler.errors import ConfigError, CorruptStoreError, ProcessingError, exit_code_of
from tiler.export.stage import export
from tiler.export.tasks.outdated import WRITING
from tiler.filter.stage import filter_points
from tiler.grid.stage import grid
from tiler.grid.tasks.correct import correct
from tiler.grid.tasks.raster_table import required_rasters
from tiler.ingest.stage import assemble, spool
from tiler.ingest.tasks.fingerprints import register_sources
from tiler.inputs import SourceInfo
from tiler.io.locations import is_url, joined, local_or_url, upload_file, with_slashes
from tiler.io.overwrite_check import check_names
from tiler.io.result_folder import (
    EVENTS,
    REPORT,
    RUN,
    STORE,
    WATER,
    earlier_facts,
    earlier_outputs,
    local_folder,
    read_run,
)
from tiler.observe.events import (
    ExpectedStage,
    JobStarted,
    Listener,
    Note,
    RunFinished,
    Warned,
    combine,
    ignore_events,
    redacting,
)
from tiler.observe.json_lines import EventLog
from tiler.plan import (
    Plan,
    make_plan,
    remember,
    settled,
    settled_by,
    stage_seconds,
    water_is_given,
)
from tiler.plan.drawn_sheets import validate_on_clouds
from tiler.preparation import prepare_workers
from tiler.redaction import without_secrets
from tiler.report.html import write_report
from tiler.report.runfile import record_end
from tiler.runs.job import Job, LeaseWatch, RunResult
from tiler.runs.repair import ROUNDS, repair
from tiler.schedule import fork_server_running, import_dask
from tiler.store import (
    Lease,
    TileStore,
    create_store,
    held_store,
    locked_folder,
    open_store,
    remove_store,
    store_exists,
)

STAGES = ("ingest", "filter", "grid", "export")


# Children that read headers and children that do tasks share the imports.
@fork_server_running()
def run(
    inputs: Sequence[str],
    out: str | Path,
    config: RunConfig | None = None,
    listener: Listener = ignore_events,
    until: str = "export",
    known: Sequence[SourceInfo] = (),
    finest: Fraction | None = None,
) -> RunResult:
    """Make terrain from clouds, or resume the run in ``out``.

    Parameters
    ----------
    inputs : sequence of str
        Files, folders, globs or URLs of clouds.
    out : path
        Folder of the results, which is made if it does not exist, or a URL. For a URL of another machine, run.json, the
        log and the report are in a local folder named after the last part of the URL, and are copied to the URL at the
        end.
    config : RunConfig
    listener : callable
        Listener of events, see `tiler.observe.events`.
    until : str
        Last stage to run: ``ingest``, ``filter``, ``grid`` or ``export``.
    known : sequence of SourceInfo
    finest : Fraction, optional
        Inputs that were inspected before, and the finest resolution of the survey, see `tiler.plan.make_plan`.

    Raises
    ------
    TilerError
        The run failed. The error has the exit code of the command. Finished work is kept.
    """
    config, products = config or RunConfig(), local_or_url(out)
    _check(config, products, until)
    out, started = local_folder(products), time.monotonic()
    if prepare_workers(config, products):
        import_dask()  # The import runs while the headers are read.
    plan = make_plan(inputs, config, products, known, finest)
    with _opened(plan, inputs, out, products, listener) as job:
        # Stages replace the plan of the job when they decide what it leaves open.
        plan = job.plan
        _tell(job, until)
        try:
            _repaired(job, partial(_stages, job, until))
        except BaseException as error:
            _record_failure(job, error)
            raise
        finally:
            job.compiler.close()
            job.executors.close()
        result = _finished(job, plan, until, started)
        url = job.store.url
        if config.clean_store and until == "export" and (left := remove_store(url)):
            listener(
                Note(f"{url}: the store was deleted; other files stay there: {', '.join(left)}")
            )
    return result


def _check(config: RunConfig, products: str, until: str) -> None:
    """Raise ConfigError if the arguments of a run cannot be used."""
    if until not in STAGES:
        raise ConfigError(f"until {until!r}: no such stage; use {', '.join(STAGES)}")
    if not products:
        raise ConfigError("-o: has no name; give a folder for the results")
    check_names("-o", products)
    check_names("--store", config.store or products)


@contextmanager
def _opened(
    plan: Plan, inputs: Sequence[str], out: Path, products: str, listener: Listener
) -> Iterator[Job]:
    """Yield the job of a plan, with its folder, its store, and the locks of both."""
    _make_folder(out)
    if not is_url(products):
        products = str(out.resolve())  # Workers have other current folders.
    url = plan.config.store or joined(products, STORE)
    with _held(out, products, url) as leases, _copied(out, products):
        plan, store = _with_store(plan, url)
        # A store of several OUT has commits of the files of each. The store in an OUT moves with it.
        store.keep_apart(WRITING, products if plan.config.store else "")
        if plan.config.store:
            store.use_rasters(str(plan.grid.resolution))
        job = Job(plan, out, products, store, redacting(listener), LeaseWatch(leases))
        job.results.products_at = products if is_url(products) else None
        job.results.report_title = (read_run(products) or {}).get("report_title")
        job.results.given = [with_slashes(source) for source in inputs]
        earlier = earlier_outputs(out, products)
        if water_is_given(plan.config, products):
            earlier.pop(WATER, None)
        job.results.earlier_outputs = earlier
        facts = earlier_facts(out, products)
        job.results.digests, job.results.delivered = facts.digests, facts.delivered
        job.earlier_settings = facts.settings
        job.earlier_notes = () if plan.config.overwrite else facts.notes
        # run.json is written first, since it shows that the later files belong to this run.
        job.save("running")
        with EventLog(out / EVENTS) as log:
            job.listener = redacting(combine(listener, log, job.record.keep_warning))
            yield job


@contextmanager
def _held(out: Path, products: str, url: str) -> Iterator[tuple[Lease, ...]]:
    """Hold the locks of OUT and of the store, since two runs on the same OUT may have different stores."""
    with ExitStack() as held:
        folders = [
            held.enter_context(locked_folder(p))
            for p in dict.fromkeys((str(out.resolve()), products))
        ]
        yield (*folders, held.enter_context(held_store(url)))


@contextmanager
def _copied(out: Path, products: str) -> Iterator[None]:
    """Copy run.json, the log and the report to the products if these are at a URL, even if the run fails."""

    def copy() -> None:
        for path in (out / name for name in (RUN, EVENTS, REPORT)) if is_url(products) else ():
            if path.is_file():
                upload_file(path, joined(products, path.name))

    try:
        yield
    except BaseException:
        with suppress(ProcessingError):  # The error that ended the run is reported.
            copy()
        raise
    copy()


def _tell(job: Job, until: str) -> None:
    """Tell the listener what the plan says, and which stages follow."""
    plan, listener = job.plan, job.listener
    for text in plan.notes:
        job.tell(text)
    left_out = [
        f"{path}: left out: {error.removeprefix(f'{path}: ')}"
        for path, error in plan.inputs.left_out
    ]
    for text in (*left_out, *plan.warnings):
        listener(Warned(text))
    if refusal := cache_refusal():
        job.note(refusal)
    if plan.method.candidate_cell_m and not plan.on_candidates:
        job.note(
            f"passes read all points: the store has one candidate per cell of {float(plan.grid.fine_m):g} m, "
            f"which does not divide the method's cells of {plan.method.candidate_cell_m:g} m; "
            "--overwrite rebuilds the store for this method"
        )
    if is_url(job.products):
        job.note(
            f"{RUN}, {EVENTS} and {REPORT} are in {job.out}; copies go to {job.products} when the run ends"
        )
    listener(JobStarted(expected_stages(plan, until)))


def expected_stages(plan: Plan, until: str) -> list[ExpectedStage]:
    """Return the stages of a run up to the stage ``until``, with their expected times."""
    seconds = stage_seconds(plan, [raster.stage for raster in required_rasters(plan)], until)
    return [
        ExpectedStage(stage=s, title=plan.method.title_of(s), seconds=round(t, 3))
        for s, t in seconds.items()
    ]


def _record_failure(job: Job, error: BaseException) -> None:
    """Write to run.json that an error ended the run."""
    code = exit_code_of(error)
    job.record.exit_code = code
    state = "failed" if isinstance(error, Exception) else "interrupted"
    try:
        job.save(state)
    except ProcessingError:
        # A full disk prevents this write, too. The error that ended the run is raised by the
        # caller.
        record_end(job.out, state, code)


def _finished(job: Job, plan: Plan, until: str, started: float) -> RunResult:
    """Save run.json, write the report, and return the result of a run that did all its stages."""
    if until != "export" and job.record.computed and job.results.earlier_outputs:
        job.note(
            f"files in {job.products} are those of an earlier run until `tiler export` or `tiler run` replaces them"
        )
    job.results.seconds = round(time.monotonic() - started, 3)
    remember(plan, job.record.stages)
    incomplete = any(source.is_incomplete for source in plan.inputs.sources)
    job.record.exit_code = 5 if job.record.quarantined or job.record.failed or incomplete else 0
    summary = _report(job)
    job.listener(RunFinished(job.results.seconds))
    return RunResult(
        job.record.exit_code,
        summary,
        job.record.computed == 0,
        without_secrets(job.products),
        plan,
    )


def _report(job: Job) -> dict[str, Any]:
    """Save run.json, write the report, and return the summary. If the report fails, the run is still finished."""
    job.results.report = REPORT
    summary = job.save("done")
    try:
        write_report(job.out, summary, job.products)
    except Exception as error:  # noqa: BLE001 - The results exist after any error of the report.
        text = (
            f"{REPORT} could not be drawn: {error}; run `tiler report {job.out}` to try again"
        )
        job.listener(Warned(text))
        job.record.notes.append(text)
        job.results.report = None
        summary = job.save("done")
    return summary


def _repaired(job: Job, stages: Callable[[], None]) -> None:
    """Run the stages. If objects of the store are damaged, repair it and run the stages again."""
    for number in range(ROUNDS + 1):
        job.record.failed = []
        job.record.quarantined = []
        for path, error in job.plan.inputs.left_out:
            job.record.leave_out(path, error)
        try:
            stages()
            return
        except CorruptStoreError as damage:
            if number == ROUNDS or not damage.keys:
                raise
            repair(job, damage.keys)


def _stages(job: Job, until: str) -> None:
    """Run the stages in their order, up to the stage ``until``."""
    if job.plan.inputs.area is not None:
        job.store.put_area(job.plan.inputs.area)
    sources = register_sources(job)
    if job.plan.config.scheduler is None and not job.store.committed("spool"):
        # Kernels are compiled while the points are read, which does not need kernels.
        job.compiler.begin(job.plan, until)
    spooled, sources = spool(job, sources)
    assembled = assemble(job, sources, spooled)
    # Headers may give a larger extent than that of the points.
    areas = [sheet.area for sheet in job.plan.inputs.sheets]
    validate_on_clouds(job.plan.config, areas, assembled.bounds)
    if until == "ingest":
        return
    labelled = filter_points(job, assembled)
    if until == "filter":
        return
    labelled, corrections = correct(job, assembled, labelled)
    gridding = grid(job, assembled, labelled, corrections)
    if until == "grid":
        return
    export(job, gridding, sources, spooled, labelled)


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"-o {out}: cannot be made ({error.strerror}); give a folder that can be written"
        ) from error


def _with_store(plan: Plan, url: str) -> tuple[Plan, TileStore]:
    """Return the plan and its store. The lattices and decisions of an existing store replace those of the plan."""
    if plan.config.overwrite or not store_exists(url):
        return plan, create_store(
            url, plan.grid.meta, settled(plan), anew=plan.config.overwrite
        )
    store = open_store(url)
    return settled_by(plan, store), store
