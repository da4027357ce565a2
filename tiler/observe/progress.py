"""Progress for people: bars with rate and ETA on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

from tiler.observe.events import Listener
from tiler.redaction import shown

_LINE_INTERVAL_SECONDS = 15.0
TOLD_BY_FILE = "spool"
"""The stage whose failed tasks are told once for each file, as a warning that names it."""


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
    """A duration in a few letters: ``4.2 s``, ``3:25``, ``1:02:07``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


@dataclass
class _Stage:
    """How far a stage is. Points are counted where the stage says how many there are, else tasks."""

    name: str
    tasks: int
    points: int
    tasks_done: int
    started: float
    points_done: int = 0

    @property
    def fraction(self) -> float:
        """The done part of what is left to do, 0 to 1."""
        if self.points > 0:
            return min(self.points_done / self.points, 1.0)
        return min(self.tasks_done / self.tasks, 1.0) if self.tasks else 1.0


class _PlainLines:
    """A listener that writes a line when a stage begins and ends, and one now and then between."""

    def __init__(self, stream: IO[str], clock: Callable[[], float]) -> None:
        self._stream = stream
        self._clock = clock
        self._stages: dict[str, _Stage] = {}
        self._last_line = clock()

    def _write(self, text: str) -> None:
        print(shown(text), file=self._stream, flush=True)
        self._last_line = self._clock()

    def __call__(self, event: str, fields: dict[str, Any]) -> None:
        if event in ("note", "warning"):
            self._write(message_text(event, fields))
        elif event == "task_failed" and fields["stage"] != TOLD_BY_FILE:
            self._write(failure_text(fields))
        elif event == "stage_started":
            stage = _stage_of(fields, self._clock())
            if stage.tasks_done < stage.tasks:  # else there is nothing to tell of its end
                self._stages[stage.name] = stage
            self._write(f"{stage.name}: {start_text(stage)}")
        elif event == "task_done" and fields["stage"] in self._stages:
            stage = self._stages[fields["stage"]]
            _count(stage, fields)
            if self._clock() - self._last_line >= _LINE_INTERVAL_SECONDS:
                self._write(f"{stage.name}: {self._middle(stage)}")
        elif event == "stage_finished" and fields["stage"] in self._stages:
            stage = self._stages.pop(fields["stage"])
            seconds = fields.get("seconds", self._clock() - stage.started)
            rate = rate_text(stage.points_done, seconds)
            self._write(f"{stage.name}: done in {duration_text(seconds)}" + (f", {rate}" if rate else ""))

    def _middle(self, stage: _Stage) -> str:
        seconds = self._clock() - stage.started
        parts = [f"{stage.fraction:.0%}", rate_text(stage.points_done, seconds)]
        if 0 < stage.fraction < 1:
            parts.append(f"{duration_text(seconds * (1 / stage.fraction - 1))} left")
        return ", ".join(p for p in parts if p)


def message_text(event: str, fields: dict[str, Any]) -> str:
    """The line of a note or a warning."""
    return f"warning: {fields['text']}" if event == "warning" else str(fields["text"])


def failure_text(fields: dict[str, Any]) -> str:
    """The line of a task that failed."""
    return f"warning: {fields['stage']} {fields['key']} failed: {fields['error']}"


def start_text(stage: _Stage) -> str:
    """What a stage has before it."""
    if stage.tasks_done >= stage.tasks:
        done = "its one task was" if stage.tasks == 1 else f"all {stage.tasks} tasks were"
        return f"nothing to do, {done} done before"
    before = f" ({stage.tasks_done} of {stage.tasks} were done before)" if stage.tasks_done else ""
    points = f", {count_text(stage.points)} points" if stage.points else ""
    todo = stage.tasks - stage.tasks_done
    return f"{todo} task{'' if todo == 1 else 's'}{points}{before}"


def _stage_of(fields: dict[str, Any], now: float) -> _Stage:
    return _Stage(fields["stage"], fields["tasks"], fields.get("points", 0), fields.get("done", 0), now)


def _count(stage: _Stage, fields: dict[str, Any]) -> None:
    stage.tasks_done += 1
    stage.points_done += fields.get("points", 0)


@contextmanager
def plain_progress(stream: IO[str], clock: Callable[[], float] = time.monotonic) -> Iterator[Listener]:
    """A listener that writes lines: what a log file or a CI job can show."""
    yield _PlainLines(stream, clock)


@contextmanager
def bar_progress(stream: IO[str]) -> Iterator[Listener]:
    """A listener that draws a bar per stage with points, rate and the time that is left (rich)."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(file=stream)
    columns = (
        TextColumn("{task.description:<10}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    stages: dict[str, tuple[_Stage, TaskID]] = {}

    with Progress(*columns, console=console) as bars:

        def listen(event: str, fields: dict[str, Any]) -> None:
            if event in ("note", "warning"):
                bars.console.print(shown(message_text(event, fields)), markup=False, highlight=False)
            elif event == "task_failed" and fields["stage"] != TOLD_BY_FILE:
                bars.console.print(shown(failure_text(fields)), markup=False, highlight=False)
            elif event == "stage_started":
                stage = _stage_of(fields, time.monotonic())
                bar = bars.add_task(stage.name, total=1.0, rate="")
                bars.update(bar, completed=stage.fraction)
                stages[stage.name] = (stage, bar)
            elif event == "task_done" and fields["stage"] in stages:
                stage, bar = stages[fields["stage"]]
                _count(stage, fields)
                rate = rate_text(stage.points_done, time.monotonic() - stage.started)
                bars.update(bar, completed=stage.fraction, rate=rate)
            elif event == "stage_finished" and fields["stage"] in stages:
                bars.update(stages[fields["stage"]][1], completed=1.0)

        yield listen


@contextmanager
def open_progress(stream: IO[str], quiet: bool = False) -> Iterator[Listener]:
    """The listener that fits a stream: bars on a terminal, lines elsewhere, only trouble when quiet.

    Parameters
    ----------
    stream : text stream
        Where to write; stderr, as results go to stdout.
    quiet : bool
        Only warnings and failures.
    """
    if quiet:
        with plain_progress(stream) as listener:
            yield _only(listener, "warning", "task_failed")
    elif stream.isatty():
        with bar_progress(stream) as listener:
            yield listener
    else:
        with plain_progress(stream) as listener:
            yield listener


def _only(listener: Listener, *names: str) -> Listener:
    def listen(event: str, fields: dict[str, Any]) -> None:
        if event in names:
            listener(event, fields)

    return listen
