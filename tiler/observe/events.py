"""Events of a run, and functions that combine their listeners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypedDict

from tiler.redaction import stored


@dataclass(frozen=True)
class Event:
    """Something that happens in a run. All values are JSON-able.

    Attributes
    ----------
    name : str
        Name of the kind of event in events.jsonl.
    """

    name: ClassVar[str]

    def to_json(self) -> dict[str, Any]:
        """Return the values by name, in the order in which events.jsonl has them."""
        return dict(vars(self))


@dataclass(frozen=True)
class Note(Event):
    """A note for the user."""

    name = "note"
    text: str


@dataclass(frozen=True)
class Detail(Note):
    """A note that people see only with ``-v``: it is of little weight, or an earlier run has shown it."""


@dataclass(frozen=True)
class Warned(Event):
    """A warning for the user."""

    name = "warning"
    text: str


class ExpectedStage(TypedDict):
    """Key and title of a stage that a job will run, and the expected time in seconds."""

    stage: str
    title: str
    seconds: float


@dataclass(frozen=True)
class JobStarted(Event):
    """A job begins, with the stages that it is expected to run, in their order."""

    name = "job_started"
    stages: Sequence[ExpectedStage]


@dataclass(frozen=True)
class StagesPassedOver(Event):
    """A job does not need some of its stages after all; ``stages`` has their keys."""

    name = "stages_passed_over"
    stages: Sequence[str]


@dataclass(frozen=True)
class StageStarted(Event):
    """A stage begins.

    Attributes
    ----------
    stage, title : str
        Key of the stage, and its name in words.
    tasks : int
        Number of all tasks.
    done : int
        Number of tasks that earlier runs did.
    points, pixels : int
        Number of points that the other tasks read, and of pixels that they make; 0 if they are not counted.
    by_pixels : bool
        Whether pixels measure the work as well, as in a stage that writes rasters and clouds.
    """

    name = "stage_started"
    stage: str
    title: str
    tasks: int
    done: int = 0
    points: int = 0
    pixels: int = 0
    by_pixels: bool = False


@dataclass(frozen=True)
class TaskDone(Event):
    """A task is done.

    Attributes
    ----------
    stage, key : str
        Keys of the stage and of the task.
    points, pixels : int
        Number of points that the task read, and of pixels that it made.
    seconds : float
    peak_rss_bytes : int
        Peak of the memory of its process, or 0 if it was not measured.
    """

    name = "task_done"
    stage: str
    key: str
    points: int = 0
    pixels: int = 0
    seconds: float = 0.0
    peak_rss_bytes: int = 0


@dataclass(frozen=True)
class TaskAgain(Event):
    """A task failed and is tried again. ``kind`` is the name of the class of the error."""

    name = "task_again"
    stage: str
    title: str
    key: str
    error: str
    kind: str


@dataclass(frozen=True)
class TaskFailed(Event):
    """A task failed for good.

    Attributes
    ----------
    stage, title, key : str
        Key of the stage, its name in words, and key of the task.
    error, kind : str
        Error, and name of its class.
    bounds : list of float, optional
        Lowest x and y and highest x and y of the task, in units of the CRS. None if it has no extent.
    """

    name = "task_failed"
    stage: str
    title: str
    key: str
    error: str
    kind: str = ""
    bounds: list[float] | None = None


@dataclass(frozen=True)
class StageFinished(Event):
    """A stage is finished, after some seconds."""

    name = "stage_finished"
    stage: str
    seconds: float


@dataclass(frozen=True)
class RunFinished(Event):
    """A run is finished, after some seconds."""

    name = "run_finished"
    seconds: float


Listener = Callable[[Event], None]
"""Function that receives events."""


def ignore_events(event: Event) -> None:
    """Ignore an event."""


def combine(*listeners: Listener) -> Listener:
    """Return a listener that passes each event to all listeners, in their order."""

    def pass_on(event: Event) -> None:
        for listener in listeners:
            listener(event)

    return pass_on


def redacting(listener: Listener) -> Listener:
    """Return a listener that passes events to another one, without passwords and tokens in URLs."""
    return lambda event: listener(replace(event, **stored(event.to_json())))
