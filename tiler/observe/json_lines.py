"""Progress for programs: one JSON object a line, with the same entries in each (docs/progress.md)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import IO, Any, TypedDict, cast

from tiler.observe.whole_job import WholeJob
from tiler.redaction import stored

LEAST_SECONDS = 0.2
"""Between two lines that tell of tasks alone."""
TOLD_BY_FILE = "spool"
"""The stage whose failed tasks are told once for each file, as a warning that names it."""


class Progress(TypedDict):
    """How far a job is: a line of ``--progress json``, with the same entries (docs/progress.md)."""

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
    message: str | None = None, level: str = "info", job: WholeJob | None = None, now: float = 0.0
) -> Progress:
    """How far a job is.

    Parameters
    ----------
    message : str, optional
        For people; None where only numbers changed.
    level : {"info", "warning", "error"}
    job : WholeJob, optional
        How far it is.
    now : float
        By the clock of the job.
    """
    record: dict[str, Any] = dict.fromkeys(("stage", "title", "done", "total", "rate", "progress", "eta"))
    if job is not None:
        record["eta"] = _rounded(job.seconds_left())
        record["progress"] = _rounded(job.fraction(), 4) if job.known else None
    if job is not None and job.stage is not None:
        stage = job.stage
        rate = _rounded(stage.rate(now - stage.started))
        record |= {"stage": stage.key, "title": stage.title, "rate": rate}
        if stage.points:
            record |= {"done": stage.points_done, "total": stage.points}
        else:
            record |= {"done": stage.tasks_done, "total": stage.tasks}
    return cast(Progress, stored({**record, "message": message, "level": level}))


def message_of(event: str, fields: dict[str, Any]) -> tuple[str, str] | None:
    """Text and level of a note, a warning or a task that failed; None for other events."""
    if event in ("note", "warning"):
        return str(fields["text"]), "info" if event == "note" else "warning"
    if event == "task_failed" and fields["stage"] != TOLD_BY_FILE:
        return f"{fields.get('title', fields['stage'])} {fields['key']} failed: {fields['error']}", "warning"
    return None


def json_line(message: str | None = None, level: str = "info") -> str:
    """A line of ``--progress json`` that tells a message alone, without its end."""
    return json.dumps(progress_record(message, level))


def _rounded(value: float | None, digits: int = 1) -> float | None:
    return None if value is None else round(value, digits)


class ProgressRecords:
    """A listener that tells of each message, beginning and end of a stage, and now and then between.

    Parameters
    ----------
    tell : callable
        Given each `Progress`.
    clock : callable
    """

    def __init__(
        self, tell: Callable[[Progress], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._tell, self._clock, self._last = tell, clock, 0.0
        self._job = WholeJob(clock)

    def __call__(self, event: str, fields: dict[str, Any]) -> None:
        """Take in an event, and tell of it if it says something new."""
        at_work = self._job.stage
        self._job(event, fields)
        message = message_of(event, fields)
        if message is not None:
            self._record(*message)
        elif event == "stage_started":
            self._record()
        elif event == "stage_finished" and at_work is not None:
            ended, self._job.stage = self._job.stage, at_work  # a last record of that stage
            self._record()
            self._job.stage = ended
        elif event == "task_done" and self._clock() - self._last >= LEAST_SECONDS:
            self._record()
        elif event == "run_finished":
            self._record("done")

    def _record(self, message: str | None = None, level: str = "info") -> None:
        self._last = self._clock()
        self._tell(progress_record(message, level, self._job, self._last))


class JsonLines(ProgressRecords):
    """A listener that writes what `ProgressRecords` tells as lines of JSON.

    Parameters
    ----------
    stream : text stream
    clock : callable
    """

    def __init__(self, stream: IO[str], clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(lambda record: print(json.dumps(record), file=stream, flush=True), clock)
