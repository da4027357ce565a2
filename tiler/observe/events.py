"""Events of a run, and functions that combine their listeners."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tiler.redaction import stored

Listener = Callable[[str, dict[str, Any]], None]
"""Function that receives the name of an event and its JSON-able fields.

======================  ==========================================================================
Event                   Fields
======================  ==========================================================================
``note``                text
``warning``             text
``job_started``         stages (stage, title and expected seconds of each)
``stages_passed_over``  stages (keys of the stages that the job does not need after all)
``stage_started``       stage, title, tasks, points, pixels, done
``task_done``           stage, key, points, pixels, seconds, peak_rss_bytes
``task_again``          stage, title, key, error of a task that failed and is retried
``task_failed``         stage, title, key, error, bounds of a task that failed
``stage_finished``      stage, seconds
``run_finished``        seconds
======================  ==========================================================================

``stage`` is a key, and ``title`` is the name of the stage in words.
"""


def ignore_events(event: str, fields: dict[str, Any]) -> None:
    """Ignore an event."""


def combine(*listeners: Listener) -> Listener:
    """Return a listener that passes each event to all listeners, in their order."""

    def pass_on(event: str, fields: dict[str, Any]) -> None:
        for listener in listeners:
            listener(event, fields)

    return pass_on


def redacting(listener: Listener) -> Listener:
    """Return a listener that passes events to another one, without passwords and tokens in URLs."""
    return lambda event, fields: listener(event, stored(fields))
