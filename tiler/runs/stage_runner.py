"""Does the tasks of a stage that are not done yet, and tells what became of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

from tiler.core.frame import COUNTS_PER_UNIT
from tiler.errors import DamagedError, DiskFullError, ProcessingError
from tiler.runs import record
from tiler.runs.compiling import Kernels
from tiler.runs.job import Job
from tiler.runs.worker import perform
from tiler.schedule import Executor, Outcome, Placed, Task
from tiler.store import Commits, store_exists

PACKED_COMMITS = 256
"""From so many commits on, a stage packs them into one object when it ends: each costs a request to read."""


Join = Callable[[list[Task], int], list[Task]]
"""``join(tasks, workers)``: the tasks to do, some of them as parts of others."""


def run_stage(
    job: Job,
    stage: str,
    tasks: Iterable[Task],
    kernels: Kernels | None = None,
    writes_out: bool = False,
    join: Join | None = None,
) -> Commits:
    """Do what is not done yet of a stage; commits of all its tasks that succeeded.

    Parameters
    ----------
    job : Job
    stage : str
    tasks : iterable of Task
    kernels : Kernels, optional
        Those that the stage uses: compiled once, before local workers would each do so.
    writes_out : bool
        The tasks write files into OUT.
    join : callable, optional
        Joins tasks that are cheaper if they are done at once.

    Raises
    ------
    DamagedError
        Objects of the store could not be read; all other tasks are done.
    ProcessingError
        A task failed and ``--on-error stop`` was said, or store or OUT are gone.
    """
    wanted = {task.key: task for task in tasks}
    done, stale = job.sorted_out(stage, wanted.values())
    job.take_back(stage, stale)
    todo = [task for key, task in wanted.items() if key not in done]
    info = {
        "stage": stage,
        "title": job.plan.title_of(stage),
        "tasks": len(wanted),
        "done": len(done),
        "points": sum(t.points for t in todo),
    }
    if stage.startswith(record.PLACED) and len(wanted) <= record.LISTED_TILES:
        job.record.list_tiles(stage, ((task, _place(job, task)) for task in wanted.values()), done)
    if todo and kernels is not None and job.plan.config.scheduler is None:
        job.compiler.finish(kernels)
    job.listener("stage_started", info)  # once its kernels are there: its time is that of the work
    start, peak_rss, damaged = time.monotonic(), 0, set[str]()
    for outcome in _outcomes(job, job.crew.executor(writes_out), todo, join) if todo else ():
        job.record.tell_tile(outcome)
        _finished(job, outcome)
        job.ownership.check()
        damaged.update(outcome.damaged)
        peak_rss = max(peak_rss, outcome.peak_rss_bytes)
        if outcome.record is not None:
            done[outcome.task.key] = (outcome.task.digest, outcome.record)
    if damaged:
        keys = tuple(sorted(damaged))
        raise DamagedError(f"{job.store.url}: {', '.join(keys)}: damaged or gone; run again", keys)
    seconds = round(time.monotonic() - start, 3)
    job.record.computed += len(todo)
    job.store.compact(stage, PACKED_COMMITS)
    job.record.stages[stage] = {**info, "computed": len(todo), "seconds": seconds, "peak_rss_bytes": peak_rss}
    job.listener("stage_finished", {"stage": stage, "seconds": seconds})
    job.save_on_the_way()
    return dict(sorted(done.items()))


def _outcomes(job: Job, executor: Executor, tasks: list[Task], join: Join | None) -> Iterator[Outcome]:
    """Outcomes of single tasks, also of those that were joined: where that fails they are done one by one."""
    alone: list[Task] = []
    for outcome in executor.run(perform, job.store.url, join(tasks, executor.workers) if join else tasks):
        if outcome.task.parts and outcome.record is None:
            alone += () if outcome.again else outcome.task.parts
            outcome = replace(outcome, task=outcome.task.parts[0], again=True)
        yield from outcome.of_parts()
    if alone:
        yield from executor.run(perform, job.store.url, alone)


def _finished(job: Job, outcome: Outcome) -> None:
    """Tell of a task that was done, is tried again, or failed; raises what ends the run."""
    task = outcome.task
    if outcome.record is not None:
        job.listener(
            "task_done",
            {
                "stage": task.stage,
                "key": task.key,
                "points": task.points,
                "seconds": round(outcome.seconds, 3),
                "peak_rss_bytes": outcome.peak_rss_bytes,
            },
        )
        return
    failure: dict[str, Any] = {
        "stage": task.stage,
        "title": job.plan.title_of(task.stage),
        "key": task.key,
        "error": outcome.error or "",
        "kind": outcome.error_kind or "",
    }
    _refuse_gone(job)
    if outcome.fatal:
        raise DiskFullError(f"{failure['title']} {task.key}: {outcome.error}")
    if outcome.again or outcome.damaged:
        job.listener("task_again", failure)
        return
    failure["bounds"] = _place(job, task)
    job.listener("task_failed", dict(failure))
    job.record.failed.append(failure)
    if job.plan.config.on_error == "stop":
        raise ProcessingError(
            f"{failure['title']} {task.key}: {outcome.error}; --on-error skip goes on without it"
        )


def _refuse_gone(job: Job) -> None:
    """Raise ProcessingError where it is not the task that failed: everything that it needs was removed."""
    places = [job.store.url] if not store_exists(job.store.url) else []
    places += [str(job.out)] if not job.out.is_dir() else []
    if places:
        raise ProcessingError(
            f"{places[-1]}: was removed while the run went on; run again, and what is gone is made anew"
        )


def _place(job: Job, task: Task) -> list[float] | None:
    """The hole that a task leaves: lowest x, y, highest x, y in units of the CRS; None where it has no place."""
    work = task.arguments
    bounds = work.place(job.plan.meta.bucket) if isinstance(work, Placed) else None
    return None if bounds is None else [v / COUNTS_PER_UNIT for v in bounds.to_json()]
