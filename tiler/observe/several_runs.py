"""Listener of a run that is one of several in a job."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

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

EARLY = ("spool", "surveys", "assemble", "filter")
"""Prefixes of stages that the first run does for the others."""


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
