"""Digests of whole files, which the workers of a run read."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from tiler.core.digests import digest_of
from tiler.inputs.contents import read_files
from tiler.io.locations import FileState
from tiler.observe.events import StageFinished, StageStarted, TaskDone
from tiler.runs.job import Job
from tiler.schedule import Task, calling
from tiler.schedule.worker import compute

GROUP_BYTES, GROUP_FILES = 32 << 20, 64
"""Bytes and number of small files that one task reads together."""


class FileContent(NamedTuple):
    """Digest of all bytes of a file, or None and the error."""

    digest: str | None
    error: str


File = tuple[str, FileState, int]
"""Location, state and number of points of a file."""


def file_digests(
    job: Job, stage: str, files: Iterable[File], in_out: bool = False
) -> Iterator[tuple[str, FileContent]]:
    """Yield the location and content of each file. The workers read the files.

    Parameters
    ----------
    job : Job
    stage : str
        Key of the stage in the progress.
    files : iterable of File
        Location, state and number of points of each file, or another number that represents the work of reading it.
    in_out : bool
        Whether the files are in OUT, which not all workers may be able to access.
    """
    tasks = list(_tasks(stage, files))
    if not tasks:
        return
    points, start = sum(task.points for task in tasks), time.monotonic()
    job.listener(
        StageStarted(stage, job.plan.method.title_of(stage), tasks=len(tasks), points=points)
    )
    for outcome in job.executors.choose(in_out).run(compute, job.store.url, tasks):
        if outcome.again:
            continue
        task = outcome.task
        job.listener(
            TaskDone(stage, task.key, points=task.points, seconds=round(outcome.seconds, 3))
        )
        record = outcome.record or {"digests": {}, "errors": {}}
        for file_location, _ in task.arguments["files"]:
            error = f"{file_location}: the process that reads it {outcome.error}; get the file again"
            digest = record["digests"].get(file_location)
            yield file_location, FileContent(digest, record["errors"].get(file_location, error))
    seconds = round(time.monotonic() - start, 3)
    job.listener(StageFinished(stage, seconds))


def _tasks(stage: str, files: Iterable[File]) -> Iterator[Task]:
    """Yield tasks that each read a large file or several small files."""
    group: list[File] = []
    for file in files:
        full = sum(state.size for _, state, _ in group) + file[1].size > GROUP_BYTES
        if group and (len(group) == GROUP_FILES or full):
            yield _task(stage, group)
            group = []
        group.append(file)
    if group:
        yield _task(stage, group)


def _task(stage: str, group: list[File]) -> Task:
    files = tuple((file_location, state) for file_location, state, _ in group)
    n_points = sum(points for _, _, points in group)
    return Task.of(stage, digest_of(files), calling(read_files, files=files), points=n_points)
