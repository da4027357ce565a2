"""Estimates of the progress of a whole job and of the time left, from its events."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from tiler.observe.events import (
    Event,
    JobStarted,
    StageFinished,
    StagesPassedOver,
    StageStarted,
    TaskDone,
)

OWN_SHARE = 0.03
"""Share of the job from which only the pace of this run counts. Before, the expected pace
counts as well."""

MIN_SHARE_LEFT = 0.1
"""Minimum share of a stage's remaining time that is shown while one of its tasks takes longer
than expected."""


@dataclass
class StageProgress:
    """Progress of a stage, measured in points or pixels if their number is known, and in tasks if not.

    Attributes
    ----------
    key, title : str
    tasks : int
        Number of all tasks.
    points : int
        Number of points in the tasks that earlier runs did not do.
    tasks_done : int
        Number of tasks that are done, in this run or before.
    started : float
        Time of the start by the clock of the listener.
    before : int
        Number of tasks that earlier runs did.
    points_done : int
        Number of points that this run did.
    pixels, pixels_done : int
        Number of pixels that this run makes, and that it has made so far.
    by_pixels : bool
        Whether the work is measured in pixels as well.
    last_end : float
        Time of the end of the last task, or of the start of the stage, by the clock of the listener.
    """

    key: str
    title: str
    tasks: int
    points: int
    tasks_done: int
    started: float
    before: int = 0
    points_done: int = 0
    pixels: int = 0
    pixels_done: int = 0
    by_pixels: bool = False
    last_end: float = 0.0

    @classmethod
    def at_start(cls, event: StageStarted, now: float) -> StageProgress:
        """Return the progress of a stage that begins."""
        return cls(
            key=event.stage,
            title=event.title,
            tasks=event.tasks,
            points=event.points,
            tasks_done=event.done,
            started=now,
            before=event.done,
            pixels=event.pixels,
            by_pixels=event.by_pixels,
            last_end=now,
        )

    def count(self, event: TaskDone, now: float) -> None:
        """Count a task that is done."""
        self.tasks_done += 1
        self.points_done += event.points
        self.pixels_done += event.pixels
        self.last_end = now

    @property
    def work(self) -> int:
        """Number of points and pixels that measure this run's work, or 0 if it is measured in tasks."""
        return self.points + (self.pixels if self.by_pixels else 0)

    @property
    def work_done(self) -> int:
        """Part of `work` that is done."""
        return self.points_done + (self.pixels_done if self.by_pixels else 0)

    @property
    def spent(self) -> float:
        """Time from the start of the stage to the end of its last task, in seconds."""
        return self.last_end - self.started

    @property
    def fraction(self) -> float:
        """Share of this run's work that is done, 0 to 1."""
        if self.work > 0:
            return min(self.work_done / self.work, 1.0)
        todo = self.tasks - self.before
        if todo == 0:
            return 1.0
        return min((self.tasks_done - self.before) / todo, 1.0)

    @property
    def remaining_share(self) -> float:
        """Share of the tasks that earlier runs did not do."""
        if self.tasks == 0:
            return 0.0
        return 1 - self.before / self.tasks

    def rate(self, seconds: float) -> float | None:
        """Return work per second, or tasks if `work` is not counted, or None before the first."""
        done = self.work_done if self.work else self.tasks_done - self.before
        if not done or seconds <= 0:
            return None
        return done / seconds


class JobProgress:
    """Listener that estimates the progress of a job.

    The weight of a stage is its expected time in seconds, from the rates of earlier runs. The
    time left is the expected time, multiplied by the ratio of measured to expected time of the
    work that is done. Once `OWN_SHARE` of the job is done, only this run determines that ratio,
    since the rates of a busy machine may be wrong by a factor of six. Between the ends of tasks
    the done share grows with time.

    Parameters
    ----------
    clock : callable
        Function that returns the time in seconds.

    Attributes
    ----------
    stage : StageProgress or None
        Running stage.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._expected: dict[str, float] = {}
        self._ended: set[str] = set()
        self._seen_seconds = 0.0
        self._seen_expected = 0.0
        self._furthest = 0.0
        self._looked = clock()
        self.stage: StageProgress | None = None

    @property
    def known(self) -> bool:
        """Whether the stages of the job are known."""
        return bool(self._expected)

    def __call__(self, event: Event) -> None:
        """Handle an event."""
        match event:
            case JobStarted():
                self._expected = {stage["stage"]: stage["seconds"] for stage in event.stages}
                self._ended = set()
                self._furthest = 0.0
                self._looked = self._clock()
            case StagesPassedOver():
                for key in event.stages:
                    self._expected.pop(key, None)
            case StageStarted():
                self.stage = StageProgress.at_start(event, self._clock())
                keys = list(self._expected)
                # Earlier stages that did not run are not needed.
                if self.stage.key in self._expected:
                    self._ended.update(keys[: keys.index(self.stage.key)])
            case TaskDone() if self.stage is not None and self.stage.key == event.stage:
                self.stage.count(event, self._clock())
            case StageFinished() if self.stage is not None and self.stage.key == event.stage:
                self._end(self.stage, event.seconds)

    def _end(self, stage: StageProgress, seconds: float) -> None:
        if self._expected_of(stage) > 0:
            self._seen_seconds += seconds
            self._seen_expected += self._expected_of(stage)
        self._ended.add(stage.key)
        self.stage = None

    def fraction(self) -> float:
        """Return the share of the job that is done, 0 to 1. It never decreases, and it grows with time."""
        now = self._clock()
        left = self.seconds_left()
        passed = now - self._looked
        self._looked = now
        if left is not None and left > 0:  # The rest of the bar fills in the time left.
            self._furthest += (1 - self._furthest) * passed / (passed + left)
        self._furthest = max(self._furthest, self._done_share())
        return self._furthest

    def seconds_left(self) -> float | None:
        """Return the time left for the job in seconds, or for the running stage if the job is not known.

        The result is None if there is no estimate.
        """
        stage = self.stage
        if not self.known:
            return None if stage is None else self._own_left(stage)
        later = dict(self._expected)
        for key in self._ended:
            later.pop(key, None)
        if stage is None:
            return self._pace() * sum(later.values())
        later.pop(stage.key, None)
        return self._pace() * sum(later.values()) + self._stage_left(stage)

    def _done_share(self) -> float:
        """Return the share of the job that is done, from its finished tasks."""
        total = sum(self._expected.values())
        if not total:
            return 0.0
        done = sum(seconds for key, seconds in self._expected.items() if key in self._ended)
        if self.stage is not None and self.stage.key not in self._ended:
            # The share of the stage includes the work of earlier runs.
            stage_share = 1 - self.stage.remaining_share * (1 - self.stage.fraction)
            done += self._expected.get(self.stage.key, 0.0) * stage_share
        return min(done / total, 1.0)

    def _expected_of(self, stage: StageProgress) -> float:
        """Return the expected time for this run's part of a stage, in seconds."""
        return self._expected.get(stage.key, 0.0) * stage.remaining_share

    def _pace(self) -> float:
        """Return the ratio of measured to expected time."""
        seconds = self._seen_seconds
        expected = self._seen_expected
        if (
            self.stage is not None
            and self._expected_of(self.stage) > 0
            and self.stage.fraction > 0
        ):
            seconds += self.stage.spent
            expected += self._expected_of(self.stage) * self.stage.fraction
        if expected <= 0:
            return 1.0
        own = min(expected / (OWN_SHARE * sum(self._expected.values())), 1.0)
        return own * seconds / expected + (1 - own)

    def _stage_left(self, stage: StageProgress) -> float:
        """Return the time left for the running stage. The more of it is done, the more its own pace counts."""
        expected = self._expected_of(stage)
        if expected <= 0:
            return self._own_left(stage) or 0.0
        done = stage.fraction
        pace = self._pace()
        if done > 0:
            pace = done * stage.spent / (expected * done) + (1 - done) * pace
        left = pace * expected * (1 - done)
        return max(left - (self._clock() - stage.last_end), MIN_SHARE_LEFT * left)

    def _own_left(self, stage: StageProgress) -> float | None:
        """Return the time left for a stage without an expected time, from its own pace.

        The result is None before its first task is done.
        """
        if stage.fraction <= 0:
            return None
        spent = self._clock() - stage.started
        return spent * (1 - stage.fraction) / stage.fraction
