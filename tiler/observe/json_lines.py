"""Progress for programs: one JSON object per line, with the same entries in each (docs/progress.md)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import IO, TypedDict, cast

from tiler.observe.events import (
    Event,
    Note,
    RunFinished,
    StageFinished,
    StageStarted,
    TaskDone,
    TaskFailed,
    Warned,
)
from tiler.observe.job_progress import JobProgress
from tiler.redaction import stored

MIN_SECONDS = 0.2
"""Minimum time between two lines without a message, unless a stage begins or ends."""
REPORTED_BY_FILE = "spool"
"""Stage whose failed tasks are not reported, since one warning per file reports them."""


class Progress(TypedDict):
    """Progress of a job, with the entries of a line of ``--progress json`` (docs/progress.md)."""

    stage: str | None
    title: str | None
    done: int | None
    total: int | None
    rate: float | None
    progress: float | None
    eta: float | None
    message: str | None
    level: str


def progress_record(
    message: str | None = None,
    level: str = "info",
    job: JobProgress | None = None,
    now: float = 0.0,
) -> Progress:
    """Return the progress of a job.

    Parameters
    ----------
    message : str, optional
        Message for the user, or None if only numbers have changed.
    level : {"info", "warning", "error"}
    job : JobProgress, optional
        Progress of the job. Without it, there is only a message.
    now : float
        Current time by the clock of the job.
    """
    progress = Progress(
        stage=None, title=None, done=None, total=None, rate=None,
        progress=None, eta=None, message=message, level=level,
    )  # fmt: skip
    if job is not None:
        progress["eta"] = _rounded(job.seconds_left())
        if job.known:
            progress["progress"] = _rounded(job.fraction(), 4)
    if job is not None and job.stage is not None:
        stage = job.stage
        progress["stage"], progress["title"] = stage.key, stage.title
        progress["rate"] = _rounded(stage.rate(now - stage.started))
        if stage.work:
            progress["done"], progress["total"] = stage.work_done, stage.work
        else:
            progress["done"], progress["total"] = stage.tasks_done, stage.tasks
    return cast(Progress, stored(progress))


def message_of(event: Event) -> tuple[str, str] | None:
    """Return text and level of a note, a warning or a failed task, or None for other events."""
    match event:
        case Note():
            return event.text, "info"
        case Warned():
            return event.text, "warning"
        case TaskFailed() if event.stage != REPORTED_BY_FILE:
            return f"{event.title} {event.key} failed: {event.error}", "warning"
    return None


def json_line(message: str | None = None, level: str = "info") -> str:
    """Return a line of ``--progress json`` with only a message, without a line end."""
    return json.dumps(progress_record(message, level))


def _rounded(value: float | None, digits: int = 1) -> float | None:
    return None if value is None else round(value, digits)


class ProgressRecords:
    """Listener that makes a `Progress` for each message, begin and end of a stage, and at intervals between them.

    Parameters
    ----------
    tell : callable
        Function that receives each `Progress`.
    clock : callable
        Function that returns the time in seconds.
    """

    def __init__(
        self, tell: Callable[[Progress], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._tell = tell
        self._clock = clock
        self._last = 0.0
        self._job = JobProgress(clock)

    def __call__(self, event: Event) -> None:
        """Handle an event."""
        at_work = self._job.stage
        self._job(event)
        message = message_of(event)
        if message is not None:
            self._record(*message)
            return
        match event:
            case StageStarted():
                self._record()
            case StageFinished() if at_work is not None:
                # The last record is for the ended stage.
                ended, self._job.stage = self._job.stage, at_work
                self._record()
                self._job.stage = ended
            case TaskDone() if self._clock() - self._last >= MIN_SECONDS:
                self._record()
            case RunFinished():
                self._record("done")

    def _record(self, message: str | None = None, level: str = "info") -> None:
        self._last = self._clock()
        self._tell(progress_record(message, level, self._job, self._last))


class JsonLines(ProgressRecords):
    """Listener that writes each `Progress` as a line of JSON.

    Parameters
    ----------
    stream : text stream
    clock : callable
        Function that returns the time in seconds.
    """

    def __init__(self, stream: IO[str], clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(
            lambda record: print(json.dumps(record), file=stream, flush=True), clock
        )
