"""Progress for people: bars with rate and ETA on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, Any

from tiler.observe.events import Listener
from tiler.observe.json_lines import JsonLines, message_of
from tiler.observe.whole_job import StageState, WholeJob
from tiler.redaction import shown

_LINE_INTERVAL_SECONDS = 15.0
TROUBLE = ("warning", "task_failed")
"""Events that are told even when quiet."""


def rate_text(points: float, seconds: float) -> str:
    """Points per second in a few letters: ``2.1 M points/s``; empty where nothing can be said."""
    if points <= 0 or seconds <= 0:
        return ""
    return f"{count_text(points / seconds)} points/s"


def count_text(count: float) -> str:
    """A count in a few letters: ``870``, ``12.3 k``, ``10.7 M``, ``1.2 G``."""
    for factor, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if count >= factor:
            return f"{count / factor:.1f} {letter}"
    return f"{count:.0f}"


def size_text(size: float) -> str:
    """A number of bytes: ``812.0 MiB``."""
    for factor, unit in ((1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")):
        if size >= factor:
            return f"{size / factor:.1f} {unit}"
    return f"{size:.0f} bytes"


def duration_text(seconds: float) -> str:
    """A duration in a few letters: ``4.2 s``, ``3:25 min``, ``1:02:07 h``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"


class PlainLines:
    """A listener that writes a line when a stage begins and ends, and one now and then between: for logs and CI."""

    def __init__(self, stream: IO[str], clock: Callable[[], float] = time.monotonic) -> None:
        self._stream, self._clock = stream, clock
        self._job = WholeJob(clock)
        self._last_line = clock()

    def _write(self, text: str) -> None:
        print(shown(text), file=self._stream, flush=True)
        self._last_line = self._clock()

    def __call__(self, event: str, fields: dict[str, Any]) -> None:
        """Take in an event."""
        stage = self._job.stage
        self._job(event, fields)
        text = message_text(event, fields)
        if text is not None:
            self._write(text)
        elif event == "stage_started" and self._job.stage is not None:
            self._write(f"{self._job.stage.title}: {start_text(self._job.stage)}")
        elif event == "task_done" and stage is not None:
            if self._clock() - self._last_line >= _LINE_INTERVAL_SECONDS:
                self._write(f"{stage.title}: {self._middle(stage)}")
        elif event == "stage_finished" and stage is not None and stage.todo_share > 0:
            seconds = fields.get("seconds", self._clock() - stage.started)
            rate = rate_text(stage.points_done, seconds)
            self._write(f"{stage.title}: done in {duration_text(seconds)}" + (f", {rate}" if rate else ""))

    def _middle(self, stage: StageState) -> str:
        parts = [f"{stage.fraction:.0%}", rate_text(stage.points_done, self._clock() - stage.started)]
        left = self._job.seconds_left()
        if self._job.known:
            parts.append(f"whole job {self._job.fraction():.0%}")
        if left is not None:
            parts.append(f"about {duration_text(left)} left")
        return ", ".join(p for p in parts if p)


def message_text(event: str, fields: dict[str, Any]) -> str | None:
    """The line of a note, a warning or a task that failed; None for other events."""
    text, level = message_of(event, fields) or (None, "")
    return f"warning: {text}" if level == "warning" else text


def start_text(stage: StageState) -> str:
    """What a stage has before it."""
    if stage.tasks_done >= stage.tasks:
        done = "its one task was" if stage.tasks == 1 else f"all {stage.tasks} tasks were"
        return f"nothing to do, {done} done before"
    before = f" ({stage.before} of {stage.tasks} were done before)" if stage.before else ""
    points = f", {count_text(stage.points)} points" if stage.points else ""
    todo = stage.tasks - stage.before
    return f"{todo} task{'' if todo == 1 else 's'}{points}{before}"


@contextmanager
def bar_progress(stream: IO[str]) -> Iterator[Listener]:
    """A listener that draws two bars: the whole job, with the time that is left, and the stage at work (rich)."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
    from rich.progress import Task as Bar
    from rich.text import Text

    job = WholeJob()

    class Facts(ProgressColumn):
        """The rate of the stage; for the job (or a stage that is all of it) the time spent, and the time left."""

        def render(self, task: Bar) -> Text:
            parts = [str(task.fields["rate"])]
            if task.fields["clock"] and task.elapsed is not None:
                left = None if task.finished else job.seconds_left()
                parts += [f"{duration_text(task.elapsed)} so far"]
                parts += [] if left is None else [f"about {duration_text(left)} left"]
            return Text(", ".join(p for p in parts if p))

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>3.0f} %"),
        Facts(),
    )
    with Progress(*columns, console=Console(file=stream)) as bars:
        whole = bars.add_task("whole job", total=1.0, visible=False, rate="", clock=True)
        part = bars.add_task("", total=1.0, visible=False, rate="", clock=False)

        def listen(event: str, fields: dict[str, Any]) -> None:
            before = job.stage
            job(event, fields)
            stage, text = job.stage, message_text(event, fields)
            if text is not None:
                bars.console.print(shown(text), markup=False, highlight=False)
            elif event == "stage_started" and stage is not None:
                bars.reset(part, description=shown(stage.title), visible=True, clock=not job.known, rate="")
                bars.update(part, completed=stage.fraction)
            elif event == "task_done" and stage is not None:
                rate = rate_text(stage.points_done, time.monotonic() - stage.started)
                bars.update(part, completed=stage.fraction, rate=rate)
            elif event == "stage_finished" and before is not None:
                bars.update(part, completed=1.0)
            elif event == "run_finished":
                bars.update(part, visible=False)
                bars.update(whole, completed=1.0)
            if job.known and event != "run_finished":
                bars.update(whole, completed=job.fraction(), visible=True)

        yield listen


@contextmanager
def open_progress(stream: IO[str], quiet: bool = False, form: str = "auto") -> Iterator[Listener]:
    """The listener that fits a stream: bars on a terminal, lines elsewhere, only trouble when quiet.

    Parameters
    ----------
    stream : text stream
        Where to write; stderr, as results go to stdout.
    quiet : bool
        Only warnings and failures.
    form : {"auto", "plain", "json", "none"}
        Whatever the stream is: lines for people, a JSON object a line (`tiler.observe.json_lines`), or, as when
        quiet, no progress.
    """
    if form == "json":
        yield _only(JsonLines(stream), *TROUBLE) if quiet else JsonLines(stream)
    elif quiet or form == "none":
        yield _only(PlainLines(stream), *TROUBLE, *(() if quiet else ("note",)))
    elif form == "auto" and stream.isatty():
        with bar_progress(stream) as listener:
            yield listener
    else:
        yield PlainLines(stream)


def _only(listener: Listener, *names: str) -> Listener:
    def listen(event: str, fields: dict[str, Any]) -> None:
        if event in names:
            listener(event, fields)

    return listen
