"""Registration of the inputs in the store: a number for each source, and the digest of its bytes.

The workers read all bytes of a file once for its digest. They read them again only if its size,
its time or the bytes before its points have changed, or with ``--verify``. So a file that was
only touched, or replaced by a copy of itself, is recognized by its digest. The state, header
and octree identify a COPC file at a URL of which only a part is read.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, NotRequired, TypedDict

from tiler.core.records import digest_of
from tiler.errors import InputError
from tiler.ingest.contents import read_files
from tiler.ingest.tasks.points import Source
from tiler.inputs import SourceInfo
from tiler.io.locations import FileState, is_url, location
from tiler.observe.events import StageFinished, StageStarted, TaskDone, Warned
from tiler.plan import chunks_of
from tiler.redaction import without_secrets
from tiler.runs.job import Job
from tiler.schedule import Task, calling
from tiler.schedule.worker import compute

STAGE = "identify"
GROUP_BYTES, GROUP_FILES = 32 << 20, 64
"""Bytes and number of small files that one task reads together."""
SAVED_SECONDS = 10.0
"""Interval in seconds at which the digests are saved in the store, so that a killed run does
not lose them."""


class FileContent(NamedTuple):
    """Digest of all bytes of a file, or None and the error."""

    digest: str | None
    error: str


class KnownFile(TypedDict):
    """Number of a source in the store, and the stamp and the digest of its content once it was read."""

    number: int
    stamp: NotRequired[list[Any]]
    content: NotRequired[str]


File = tuple[str, FileState, int]
"""Location, state and number of points of a file."""


def register_sources(job: Job) -> list[Source]:
    """Return the sources with points that can be read completely.

    Sources that cannot be read are listed in ``job.record.quarantined``.

    Raises
    ------
    InputError
        A source cannot be read, and it is the only one or ``--on-error`` is ``stop``, or no source can be read.
    """
    known: dict[str, KnownFile] = job.store.get_state("sources") or {}
    # Passwords and tokens are removed, because a link that is signed daily leads to the same
    # file.
    info_by_location = {
        without_secrets(location(info.path)): info for info in job.plan.inputs.sources
    }
    todo = []
    for file_location, info in info_by_location.items():
        entry = known.setdefault(file_location, {"number": len(known)})
        if not job.plan.config.verify and entry.get("stamp") == info.stamp:
            continue
        # Most of the file is not fetched.
        if is_url(info.path) and chunks_of(job.plan, info) is not None:
            content = digest_of("octree", info.state, info.digest, info.octree)
            entry["stamp"], entry["content"] = info.stamp, content
        else:
            todo.append((file_location, info))
    unreadable = _identify(job, known, todo)
    job.store.put_state("sources", known)
    _leave_out(job, unreadable)
    sources = [
        Source(info, known[file_location]["number"], known[file_location]["content"])
        for file_location, info in info_by_location.items()
        if info.points and file_location not in unreadable
    ]
    # The plan has at least one source with points, so none of these could be read.
    if not sources:
        raise InputError(f"no input could be read; the first error: {min(unreadable.values())}")
    return sources


def _identify(
    job: Job, known: dict[str, KnownFile], todo: list[tuple[str, SourceInfo]]
) -> dict[str, str]:
    """Have the workers read files, and add their digests to ``known``. Return the errors by location."""
    stamps, unreadable, saved = (
        {file_location: info.stamp for file_location, info in todo},
        {},
        time.monotonic(),
    )
    files = [(location(info.path), info.state, info.points) for _, info in todo]
    for url, result in file_digests(job, STAGE, files):
        file_location = without_secrets(url)
        if result.digest is not None:
            entry = known[file_location]
            entry["stamp"], entry["content"] = stamps[file_location], result.digest
        else:
            unreadable[file_location] = result.error
        if time.monotonic() - saved > SAVED_SECONDS:
            job.store.put_state("sources", known)
            saved = time.monotonic()
    return unreadable


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


def _leave_out(job: Job, unreadable: dict[str, str]) -> None:
    for file_location, reason in sorted(unreadable.items()):
        if job.plan.config.on_error == "stop" or len(job.plan.inputs.sources) == 1:
            raise InputError(reason)
        job.record.leave_out(file_location, reason)
        job.listener(
            Warned(f"{file_location}: left out: {reason.removeprefix(f'{file_location}: ')}")
        )


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
