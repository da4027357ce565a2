"""How far a whole job is, and how long it will yet take, from its events."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

PRIOR_SHARE = 0.05
"""How much what was expected counts against what was seen of this run's pace, as a share of the whole job."""

LEAST_LEFT = 0.1
"""Share of a stage's time that is left at least, while its tasks do not say that it is further."""


@dataclass
class StageState:
    """How far a stage is. Points are counted where the stage says how many there are, else tasks.

    Attributes
    ----------
    key, title : str
    tasks, points : int
        Tasks in all, and points of those that were not done before.
    tasks_done : int
        Those of earlier runs as well.
    started : float
        By the clock of whoever watches.
    before : int
        Tasks that earlier runs did.
    """

    key: str
    title: str
    tasks: int
    points: int
    tasks_done: int
    started: float
    before: int = 0
    points_done: int = 0

    @classmethod
    def of(cls, fields: dict[str, Any], now: float) -> StageState:
        """That of the event ``stage_started``."""
        done, key = fields.get("done", 0), fields["stage"]
        title = fields.get("title", key)
        return cls(key, title, fields["tasks"], fields.get("points", 0), done, now, done)

    def count(self, fields: dict[str, Any]) -> None:
        """Take in the event ``task_done``."""
        self.tasks_done += 1
        self.points_done += fields.get("points", 0)

    @property
    def fraction(self) -> float:
        """The done part of what is left to do, 0 to 1."""
        if self.points > 0:
            return min(self.points_done / self.points, 1.0)
        todo = self.tasks - self.before
        return min((self.tasks_done - self.before) / todo, 1.0) if todo else 1.0

    @property
    def todo_share(self) -> float:
        """Share of the tasks that earlier runs left."""
        return 1 - self.before / self.tasks if self.tasks else 0.0

    def rate(self, seconds: float) -> float | None:
        """Points, or tasks where points are not counted, a second; None before the first."""
        done = self.points_done if self.points else self.tasks_done - self.before
        return done / seconds if done and seconds > 0 else None


class WholeJob:
    """A listener that knows how far the job is.

    Each stage weighs the seconds that it is expected to take, from the rates of earlier runs. What is left of those to
    come is what was expected of them, times how much slower or faster those before them were than expected.

    Parameters
    ----------
    clock : callable

    Attributes
    ----------
    stage : StageState or None
        At work.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._expected: dict[str, float] = {}
        self._ended: set[str] = set()
        self._seen_seconds = self._seen_expected = self._furthest = 0.0
        self.stage: StageState | None = None

    @property
    def known(self) -> bool:
        """Whether the job has said which stages it has."""
        return bool(self._expected)

    def __call__(self, event: str, fields: dict[str, Any]) -> None:
        """Take in an event."""
        if event == "job_started":
            self._expected = {stage["stage"]: stage["seconds"] for stage in fields["stages"]}
            self._ended, self._furthest = set(), 0.0
        elif event == "stages_passed_over":
            self._expected = {k: s for k, s in self._expected.items() if k not in fields["stages"]}
        elif event == "stage_started":
            self.stage = StageState.of(fields, self._clock())
            keys = list(self._expected)
            if self.stage.key in self._expected:  # those before it that were not done do not apply
                self._ended.update(keys[: keys.index(self.stage.key)])
        elif event == "task_done" and self.stage is not None and self.stage.key == fields["stage"]:
            self.stage.count(fields)
        elif event == "stage_finished" and self.stage is not None and self.stage.key == fields["stage"]:
            if self.stage.todo_share > 0:
                self._seen_seconds += fields.get("seconds", self._clock() - self.stage.started)
                self._seen_expected += self._expected_of(self.stage)
            self._ended.add(self.stage.key)
            self.stage = None

    def fraction(self) -> float:
        """The done part of the job, 0 to 1; it never falls."""
        total = sum(self._expected.values())
        done = sum(seconds for key, seconds in self._expected.items() if key in self._ended)
        if self.stage is not None and self.stage.key not in self._ended:
            done += self._expected.get(self.stage.key, 0.0) * self._stage_share()
        self._furthest = max(self._furthest, min(done / total, 1.0) if total else 0.0)
        return self._furthest

    def seconds_left(self) -> float | None:
        """Of the whole job; of the stage at work where no job is known; None where nothing can be said."""
        if not self.known:
            return self._stage_left(None) if self.stage is not None else None
        now = None if self.stage is None else self.stage.key
        later = sum(s for key, s in self._expected.items() if key not in self._ended and key != now)
        left = self._pace() * later
        if self.stage is not None:
            left += self._stage_left(self._pace() * self._expected_of(self.stage)) or 0.0
        return left

    def _stage_share(self) -> float:
        """The done part of the stage at work, with what earlier runs did."""
        return 0.0 if self.stage is None else 1 - self.stage.todo_share * (1 - self.stage.fraction)

    def _expected_of(self, stage: StageState) -> float:
        """Seconds that were expected of what this run does of a stage."""
        return self._expected.get(stage.key, 0.0) * stage.todo_share

    def _pace(self) -> float:
        """How many times longer than expected things take."""
        prior = PRIOR_SHARE * sum(self._expected.values())
        expected = self._seen_expected + prior
        return (self._seen_seconds + prior) / expected if expected > 0 else 1.0

    def _stage_left(self, expected: float | None) -> float | None:
        """Seconds of the stage at work: the more of it is done, the more its own pace counts."""
        stage = self.stage
        if stage is None:
            return None
        spent, done = self._clock() - stage.started, stage.fraction
        own = spent * (1 - done) / done if done > 0 else None
        if expected is None or own is None:
            guess = None if expected is None else max(expected - spent, LEAST_LEFT * expected)
            return own if guess is None else guess
        return done * own + (1 - done) * max(expected - spent, LEAST_LEFT * expected * (1 - done))
