"""The whole job: how far it is, and how long it will yet take."""

from __future__ import annotations

import io
import json
from typing import Any

import pytest

from cli.main import main
from tiler.observe.json_lines import JsonLines
from tiler.observe.whole_job import WholeJob

STAGES = {"spool": 10.0, "filter0": 20.0, "filter1": 30.0, "export": 40.0}
KEYS = {"stage", "title", "done", "total", "rate", "progress", "eta", "message", "level"}


class Run:
    """Events of a job whose stages have ten tasks each, and its clock."""

    def __init__(self, *listeners: Any) -> None:
        self.now = 0.0
        self.job = WholeJob(lambda: self.now)
        self.listeners = (self.job, *listeners)
        self.tell("job_started", stages=[{"stage": k, "title": k, "seconds": s} for k, s in STAGES.items()])

    def tell(self, event: str, **fields: Any) -> None:
        for listener in self.listeners:
            listener(event, fields)

    def begin(self, stage: str, done: int = 0) -> None:
        points = 100 * (10 - done)
        self.tell("stage_started", stage=stage, title=f"the {stage}", tasks=10, done=done, points=points)

    def work(self, stage: str, tasks: int, seconds: float) -> None:
        for number in range(tasks):
            self.now += seconds / tasks
            self.tell("task_done", stage=stage, key=str(number), points=100)

    def end(self, stage: str, seconds: float) -> None:
        self.tell("stage_finished", stage=stage, seconds=seconds)


def test_a_job_at_the_expected_pace_takes_what_was_expected() -> None:
    run = Run()
    assert (run.job.fraction(), run.job.seconds_left()) == (0.0, 100.0)
    for stage, seconds in STAGES.items():
        run.begin(stage)
        run.work(stage, 5, seconds / 2)
        assert run.job.seconds_left() == pytest.approx(100 - run.now)
        assert run.job.fraction() == pytest.approx(run.now / 100)
        run.work(stage, 5, seconds / 2)
        run.end(stage, seconds)
    assert run.job.fraction() == pytest.approx(1.0)
    assert run.job.seconds_left() == pytest.approx(0.0)


def test_a_slow_machine_shows_in_the_time_left() -> None:
    run = Run()
    run.begin("spool")
    run.work("spool", 10, 30.0)
    run.end("spool", 30.0)
    left = run.job.seconds_left()
    assert left is not None
    assert 2.3 * 90 < left < 3 * 90, "three times slower than expected, which still counts a little"


def test_stages_that_are_not_needed_count_no_more() -> None:
    run = Run()
    run.tell("stages_passed_over", stages=["filter1"])
    assert run.job.seconds_left() == 70.0
    run.begin("export")  # and so neither do those before it
    assert run.job.seconds_left() == pytest.approx(40.0)
    assert run.job.fraction() == pytest.approx(30 / 70)


def test_what_earlier_runs_did_takes_no_time() -> None:
    run = Run()
    run.begin("spool", done=10)
    run.end("spool", 0.1)
    run.begin("filter0", done=5)
    assert run.job.seconds_left() == pytest.approx(10 + 30 + 40)
    assert run.job.fraction() == pytest.approx((10 + 10) / 100)


def test_the_bar_never_falls_back() -> None:
    run, seen = Run(), list[float]()
    for stage in ("spool", "filter0", "spool", "filter0", "filter1", "export"):  # the store was repaired
        run.begin(stage)
        run.work(stage, 10, 1.0)
        seen.append(run.job.fraction())
        run.end(stage, 1.0)
    assert seen == sorted(seen)


def test_lines_for_programs_have_the_same_entries() -> None:
    stream = io.StringIO()
    run = Run()
    run.listeners = (run.job, JsonLines(stream, lambda: run.now))
    run.begin("spool")
    run.work("spool", 4, 4.0)
    run.tell("warning", text="z looks like feet")
    run.end("spool", 4.0)
    lines = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert all(line.keys() == KEYS for line in lines)
    assert [line["done"] for line in lines] == [0, 100, 200, 300, 400, 400, 400]
    assert {line["total"] for line in lines} == {1000}
    assert lines[4] | {"eta": 0, "progress": 0} == {
        "stage": "spool",
        "title": "the spool",
        "done": 400,
        "total": 1000,
        "rate": 100.0,
        "progress": 0,
        "eta": 0,
        "message": None,
        "level": "info",
    }
    assert [line["message"] for line in lines if line["level"] == "warning"] == ["z looks like feet"]


def test_an_error_is_a_line_for_programs_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "nowhere.laz", "-o", "out", "--progress", "json"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    found = json.loads(line)
    assert found["level"] == "error"
    assert found["message"].startswith("tiler: error: nowhere.laz: no such file")
