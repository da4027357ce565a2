"""Execution of the tasks of a stage that are not done yet, with a report on each outcome."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from tiler.core.results import StageResult
from tiler.errors import CorruptStoreError, DiskFullError, ProcessingError, StoreAccessError
from tiler.observe.events import StageFinished, StageStarted, TaskAgain, TaskDone, TaskFailed
from tiler.runs import record
from tiler.runs.compiling import Kernels
from tiler.runs.job import Job
from tiler.schedule import Outcome, Task
from tiler.schedule.worker import run_task
from tiler.store import Commits, store_exists

PACKED_COMMITS = 256
"""Minimum number of commits of a finished stage that are packed into one object, since each
costs a request."""

Join = Callable[[list[Task], int], list[Task]]
"""Function ``join(tasks, workers)`` that joins tasks into larger ones with parts."""


def run_stage(
    job: Job,
    stage: str,
    tasks: Iterable[Task],
    kernels: Kernels | None = None,
    writes_out: bool = False,
    join: Join | None = None,
) -> Commits:
    """Run the tasks of a stage that are not done yet.

    Parameters
    ----------
    job : Job
    stage : str
    tasks : iterable of Task
    kernels : Kernels, optional
        Kernels that the stage uses. They are compiled first, because otherwise each local worker would compile them.
    writes_out : bool
        Whether the tasks write files into OUT.
    join : callable, optional
        Function that joins tasks that are cheaper together.

    Returns
    -------
    Commits
        Commits of all tasks that succeeded, in this run or earlier.

    Raises
    ------
    CorruptStoreError
        Objects of the store could not be read. All other tasks were tried.
    ProcessingError
        A task failed and ``--on-error`` is ``stop``, or the store or OUT was removed.
    """
    wanted = {task.key: task for task in tasks}
    done, stale = job.split_commits(stage, wanted.values())
    job.invalidate(stage, stale)
    todo = [task for key, task in wanted.items() if key not in done]
    begin = StageStarted(
        stage=stage,
        title=job.plan.method.title_of(stage),
        tasks=len(wanted),
        done=len(done),
        points=sum(t.points for t in todo),
        pixels=sum(map(_pixels, todo)),
        by_pixels=any(t.pixels for t in todo),
    )
    if stage.startswith(record.PLACED) and len(wanted) <= record.LISTED_TILES:
        job.record.list_tiles(stage, wanted.values(), done)
    if todo and kernels is not None and job.plan.config.scheduler is None:
        job.compiler.finish(kernels)
    job.listener(begin)  # The kernels come first, so that the stage's time excludes them.
    start = time.monotonic()
    peak_rss = 0
    damaged = set[str]()
    for outcome in _outcomes(job, todo, writes_out, join):
        job.record.update_tile(outcome)
        _report(job, outcome)
        job.ownership.check()
        damaged.update(outcome.damaged)
        peak_rss = max(peak_rss, outcome.peak_rss_bytes)
        if outcome.record is not None:
            done[outcome.task.key] = (outcome.task.digest, outcome.record)
    if damaged:
        keys = tuple(sorted(damaged))
        raise CorruptStoreError(
            f"{job.store.url}: {', '.join(keys)}: damaged or missing; run again", keys
        )
    seconds = round(time.monotonic() - start, 3)
    job.record.computed += len(todo)
    job.store.compact(stage, PACKED_COMMITS)
    job.record.stages[stage] = StageResult(
        stage=stage,
        title=begin.title,
        tasks=begin.tasks,
        done=begin.done,
        points=begin.points,
        pixels=begin.pixels,
        computed=len(todo),
        seconds=seconds,
        peak_rss_bytes=peak_rss,
    )
    job.listener(StageFinished(stage, seconds))
    job.save_if_due()
    return dict(sorted(done.items()))


def _outcomes(
    job: Job, tasks: list[Task], writes_out: bool, join: Join | None
) -> Iterator[Outcome]:
    """Yield the outcomes of single tasks. Joined tasks that fail together are run one by one."""
    if not tasks:
        return
    executor = job.executors.choose(writes_out)
    if join is not None:
        tasks = join(tasks, executor.workers)
    alone: list[Task] = []
    for outcome in executor.run(run_task, job.store.url, tasks):
        parts = outcome.task.parts
        if parts and outcome.record is None:
            if not (outcome.again or outcome.fatal):
                alone += parts
            outcome = replace(outcome, task=parts[0], again=outcome.again or not outcome.fatal)
        yield from outcome.of_parts()
    if alone:
        yield from executor.run(run_task, job.store.url, alone)


def _pixels(task: Task) -> int:
    """Return the number of pixels that a task makes, or 0 if it does not make a raster."""
    return task.pixels or task.makes


def _report(job: Job, outcome: Outcome) -> None:
    """Report a task that is done, retried or failed. Raise an error if the failure ends the run."""
    task = outcome.task
    if outcome.record is not None:
        done = TaskDone(
            stage=task.stage,
            key=task.key,
            points=task.points,
            pixels=_pixels(task),
            seconds=round(outcome.seconds, 3),
            peak_rss_bytes=outcome.peak_rss_bytes,
        )
        job.listener(done)
        return
    title = job.plan.method.title_of(task.stage)
    error, error_kind = outcome.error or "", outcome.error_kind or ""
    _validate_folders_exist(job)
    if outcome.fatal and not outcome.again:
        kind = (
            DiskFullError if outcome.error_kind == DiskFullError.__name__ else StoreAccessError
        )
        raise kind(f"{title} {task.key}: {error}")
    if outcome.again or outcome.damaged:
        job.listener(TaskAgain(task.stage, title, task.key, error, error_kind))
        return
    extent = record.extent_of(task)
    failed = TaskFailed(task.stage, title, task.key, error, error_kind, extent)
    job.listener(failed)
    job.record.failed.append(failed)
    if job.plan.config.on_error == "stop":
        raise ProcessingError(
            f"{title} {task.key}: {error}; use --on-error skip to continue without it"
        )


def _validate_folders_exist(job: Job) -> None:
    """Raise ProcessingError if OUT or the store was removed, which is not an error of the task."""
    if not job.out.is_dir():
        gone = str(job.out)
    elif not store_exists(job.store.url):
        gone = job.store.url
    else:
        return
    raise ProcessingError(f"{gone}: was removed during the run; run again to create it anew")
