"""Progress for programs: one JSON object a line, with the same entries in each (docs/progress.md)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import IO, Any

from tiler.observe.whole_job import WholeJob
from tiler.redaction import stored

LEAST_SECONDS = 0.2
"""Between two lines that tell of tasks alone."""
TOLD_BY_FILE = "spool"
"""The stage whose failed tasks are told once for each file, as a warning that names it."""


def json_line(
    message: str | None = None, level: str = "info", job: WholeJob | None = None, now: float = 0.0
) -> str:
    """One line of ``--progress json``, without its end.

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
    line: dict[str, Any] = dict.fromkeys(("stage", "title", "done", "total", "rate", "progress", "eta"))
    if job is not None:
        line["eta"] = _rounded(job.seconds_left())
        line["progress"] = _rounded(job.fraction(), 4) if job.known else None
    if job is not None and job.stage is not None:
        stage = job.stage
        line |= {"stage": stage.key, "title": stage.title, "rate": _rounded(stage.rate(now - stage.started))}
        if stage.points:
            line |= {"done": stage.points_done, "total": stage.points}
        else:
            line |= {"done": stage.tasks_done, "total": stage.tasks}
    return json.dumps(stored({**line, "message": message, "level": level}))


def _rounded(value: float | None, digits: int = 1) -> float | None:
    return None if value is None else round(value, digits)


class JsonLines:
    """A listener that writes `json_line` for each message, beginning and end of a stage, and now and then between.

    Parameters
    ----------
    stream : text stream
    clock : callable
    """

    def __init__(self, stream: IO[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._stream, self._clock, self._last = stream, clock, 0.0
        self._job = WholeJob(clock)

    def __call__(self, event: str, fields: dict[str, Any]) -> None:
        """Take in an event, and write a line if it says something new."""
        at_work = self._job.stage
        self._job(event, fields)
        if event in ("note", "warning"):
            self._write(str(fields["text"]), "info" if event == "note" else "warning")
        elif event == "task_failed" and fields["stage"] != TOLD_BY_FILE:
            name = fields.get("title", fields["stage"])
            self._write(f"{name} {fields['key']} failed: {fields['error']}", "warning")
        elif event == "stage_started":
            self._write()
        elif event == "stage_finished" and at_work is not None:
            ended, self._job.stage = self._job.stage, at_work  # a last line of that stage
            self._write()
            self._job.stage = ended
        elif event == "task_done" and self._clock() - self._last >= LEAST_SECONDS:
            self._write()
        elif event == "run_finished":
            self._write("done")

    def _write(self, message: str | None = None, level: str = "info") -> None:
        self._last = self._clock()
        print(json_line(message, level, self._job, self._last), file=self._stream, flush=True)
