"""Display of progress: bars with rate and ETA on a terminal or in a notebook, and lines at intervals elsewhere."""

from __future__ import annotations

import html
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import IO, Any

from tiler.observe.events import (
    Detail,
    Event,
    Listener,
    Note,
    RunFinished,
    StageFinished,
    StageStarted,
    TaskDone,
    TaskFailed,
    Warned,
)
from tiler.observe.job_progress import JobProgress, StageProgress
from tiler.observe.json_lines import JsonLines, Progress, message_of
from tiler.redaction import shown

_LINE_INTERVAL_SECONDS = 15.0
_SIGN_INTERVAL_SECONDS = 600.0
"""Interval of lines that only show that a run is still at work."""
_MIN_SECONDS = 1.0
"""Duration below which a stage has no line."""
_START_LINE_SECONDS = 5.0
"""Duration from which a stage also has a line about its beginning, so that a log shows the
running stage."""
ALMOST = 0.999
"""Maximum of the bar before the run is finished."""
_MAX_OF_KIND = 3
"""Number of warnings that are shown of one kind. The others are counted."""
_QUOTED = 100
"""Number of characters of a warning that stand for others of its kind."""
_VARYING = re.compile(r"^.*?: |\S*[\d/\\]\S*")
"""Parts of a warning that differ between warnings of a kind: what it is about, numbers and paths."""
TROUBLE = (Warned, TaskFailed)
"""Events that are shown even with ``--quiet``."""


def rate_text(count: float, seconds: float, unit: str = "points") -> str:
    """Return points, or another unit, per second as short text: ``2.1 M points/s``, empty if there is no rate yet."""
    return f"{count_text(count / seconds)} {unit}/s" if count > 0 and seconds > 0 else ""


def stage_rate(stage: StageProgress, seconds: float) -> str:
    """Return the rate of a stage so far: of pixels if it makes pixels, else of points.

    A stage that writes both rasters and clouds has no rate.
    """
    if stage.event.by_pixels and stage.event.points:
        return ""
    if stage.event.pixels:
        return rate_text(stage.pixels_done, seconds, "pixels")
    return rate_text(stage.points_done, seconds)


def count_text(count: float) -> str:
    """Return a count as short text: ``870``, ``12.3 k``, ``10.7 M``, ``1.2 G``."""
    for factor, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if count >= factor:
            return f"{count / factor:.1f} {letter}"
    return f"{count:.0f}"


def size_text(size: float) -> str:
    """Return a number of bytes as short text: ``812.0 MiB``."""
    for factor, unit in ((1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")):
        if size >= factor:
            return f"{size / factor:.1f} {unit}"
    return f"{size:.0f} bytes"


def duration_text(seconds: float) -> str:
    """Return a duration as short text: ``4.2 s``, ``3:25 min``, ``1:02:07 h``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"


class PlainLines:
    """Listener that writes notes, warnings and a line per stage, and more lines during a long stage.

    A stage of less than a second has no line, and a stage of less than five seconds has one
    line, so that the log of a small run is short.

    Parameters
    ----------
    stream : text stream
    clock : callable
        Function that returns the time in seconds.
    stages : bool
        Whether stages have lines. If not, there is a line with the time of day if no other came for a long time.
    """

    def __init__(
        self,
        stream: IO[str],
        clock: Callable[[], float] = time.monotonic,
        stages: bool = True,
    ) -> None:
        self._stream = stream
        self._clock = clock
        self._stages = stages
        self._interval = _LINE_INTERVAL_SECONDS if stages else _SIGN_INTERVAL_SECONDS
        self._job = JobProgress(clock)
        self._last_line = clock()
        self._begun = not stages

    def _write(self, text: str) -> None:
        print(shown(text), file=self._stream, flush=True)
        self._last_line = self._clock()

    def __call__(self, event: Event) -> None:
        """Handle an event."""
        stage = self._job.stage
        self._job(event)
        text = message_text(event)
        if text is not None:
            self._write(text)
            return
        match event:
            case StageStarted():
                self._begun = not self._stages
            case TaskDone() if stage is not None:
                self._show(stage)
            case StageFinished() if stage is not None and stage.remaining_share > 0:
                if not self._stages:
                    self._show(stage)
                elif self._begun or event.seconds >= _MIN_SECONDS:
                    self._write(f"{stage.event.title}: {self._end(stage, event.seconds)}")

    def _end(self, stage: StageProgress, seconds: float) -> str:
        parts = [f"done in {duration_text(seconds)}", stage_rate(stage, seconds)]
        if not self._begun:
            parts.insert(0, start_text(stage))
        return ", ".join(filter(None, parts))

    def _show(self, stage: StageProgress) -> None:
        """Write a line about the running stage: its beginning once it has taken some seconds, then its progress."""
        if not self._begun and self._clock() - stage.started >= _START_LINE_SECONDS:
            self._begun = True
            self._write(f"{stage.event.title}: {start_text(stage)}")
        elif self._begun and self._clock() - self._last_line >= self._interval:
            now = "" if self._stages else time.strftime("%H:%M ")
            self._write(f"{now}{stage.event.title}: {self._middle(stage)}")

    def _middle(self, stage: StageProgress) -> str:
        parts = [f"{stage.fraction:.0%}", stage_rate(stage, self._clock() - stage.started)]
        left = self._job.seconds_left()
        if self._job.known:
            parts.append(f"whole job {self._job.fraction():.0%}")
        if left is not None:
            parts.append(f"about {duration_text(left)} left")
        return ", ".join(p for p in parts if p)


def message_text(event: Event) -> str | None:
    """Return the line for a note, a warning or a failed task, or None for other events."""
    text, level = message_of(event) or (None, "")
    return f"warning: {text}" if level == "warning" else text


def start_text(stage: StageProgress) -> str:
    """Return text about the work of a stage at its beginning."""
    todo = stage.event.tasks - stage.event.done
    text = "1 task" if todo == 1 else f"{todo} tasks"
    if stage.event.points:
        text += f", {count_text(stage.event.points)} points"
    if stage.event.by_pixels:
        text += f", {count_text(stage.event.pixels)} pixels"
    if stage.event.done:
        text += f" ({stage.event.done} of {stage.event.tasks} were done before)"
    return text


@contextmanager
def bar_progress(stream: IO[str]) -> Iterator[Listener]:
    """Yield a listener that draws two bars (rich): the whole job with the time left, and the running stage."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
    from rich.progress import Task as Bar
    from rich.text import Text

    job = JobProgress()

    class Figures(ProgressColumn):
        """Column with the rate of a stage. The bar of a job, or of a stage without a job, has times spent and left."""

        def render(self, task: Bar) -> Text:
            parts = [str(task.fields["rate"])]
            if task.fields["clock"] and task.elapsed is not None:
                parts.append(f"{duration_text(task.elapsed)} so far")
                left = None if task.finished else job.seconds_left()
                if left is not None:
                    parts.append(f"about {duration_text(left)} left")
            return Text(", ".join(filter(None, parts)))

    class Grows(ProgressColumn):
        """Empty column that updates the length of the bar of the whole job before the bar is drawn."""

        max_refresh = None

        def render(self, task: Bar) -> Text:
            if task.fields["clock"] and job.known and not task.finished:
                task.completed = min(job.fraction(), ALMOST)
            return Text()

    columns = (
        Grows(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=30),
        TextColumn("{task.percentage:>5.1f} %"),
        Figures(),
    )
    with Progress(*columns, console=Console(file=stream)) as bars:
        whole = bars.add_task("whole job", total=1.0, visible=False, rate="", clock=True)
        part = bars.add_task("", total=1.0, visible=False, rate="", clock=False)

        def listen(event: Event) -> None:
            before = job.stage
            job(event)
            stage, text = job.stage, message_text(event)
            if text is not None:
                bars.console.print(shown(text), markup=False, highlight=False)
            match event:
                case StageStarted() if stage is not None:
                    bars.reset(
                        part,
                        description=shown(stage.event.title),
                        visible=True,
                        clock=not job.known,
                        rate="",
                    )
                    bars.update(part, completed=stage.fraction)
                case TaskDone() if stage is not None:
                    rate = stage_rate(stage, time.monotonic() - stage.started)
                    bars.update(part, completed=stage.fraction, rate=rate)
                case StageFinished() if before is not None:
                    bars.update(part, completed=1.0)
                case RunFinished():
                    bars.update(part, visible=False)
                    bars.update(whole, completed=1.0)
                    return
            if job.known:
                bars.update(whole, completed=job.fraction(), visible=True)

        yield listen


@contextmanager
def open_progress(
    stream: IO[str], quiet: bool = False, form: str = "auto", verbose: bool = False
) -> Iterator[Listener]:
    """Yield the listener for a stream: bars on a terminal, or else notes, warnings and rare signs of life.

    Parameters
    ----------
    stream : text stream
        Stream to write to, which is stderr, since results go to stdout.
    quiet : bool
        Whether to show only warnings and failures.
    form : {"auto", "plain", "json", "none"}
        Form of the progress: depending on the stream, lines of text, one JSON object per line
        (`tiler.observe.json_lines`), or messages without progress.
    verbose : bool
        Whether to show details as well, and lines about the stages if there are no bars.
    """
    kinds: tuple[type[Event], ...] = TROUBLE if quiet else (Event,)
    if form == "json":
        yield _filtered(JsonLines(stream), kinds)
        return
    if form == "none" and not quiet:
        kinds = (*TROUBLE, Note)
    shown_events: AbstractContextManager[Listener]
    if form == "auto" and not quiet and stream.isatty():
        shown_events = bar_progress(stream)
    else:
        shown_events = nullcontext(PlainLines(stream, stages=verbose or form == "plain"))
    most = sys.maxsize if verbose else _MAX_OF_KIND
    with shown_events as listener, _fewer_warnings(listener, most) as fewer:
        yield _filtered(fewer, kinds, () if verbose else (Detail,))


@contextmanager
def _fewer_warnings(listener: Listener, most: int) -> Iterator[Listener]:
    """Yield a listener that forwards at most ``most`` warnings of a kind, and at the end their number."""
    texts: dict[str, list[str]] = {}

    def listen(event: Event) -> None:
        text, level = message_of(event) or ("", "")
        if level == "warning":
            alike = texts.setdefault(_VARYING.sub("", text), [])
            alike.append(text)
            if len(alike) > most:
                return
        listener(event)

    try:
        yield listen
    finally:
        for alike in texts.values():
            if len(alike) > most:
                listener(Warned(_more_text(alike[most:])))


def _more_text(alike: list[str]) -> str:
    """Return a line that stands for warnings that were not shown."""
    number = "one more warning is" if len(alike) == 1 else f"{len(alike)} more warnings are"
    example = alike[0] if len(alike[0]) <= _QUOTED else f"{alike[0][:_QUOTED].rstrip()}..."
    return f"{number} like this one (-v prints all, and run.json of a run has all): {example}"


def _filtered(
    listener: Listener, kinds: tuple[type[Event], ...], without: tuple[type[Event], ...] = ()
) -> Listener:
    def listen(event: Event) -> None:
        if isinstance(event, kinds) and not isinstance(event, without):
            listener(event)

    return listen


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook, without importing IPython."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    return type(get_ipython()).__name__ == "ZMQInteractiveShell"


class NotebookBar:
    """Bar for progress records (`tiler.observe.json_lines.ProgressRecords`) in the output of a notebook's cell."""

    def __init__(self) -> None:
        from IPython import display

        jupyter: Any = display  # The functions of IPython have no types.
        self._html = jupyter.HTML
        self._warnings: list[str] = []
        self._shown = jupyter.display(self._html(""), display_id=True)

    def __call__(self, progress: Progress) -> None:
        """Update the bar with new progress."""
        if progress["level"] == "warning" and progress["message"]:
            self._warnings.append(progress["message"])
        self._shown.update(self._html(bar_markup(progress, self._warnings)))


def bar_markup(progress: Progress, warnings: list[str]) -> str:
    """Return the HTML of a bar, of the running stage with the time left, and of warnings.

    Parameters
    ----------
    progress : Progress
    warnings : list of str
        All warnings of the job so far.
    """
    done = progress["progress"]
    parts = [] if done is None else [f"{done:.0%}"]
    if progress["title"]:
        parts.append(progress["title"])
    if progress["eta"] is not None:
        parts.append(f"about {duration_text(progress['eta'])} left")
    if progress["message"] == "done":
        done, parts = 1.0, ["done"]
    value = "" if done is None else f' value="{done:.4f}" max="1"'
    bar = f"<progress{value}></progress>"
    lines = [f"{bar} {_text(', '.join(parts))}"]
    lines += [f"warning: {_text(warning)}" for warning in warnings]
    return "".join(f"<div>{line}</div>" for line in lines)


def _text(text: str) -> str:
    return html.escape(shown(text))
