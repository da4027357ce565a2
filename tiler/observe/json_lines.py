"""Events for programs, as lines of JSON: all of them in ``events.jsonl``, and progress (docs/progress.md).

``events.jsonl`` has the events of all runs with the same OUT. A line of progress has the same entries each time.
Logging to stderr is set up here too, as lines of JSON or as text.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, TypedDict, cast

from tiler.core.file_names import link_error, without_links
from tiler.errors import write_error
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
from tiler.redaction import shown, stored

MIN_SECONDS = 0.2
"""Minimum time between two lines without a message, unless a stage begins or ends."""
REPORTED_BY_FILE = "spool"
"""Stage whose failed tasks are not reported, since one warning per file reports them."""


_LEVELS = {-1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO}
_OWN_LOGGERS = ("tiler", "ptd", "cli")


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
        progress["stage"], progress["title"] = stage.event.stage, stage.event.title
        progress["rate"] = _rounded(stage.rate(now - stage.started))
        if stage.work:
            progress["done"], progress["total"] = stage.work_done, stage.work
        else:
            progress["done"], progress["total"] = stage.tasks_done, stage.event.tasks
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


class EventLog:
    """Listener that appends each event to a file, and context manager that closes the file.

    Each line is written immediately, so that users can follow the file and it contains
    everything before a crash. An incomplete line of a killed run is ended before the next line.

    Parameters
    ----------
    path : Path
        Path of the file, which is made together with its folder, or continued.

    Raises
    ------
    ConfigError
        The path is a link, through which nothing is written.
    ProcessingError
        The file cannot be written, now or during a later call.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if path.is_symlink():
            raise link_error(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Without a buffer, closing the file does not repeat a failed write.
            self._stream = open(path, "a+b", buffering=0, opener=without_links)  # noqa: SIM115 - `__exit__` closes the file.
            if self._stream.tell() > 0:
                self._stream.seek(-1, 2)
                if self._stream.read(1) != b"\n":
                    self._stream.write(b"\n")
        except OSError as error:
            raise write_error(str(path), error, path.parent) from error

    def __call__(self, event: Event) -> None:
        """Append one event: ``{"time": UTC time in ISO 8601, "event": name, ...values}``."""
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"time": time, "event": event.name, **event.to_json()}, default=str)
        try:
            data = line.encode() + b"\n"
            if self._stream.write(data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise write_error(str(self._path), error, self._path.parent) from error

    def __enter__(self) -> EventLog:
        return self

    def __exit__(self, *ended: object) -> None:
        self._stream.close()


class _StderrHandler(logging.Handler):
    """Handler that writes to the current `sys.stderr`, which progress bars replace."""

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        if record.name == "py.warnings":
            # The text of a Python warning has several lines, with source code at the end.
            text = " ".join(text.split())
        print(shown(text), file=sys.stderr, flush=True)


class _JsonHandler(_StderrHandler):
    """Handler that writes each record as a line of ``--progress json``."""

    def emit(self, record: logging.LogRecord) -> None:
        is_warning = record.levelno >= logging.WARNING
        level = (
            "error" if record.levelno >= logging.ERROR else "warning" if is_warning else "info"
        )
        text = " ".join(record.getMessage().split())
        print(json_line(text, level), file=sys.stderr, flush=True)


def set_up_logging(verbosity: int, as_json: bool = False) -> None:
    """Send the log to stderr. Another call replaces the set-up.

    Parameters
    ----------
    verbosity : int
        Level of detail. -1 or less shows only errors, 0 also warnings, 1 also decisions and steps of tiler, 2 or more
        also all details of tiler and messages of the libraries (from level INFO).
    as_json : bool
        Whether to write each message as a line of ``--progress json``.
    """
    level = _LEVELS.get(max(verbosity, -1), logging.DEBUG)
    handler = _JsonHandler() if as_json else _StderrHandler()
    form = (
        "%(levelname)s %(name)s: %(message)s"
        if verbosity >= 2
        else "%(levelname)s: %(message)s"
    )
    handler.setFormatter(logging.Formatter(form))
    root = logging.getLogger()
    for old in [h for h in root.handlers if isinstance(h, _StderrHandler)]:
        root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(logging.INFO if verbosity >= 2 else max(level, logging.WARNING))
    for name in _OWN_LOGGERS:
        logging.getLogger(name).setLevel(level)
    logging.captureWarnings(True)
