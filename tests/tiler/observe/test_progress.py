"""Progress on a terminal and elsewhere."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tiler.observe.events import (
    Detail,
    Event,
    JobStarted,
    Note,
    StageFinished,
    StageStarted,
    TaskDone,
    TaskFailed,
    Warned,
    combine,
    redacting,
)
from tiler.observe.job_progress import JobProgress
from tiler.observe.json_lines import progress_record
from tiler.observe.progress import (
    PlainLines,
    bar_progress,
    count_text,
    duration_text,
    open_progress,
    rate_text,
    size_text,
)


class Clock:
    """A clock that moves only when the test says so."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Terminal(io.StringIO):
    """A stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


STARTED = StageStarted("filter", "filter", tasks=4, points=4_000_000)


def task(key: str, points: int = 1_000_000) -> TaskDone:
    return TaskDone("filter", key, points=points, seconds=1.0, peak_rss_bytes=1)


@pytest.mark.parametrize(
    ("text_of", "texts"),
    [
        (
            count_text,
            {
                0: "0",
                870: "870",
                1_000: "1.0 k",
                12_345: "12.3 k",
                10_653_336: "10.7 M",
                2.5e9: "2.5 G",
            },
        ),
        (
            duration_text,
            {4.23: "4.2 s", 59.9: "59.9 s", 60: "1:00 min", 205: "3:25 min", 3727: "1:02:07 h"},
        ),
        (size_text, {10: "10 bytes", 1536: "1.5 KiB", 3 << 30: "3.0 GiB"}),
    ],
)
def test_figures_are_short(text_of: Callable[[float], str], texts: dict[float, str]) -> None:
    assert {value: text_of(value) for value in texts} == texts


def test_no_rate_without_points_or_time() -> None:
    assert rate_text(0, 3.0) == rate_text(5, 0.0) == ""
    assert rate_text(3_000_000, 2.0) == "1.5 M points/s"


def test_plain_lines_come_at_begin_and_end_and_now_and_then() -> None:
    stream, clock = io.StringIO(), Clock()
    listen = PlainLines(stream, clock)
    listen(STARTED)
    clock.now += 5
    listen(task("a"))
    clock.now += 15
    listen(task("b"))
    clock.now += 20
    listen(StageFinished("filter", 40.0))
    assert stream.getvalue().splitlines() == [
        "filter: 4 tasks, 4.0 M points",
        "filter: 50%, 100.0 k points/s, about 20.0 s left",
        "filter: done in 40.0 s, 50.0 k points/s",
    ]


@pytest.mark.parametrize(
    ("done", "seconds", "text"),
    [
        (9, 0.01, ""),
        (6, 0.9, ""),
        (6, 1.0, "grid: 3 tasks, 10 points (6 of 9 were done before), done in 1.0 s\n"),
    ],
)
def test_a_stage_has_a_line_if_it_took_a_second(done: int, seconds: float, text: str) -> None:
    stream = io.StringIO()
    listen = PlainLines(stream)
    listen(StageStarted("grid", "grid", tasks=9, points=10, done=done))
    listen(StageFinished("grid", seconds))
    assert stream.getvalue() == text


def test_rates_are_of_pixels_where_pixels_are_made() -> None:
    stream, clock = io.StringIO(), Clock()
    listen = PlainLines(stream, clock)
    listen(replace(STARTED, pixels=1_000_000, tasks=1))
    clock.now += 2
    listen(replace(task("a"), pixels=1_000_000))
    listen(StageFinished("filter", 2.0))
    assert (
        stream.getvalue() == "filter: 1 task, 4.0 M points, done in 2.0 s, 500.0 k pixels/s\n"
    )


@pytest.mark.parametrize(
    ("points", "counts", "rate"),
    [(0, "", ", 1.5 M pixels/s"), (1_000_000, "1.0 M points, ", "")],
)
def test_a_stage_that_writes_rasters_counts_their_pixels(
    points: int, counts: str, rate: str
) -> None:
    stream, clock = io.StringIO(), Clock()
    job, listen = JobProgress(clock), PlainLines(stream, clock)
    n_tasks = 2 if points else 1
    begin = StageStarted("export", "write", n_tasks, 0, points, 3_000_000, by_pixels=True)
    for listener in (job, listen):
        listener(begin)
    clock.now += 2
    raster = TaskDone("export", "dtm.tif", pixels=3_000_000, seconds=2.0)
    for listener in (job, listen):
        listener(raster)
    assert job.stage is not None
    assert job.stage.fraction == 3_000_000 / (3_000_000 + points)
    record = progress_record(job=job, now=clock.now)
    assert (record["done"], record["total"]) == (3_000_000, 3_000_000 + points)
    listen(StageFinished("export", 2.0))
    tasks = "2 tasks" if points else "1 task"
    assert stream.getvalue() == f"write: {tasks}, {counts}3.0 M pixels, done in 2.0 s{rate}\n"


def test_a_stage_of_a_few_seconds_has_one_line() -> None:
    stream, clock = io.StringIO(), Clock()
    listen = PlainLines(stream, clock)
    for _ in range(20):
        listen(STARTED)
        for key in "abcd":
            clock.now += 1.1
            listen(task(key))
        listen(StageFinished("filter", 4.4))
    assert len(stream.getvalue().splitlines()) == 20


def test_a_long_run_without_lines_about_stages_gives_signs_of_life() -> None:
    stream, clock = io.StringIO(), Clock()
    listen = PlainLines(stream, clock, stages=False)
    listen(JobStarted([{"stage": "filter", "title": "filter", "seconds": 4000.0}]))
    listen(STARTED)
    for key, seconds in (("a", 599.0), ("b", 2.0), ("c", 598.0)):
        clock.now += seconds
        listen(task(key))
    (line,) = stream.getvalue().splitlines()
    assert re.fullmatch(
        r"\d\d:\d\d filter: 50%, 3.3 k points/s, whole job 50%, about 10:01 min left", line
    )
    listen(Note("a decision"))
    clock.now += 599
    listen(StageFinished("filter", 1798.0))
    assert stream.getvalue().splitlines() == [line, "a decision"]


def test_quiet_shows_only_trouble() -> None:
    stream = io.StringIO()
    with open_progress(stream, quiet=True) as listen:
        listen(Note("all is well"))
        listen(STARTED)
        listen(Warned("z looks like feet"))
        listen(TaskFailed("filter", "filter", "t+1", "disk full"))
    assert (
        stream.getvalue()
        == "warning: z looks like feet\nwarning: filter t+1 failed: disk full\n"
    )


def test_of_many_warnings_of_a_kind_three_are_shown_and_the_others_counted() -> None:
    rivers = [f"river {n} at ({n}.5, 7.0) is water with 4{n} % certainty" for n in range(9)]
    files = [f"/in put/{letter}.laz: left out: cut short" for letter in "abcd"]
    warnings = [*rivers[:4], *files, *rivers[4:], "z looks like feet"]

    def lines(**options: Any) -> list[str]:
        stream = io.StringIO()
        with open_progress(stream, **options) as listen:
            for text in warnings:
                listen(Warned(text))
        return stream.getvalue().splitlines()

    few = lines()
    assert lines(quiet=True) == few
    assert len(few) == 3 + 3 + 1 + 2
    more = "like this one (-v prints all, and run.json of a run has all)"
    assert few[-2:] == [
        f"warning: 6 more warnings are {more}: {rivers[3]}",
        f"warning: one more warning is {more}: {files[3]}",
    ]
    assert len(lines(verbose=True)) == len(lines(form="json")) == 14


def test_bars_on_a_terminal_only() -> None:
    plain, terminal = io.StringIO(), Terminal()
    for stream in (plain, terminal):
        with open_progress(stream) as listen:
            listen(Note("pixels of [1 m]"))
            listen(STARTED)
            listen(task("a", 4_000_000))
            listen(StageFinished("filter", 1.0))
    assert "\x1b" not in plain.getvalue()
    assert "\x1b" in terminal.getvalue()
    assert "100.0 %" in terminal.getvalue()
    assert plain.getvalue() == "pixels of [1 m]\n"
    assert "pixels of [1 m]" in terminal.getvalue(), "markup of rich must not eat brackets"


@pytest.mark.parametrize(
    ("form", "verbose", "lines"),
    [
        ("auto", False, ["a note"]),
        (
            "auto",
            True,
            ["a note", "a detail", "filter: 1 task, done in 2.0 s, 500.0 k points/s"],
        ),
        ("plain", False, ["a note", "filter: 1 task, done in 2.0 s, 500.0 k points/s"]),
        ("none", True, ["a note", "a detail"]),
    ],
)
def test_stages_and_details_are_shown_on_request(
    form: str, verbose: bool, lines: list[str]
) -> None:
    stream = io.StringIO()
    with open_progress(stream, form=form, verbose=verbose) as listen:
        listen(Note("a note"))
        listen(Detail("a detail"))
        listen(StageStarted("filter", "filter", tasks=1))
        listen(task("a"))
        listen(StageFinished("filter", 2.0))
    assert stream.getvalue().splitlines() == lines


def test_bar_of_an_empty_stage_is_full() -> None:
    stream = Terminal()
    with bar_progress(stream) as listen:
        listen(StageStarted("grid", "grid", tasks=0))
        listen(TaskFailed("grid", "grid", "r0", "none"))
    assert "100.0 %" in stream.getvalue()


def test_combined_listeners_receive_all_events_in_order() -> None:
    heard: list[tuple[int, Event]] = []
    listen = combine(
        lambda event: heard.append((1, event)), lambda event: heard.append((2, event))
    )
    first, second = Note("a"), Warned("b")
    listen(first)
    listen(second)
    assert heard == [(1, first), (2, first), (1, second), (2, second)]


def test_secrets_do_not_reach_a_listener() -> None:
    heard: list[Event] = []
    redacting(heard.append)(Warned("https://anna:secret@host/a.laz?token=1: cut short"))
    redacting(heard.append)(
        JobStarted([{"stage": "s", "title": "ftp://a:b@c/", "seconds": 1.0}])
    )
    assert heard == [
        Warned("https://host/a.laz: cut short"),
        JobStarted([{"stage": "s", "title": "ftp://c/", "seconds": 1.0}]),
    ]


def test_values_of_an_event_have_the_order_of_the_log() -> None:
    counts = ["tasks", "done", "points", "pixels", "by_pixels"]
    assert list(STARTED.to_json()) == ["stage", "title", *counts]
    assert StageFinished("grid", 2.5).to_json() == {"stage": "grid", "seconds": 2.5}


def test_a_failed_file_is_reported_once_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    with open_progress(sys.stderr, quiet=True) as listener:
        listener(TaskFailed("spool", "read", "s000000-0", "a.laz: cut short"))
        listener(Warned("a.laz: left out: cut short"))
    assert capsys.readouterr().err == "warning: a.laz: left out: cut short\n"
