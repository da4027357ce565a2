"""Estimates of the progress of a whole job and of the time left, from its events.

A run that is one of several in a job has a listener that makes its events those of the job.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from tiler.observe.events import (
    Event,
    ExpectedStage,
    JobStarted,
    Listener,
    RunFinished,
    StageFinished,
    StagesPassedOver,
    StageStarted,
    TaskDone,
    TaskFailed,
)

OWN_SHARE = 0.03
"""Share of the job from which only the pace of this run counts. Before, the expected pace
counts as well."""

MIN_SHARE_LEFT = 0.1
"""Minimum share of a stage's remaining time that is shown while one of its tasks takes longer
than expected."""


EARLY = ("spool", "surveys", "assemble", "filter")
"""Prefixes of stages that the first run does for the others."""


@dataclass
class StageProgress:
    """Progress of a stage, measured in points or pixels if their number is known, and in tasks if not.

    Attributes
    ----------
    event : StageStarted
        Start of the stage. Its points and pixels are those of tasks that earlier runs did not do.
    started : float
        Time of the start by the clock of the listener.
    last_end : float
        Time of the end of the last task, or of the start of the stage, by the clock of the listener.
    tasks_done : int
        Number of tasks that are done, in this run or before.
    points_done, pixels_done : int
        Numbers of points and pixels that this run did.
    """

    event: StageStarted
    started: float
    last_end: float
    tasks_done: int
    points_done: int = 0
    pixels_done: int = 0

    def count(self, event: TaskDone, now: float) -> None:
        """Count a task that is done."""
        self.tasks_done += 1
        self.points_done += event.points
        self.pixels_done += event.pixels
        self.last_end = now

    @property
    def work(self) -> int:
        """Number of points and pixels that measure this run's work, or 0 if it is measured in tasks."""
        return self.event.points + (self.event.pixels if self.event.by_pixels else 0)

    @property
    def work_done(self) -> int:
        """Part of `work` that is done."""
        return self.points_done + (self.pixels_done if self.event.by_pixels else 0)

    @property
    def spent(self) -> float:
        """Time from the start of the stage to the end of its last task, in seconds."""
        return self.last_end - self.started

    @property
    def fraction(self) -> float:
        """Share of this run's work that is done, 0 to 1."""
        if self.work > 0:
            return min(self.work_done / self.work, 1.0)
        todo = self.event.tasks - self.event.done
        return 1.0 if todo == 0 else min((self.tasks_done - self.event.done) / todo, 1.0)

    @property
    def remaining_share(self) -> float:
        """Share of the tasks that earlier runs did not do."""
        return 1 - self.event.done / self.event.tasks if self.event.tasks else 0.0

    def rate(self, seconds: float) -> float | None:
        """Return work per second, or tasks if `work` is not counted, or None before the first."""
        done = self.work_done if self.work else self.tasks_done - self.event.done
        return done / seconds if done and seconds > 0 else None


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
                now = self._clock()
                self.stage = StageProgress(event, now, now, event.done)
                keys = list(self._expected)
                # Earlier stages that did not run are not needed.
                if event.stage in self._expected:
                    self._ended.update(keys[: keys.index(event.stage)])
            case TaskDone() if self.stage is not None and self.stage.event.stage == event.stage:
                self.stage.count(event, self._clock())
            case StageFinished() if (
                self.stage is not None and self.stage.event.stage == event.stage
            ):
                self._end(self.stage, event.seconds)

    def _end(self, stage: StageProgress, seconds: float) -> None:
        if self._expected_of(stage) > 0:
            self._seen_seconds += seconds
            self._seen_expected += self._expected_of(stage)
        self._ended.add(stage.event.stage)
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
        done = self._ended if stage is None else self._ended | {stage.event.stage}
        later = sum(seconds for key, seconds in self._expected.items() if key not in done)
        return self._pace() * later + (0.0 if stage is None else self._stage_left(stage))

    def _done_share(self) -> float:
        """Return the share of the job that is done, from its finished tasks."""
        total = sum(self._expected.values())
        if not total:
            return 0.0
        done = sum(seconds for key, seconds in self._expected.items() if key in self._ended)
        if self.stage is not None and self.stage.event.stage not in self._ended:
            # The share of the stage includes the work of earlier runs.
            stage_share = 1 - self.stage.remaining_share * (1 - self.stage.fraction)
            done += self._expected.get(self.stage.event.stage, 0.0) * stage_share
        return min(done / total, 1.0)

    def _expected_of(self, stage: StageProgress) -> float:
        """Return the expected time for this run's part of a stage, in seconds."""
        return self._expected.get(stage.event.stage, 0.0) * stage.remaining_share

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
        return (self._clock() - stage.started) * (1 - stage.fraction) / stage.fraction


def stages_of(name: str, stages: Sequence[ExpectedStage]) -> list[ExpectedStage]:
    """Return the stages of a later run without those that the first run does, with keys that have its name."""
    return [
        {**stage, "stage": f"{name} {stage['stage']}"}
        for stage in stages
        if not stage["stage"].startswith(EARLY)
    ]


class OneOfSeveral:
    """Listener that tells another one about a run as a part of a job.

    Parameters
    ----------
    listener : callable
    name : str
        Name of the run, or an empty text for the first one, with which the job starts.
    later : sequence of ExpectedStage
        Stages of all later runs of the job (`stages_of`).
    is_last : bool
        Whether the job ends with this run.
    """

    def __init__(
        self, listener: Listener, name: str, later: Sequence[ExpectedStage], is_last: bool
    ) -> None:
        self._listener, self._name, self._is_last = listener, name, is_last
        self._later = later
        self._known: Collection[str] = {stage["stage"] for stage in later}

    def __call__(self, event: Event) -> None:
        """Handle an event."""
        match event:
            case JobStarted():
                if not self._name:
                    self._listener(JobStarted([*event.stages, *self._later]))
            case RunFinished() if not self._is_last:
                pass
            case StageStarted() | TaskDone() | StageFinished() | TaskFailed():
                self._listener(replace(event, stage=self._key(event.stage)))
            case StagesPassedOver():
                self._listener(StagesPassedOver([self._key(stage) for stage in event.stages]))
            case _:
                self._listener(event)

    def _key(self, stage: str) -> str:
        key = f"{self._name} {stage}"
        return key if key in self._known else stage
