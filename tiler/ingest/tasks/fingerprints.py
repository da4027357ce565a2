"""Gives each input a number that it keeps in the store, and takes the digest of its bytes.

All bytes of a file are read once for its digest, by the workers, where the data are near; again only where its size,
its time or the bytes before its points are others than before. So a file that was touched or copied is known again.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import Any

from tiler.errors import InputError
from tiler.ingest.contents import ReadFiles, read_files
from tiler.ingest.tasks.points import Source
from tiler.inputs import SourceInfo
from tiler.io.locations import FileState, is_url, location
from tiler.plan import chunks_of
from tiler.redaction import without_secrets
from tiler.runs.job import Job
from tiler.schedule import Task, digest_of
from tiler.schedule.worker import compute

STAGE = "identify"
GROUP_BYTES, GROUP_FILES = 32 << 20, 64
"""Bytes and number of small files that one task reads together."""
SAVED_SECONDS = 10.0
"""After which what is known is kept in the store, for a run that is killed on the way."""

File = tuple[str, FileState, int]
"""Place, state as it was found, points."""


def numbered(job: Job) -> list[Source]:
    """The sources that hold points and can be read to their end; others are listed in ``job.record.quarantined``.

    Raises
    ------
    InputError
        One cannot be read, and there is no other or ``--on-error stop`` was said.
    """
    known: dict[str, dict[str, Any]] = job.store.get_state("sources") or {}
    # Without passwords and tokens: a link that is signed anew each day leads to the same file.
    places = {without_secrets(location(info.path)): info for info in job.plan.sources}
    todo = []
    for place, info in places.items():
        entry = known.setdefault(place, {"number": len(known)})
        if not job.plan.config.verify and entry.get("stamp") == info.stamp:
            continue
        if is_url(info.path) and chunks_of(job.plan, info) is not None:  # a window: most of it is not fetched
            content = digest_of("octree", info.state, info.digest, info.octree)
            known[place] = {**entry, "stamp": info.stamp, "content": content}
        else:
            todo.append((place, info))
    unreadable = _identify(job, known, todo)
    job.store.put_state("sources", known)
    _leave_out(job, unreadable)
    sources = [
        Source(info, known[place]["number"], known[place]["content"])
        for place, info in places.items()
        if info.points and place not in unreadable
    ]
    if not sources:  # the plan refuses what has no points at all: one that had some cannot be read now
        raise InputError(f"no input could be read; the first: {min(unreadable.values())}")
    return sources


def _identify(
    job: Job, known: dict[str, dict[str, Any]], todo: list[tuple[str, SourceInfo]]
) -> dict[str, str]:
    """Have the workers read files, and keep what they find; path -> reason of those that cannot be read."""
    stamps, unreadable, saved = {place: info.stamp for place, info in todo}, {}, time.monotonic()
    files = [(location(info.path), info.state, info.points) for _, info in todo]
    for url, result in contents(job, STAGE, files):
        place = without_secrets(url)
        if "content" in result:
            known[place] |= {"stamp": stamps[place], "content": result["content"]}
        else:
            unreadable[place] = result["error"]
        if time.monotonic() - saved > SAVED_SECONDS:
            job.store.put_state("sources", known)
            saved = time.monotonic()
    return unreadable


def contents(
    job: Job, stage: str, files: Iterable[File], writes_out: bool = False
) -> Iterator[tuple[str, dict[str, str]]]:
    """The place of each file, and its ``content`` (digest of all bytes) or an ``error``, as the workers find it.

    Parameters
    ----------
    job : Job
    stage : str
        As people are told of it.
    files : iterable of (place, FileState, points)
        Points, or whatever else stands for the work of reading a file.
    writes_out : bool
        The files are those of OUT, which not all workers may see.
    """
    tasks = list(_tasks(stage, files))
    if not tasks:
        return
    points, start = sum(task.points for task in tasks), time.monotonic()
    info = {
        "stage": stage,
        "title": job.plan.title_of(stage),
        "tasks": len(tasks),
        "done": 0,
        "points": points,
    }
    job.listener("stage_started", info)
    for outcome in job.executors.choose(writes_out).run(compute, job.store.url, tasks):
        if outcome.again:
            continue
        task = outcome.task
        job.listener(
            "task_done",
            {
                "stage": stage,
                "key": task.key,
                "points": task.points,
                "seconds": round(outcome.seconds, 3),
                "peak_rss_bytes": 0,
            },
        )
        found: dict[str, dict[str, str]] = outcome.record or {}
        for place, _ in task.arguments.files:
            error = f"{place}: what reads it {outcome.error}; get the file again"
            yield place, found.get(place, {"error": error})
    seconds = round(time.monotonic() - start, 3)
    job.listener("stage_finished", {"stage": stage, "seconds": seconds})


def _leave_out(job: Job, unreadable: dict[str, str]) -> None:
    for place, reason in sorted(unreadable.items()):
        if job.plan.config.on_error == "stop" or len(job.plan.sources) == 1:
            raise InputError(reason)
        job.record.quarantined.append({"path": place, "error": reason})
        job.listener("warning", {"text": f"{place}: left out: {reason.removeprefix(f'{place}: ')}"})


def _tasks(stage: str, files: Iterable[File]) -> Iterator[Task]:
    """Tasks that read files: large ones alone, small ones together."""
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
    work = ReadFiles(tuple((place, state) for place, state, _ in group))
    digest = digest_of(work)
    return Task(stage, digest, digest, read_files, work, sum(points for _, _, points in group))
