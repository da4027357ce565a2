"""What happens during a run, as plain events; whoever wants to show or keep them listens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tiler.redaction import stored

Listener = Callable[[str, dict[str, Any]], None]
"""Called with the event's name and JSON-able fields.

Names: ``note`` (text), ``warning`` (text), ``job_started`` (stages: each with stage, title, and the seconds that it may
take), ``stages_passed_over`` (stages: keys of those that the job turns out not to need), ``stage_started`` (stage,
title, tasks, points, done), ``task_done`` (stage, key, points, seconds, peak_rss_bytes), ``task_again`` (stage, title,
key, error: it failed and is tried again), ``task_failed`` (the same, and its bounds), ``stage_finished`` (stage,
seconds), ``run_finished``. ``stage`` is a key, ``title`` the same in words.
"""


def silent(event: str, fields: dict[str, Any]) -> None:
    """A listener that ignores everything."""


def combine(*listeners: Listener) -> Listener:
    """One listener that tells all of them, in that order."""

    def tell_all(event: str, fields: dict[str, Any]) -> None:
        for listener in listeners:
            listener(event, fields)

    return tell_all


def discreet(listener: Listener) -> Listener:
    """A listener that is told everything but the passwords and tokens of URLs."""
    return lambda event, fields: listener(event, stored(fields))
