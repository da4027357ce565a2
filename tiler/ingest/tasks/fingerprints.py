"""Registration of the inputs in the store: a number for each source, and the digest of its bytes.

The workers read all bytes of a file once for its digest. They read them again only if its size,
its time or the bytes before its points have changed, or with ``--verify``. So a file that was
only touched, or replaced by a copy of itself, is recognized by its digest. The state, header
and octree identify a COPC file at a URL of which only a part is read.
"""

from __future__ import annotations

import time
from typing import Any, NotRequired, TypedDict

from tiler.core.digests import digest_of
from tiler.errors import InputError
from tiler.inputs import SourceInfo
from tiler.io.locations import is_url, location
from tiler.observe.events import Warned
from tiler.plan import chunks_of
from tiler.redaction import without_secrets
from tiler.runs.file_digests import file_digests
from tiler.runs.found import Source
from tiler.runs.job import Job

STAGE = "identify"
SAVED_SECONDS = 10.0
"""Interval in seconds at which the digests are saved in the store, so that a killed run does
not lose them."""


class KnownFile(TypedDict):
    """Number of a source in the store, and the stamp and the digest of its content once it was read."""

    number: int
    stamp: NotRequired[list[Any]]
    content: NotRequired[str]


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


def _leave_out(job: Job, unreadable: dict[str, str]) -> None:
    for file_location, reason in sorted(unreadable.items()):
        if job.plan.config.on_error == "stop" or len(job.plan.inputs.sources) == 1:
            raise InputError(reason)
        job.record.leave_out(file_location, reason)
        job.listener(
            Warned(f"{file_location}: left out: {reason.removeprefix(f'{file_location}: ')}")
        )
