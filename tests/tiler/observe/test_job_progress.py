"""The whole job: its progress and the time left."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest

from cli.main import main
from tiler.observe.events import (
    Event,
    JobStarted,
    StageFinished,
    StagesPassedOver,
    StageStarted,
    TaskDone,
    Warned,
)
from tiler.observe.job_progress import JobProgress
from tiler.observe.json_lines import JsonLines

STAGES = {"spool": 10.0, "filter0": 20.0, "filter1": 30.0, "export": 40.0}
KEYS = {"stage", "title", "done", "total", "rate", "progress", "eta", "message", "level"}


class Run:
    """Events of a job whose stages have ten tasks each, and its clock."""

    def __init__(self, *listeners: Any) -> None:
        self.now = 0.0
        self.job = JobProgress(lambda: self.now)
        self.listeners = (self.job, *listeners)
        self.tell(
            JobStarted([{"stage": k, "title": k, "seconds": s} for k, s in STAGES.items()])
        )

    def tell(self, event: Event) -> None:
        for listener in self.listeners:
            listener(event)

    def begin(self, stage: str, done: int = 0) -> None:
        points = 100 * (10 - done)
        self.tell(StageStarted(stage, f"the {stage}", tasks=10, done=done, points=points))

    def work(self, stage: str, tasks: int, seconds: float) -> None:
        for number in range(tasks):
            self.now += seconds / tasks
            self.tell(TaskDone(stage, str(number), points=100))

    def end(self, stage: str, seconds: float) -> None:
        self.tell(StageFinished(stage, seconds))


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
    assert left == pytest.approx(3 * 90)
    assert run.job.fraction() < 0.4


@pytest.mark.parametrize("pace", [1 / 6, 0.4, 1.0, 2.5, 6.0])
@pytest.mark.parametrize("seed", range(4))
def test_after_a_tenth_the_time_left_is_right_within_a_third(pace: float, seed: int) -> None:
    """Rates may come from a busy machine; stages differ by 15 % from one another, tasks by a factor of four."""
    rng = np.random.default_rng(seed)
    of_tasks = {stage: rng.uniform(0.5, 2, 40) for stage in STAGES}
    times = {
        stage: pace * rng.uniform(0.85, 1.15) * STAGES[stage] * share / share.sum()
        for stage, share in of_tasks.items()
    }
    whole, run, checked = sum(map(np.sum, times.values())), Run(), 0
    for stage, seconds in times.items():
        run.tell(StageStarted(stage, stage, tasks=40, points=4000))
        for number, duration in enumerate(seconds):
            run.now += duration
            run.tell(TaskDone(stage, str(number), points=100))
            if run.now > 0.1 * whole:
                left = run.job.seconds_left()
                assert left is not None
                assert abs(run.now + left - whole) < whole / 3
                checked += 1
        run.end(stage, seconds.sum())
    assert checked > 100


def test_the_runs_own_pace_counts_from_the_first_tasks_on() -> None:
    run = Run()
    run.begin("spool")
    run.work("spool", 3, 0.5)  # six times quicker; 3 % of the job
    assert run.job.seconds_left() == pytest.approx(97 / 6, rel=0.05)
    half = Run()
    half.begin("spool")
    half.tell(TaskDone("spool", "0", points=100))  # 1 % of the job, in no time
    left = half.job.seconds_left()
    assert left is not None
    assert 50 < left < 90


@pytest.mark.parametrize("pace", [0.3, 1.0, 4.0])
def test_the_bar_moves_while_time_goes_by(pace: float) -> None:
    """Looked at each 5 s: in a stage of one long task, of many, and between stages."""
    run, seen = Run(), [0.0]

    def wait(seconds: float) -> None:
        for _ in range(int(seconds // 5)):
            run.now += 5
            seen.append(run.job.fraction())

    for stage, tasks in (("spool", 1), ("filter0", 4), ("filter1", 1), ("export", 2)):
        run.tell(StageStarted(stage, stage, tasks=tasks, points=0))
        started = run.now
        for number in range(tasks):
            wait(STAGES[stage] * pace * 3 / tasks)
            run.tell(TaskDone(stage, str(number), points=0))
        run.end(stage, run.now - started)
        if stage != "export":
            wait(15)  # flaws in the terrain are looked for, which is no stage
    steps = np.diff(seen)
    assert (steps > 0).all()
    assert seen[-1] <= 1


def test_stages_that_are_not_needed_count_no_more() -> None:
    run = Run()
    run.tell(StagesPassedOver(["filter1"]))
    assert run.job.seconds_left() == 70.0
    run.begin("export")  # so the stages before it are not needed either
    assert run.job.seconds_left() == pytest.approx(40.0)
    assert run.job.fraction() == pytest.approx(30 / 70)


def test_work_of_earlier_runs_takes_no_time() -> None:
    run = Run()
    run.begin("spool", done=10)
    run.end("spool", 0.1)
    run.begin("filter0", done=5)
    assert run.job.seconds_left() == pytest.approx(10 + 30 + 40)
    assert run.job.fraction() == pytest.approx((10 + 10) / 100)


def test_the_bar_never_falls_back() -> None:
    run, seen = Run(), list[float]()
    # the store was repaired
    for stage in ("spool", "filter0", "spool", "filter0", "filter1", "export"):
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
    run.tell(Warned("z looks like feet"))
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
    assert [line["message"] for line in lines if line["level"] == "warning"] == [
        "z looks like feet"
    ]


def test_an_error_is_a_line_for_programs_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "nowhere.laz", "-o", "out", "--progress", "json"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    found = json.loads(line)
    assert found["level"] == "error"
    assert found["message"].startswith("tiler: error: nowhere.laz: no such file")
