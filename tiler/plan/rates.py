"""Estimates of the time of a run, from earlier runs recorded in the user's cache folder."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from itertools import chain
from pathlib import Path

from tiler.core.results import StageResult
from tiler.io.atomic_files import replace_file
from tiler.io.foreign_content import parse_json_object
from tiler.plan.model import Plan
from tiler.version import __version__

TYPICAL = {
    "spool": 1.3,
    "assemble": 0.7,
    "filter": 0.4,
    "grid-dtm": 0.9,
    "grid-dsm": 0.5,
    "grid": 0.1,
    "export": 1.2,
}
"""Worker seconds per million points of stages without an earlier run, measured on a city. Other
machines differ."""

MIN_POINTS = 1_000_000
"""Minimum number of points of a run that is recorded, since the time of smaller runs is mostly
start-up."""

_NEWEST = 0.5
"""Weight of the newest run in the recorded rates."""


def remember(plan: Plan, stages: Mapping[str, StageResult]) -> None:
    """Record the rates of the stages that a run did completely.

    Errors of writing the cache are ignored. The plan then uses the rates of another machine.

    Parameters
    ----------
    plan : Plan
    stages : mapping
        Work of each stage by its key.
    """
    if plan.inputs.points < MIN_POINTS or plan.config.scheduler is not None:
        return
    known = _read()
    for stage, result in stages.items():
        if result.computed and result.computed == result.tasks:
            rate = result.seconds * plan.resources.workers / plan.inputs.points * 1e6
            name = _name(plan, stage)
            if name in known:
                rate = (1 - _NEWEST) * known[name] + _NEWEST * rate
            known[name] = rate
    path = _path()
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        with open(partial, "x", encoding="utf-8") as file:
            json.dump({"version": __version__, "seconds_per_million": known}, file, indent=1)
        replace_file(partial, path)


def projected_seconds(plan: Plan) -> tuple[float, bool]:
    """Estimate the seconds of the whole job, and return whether all rates are from earlier runs here."""
    products = dict.fromkeys(("dtm", *plan.config.exported))
    stages = stage_seconds(plan, [f"grid-{name}" for name in products])
    known = _read()
    return sum(stages.values()), all(_name(plan, stage) in known for stage in stages)


def stage_seconds(
    plan: Plan, rasters: Iterable[str], until: str = "export"
) -> dict[str, float]:
    """Estimate the seconds of the stages of a job, in their order.

    Parameters
    ----------
    plan : Plan
    rasters : iterable of str
        Names of the stages of the rasters that are made.
    until : str
        Last part of the job: ``ingest``, ``filter``, ``grid`` or ``export``.
    """
    known = _read()
    steps, kinds = plan.method.steps, plan.method.kinds
    filters = {
        f"filter{number}": step
        for number, step in enumerate(plan.method.passes)
        if step in steps
    }
    # Some passes are skipped for some clouds. Once earlier runs did some of these passes, the
    # others are not expected.
    did = [
        stage
        for stage, step in filters.items()
        if step.sometimes and _name(plan, stage) in known
    ]
    if did:
        filters = {
            stage: step for stage, step in filters.items() if stage in did or not step.sometimes
        }
    if kinds:  # The kind is not known yet, so the passes of the slowest kind count.
        costs = dict.fromkeys(kinds, 0.0)
        for stage, step in filters.items():
            if step.kind in costs:
                costs[step.kind] += _rate(plan, known, stage)
        slowest = max(costs, key=lambda kind: costs[kind])
        filters = {
            stage: step for stage, step in filters.items() if step.kind in (None, slowest)
        }
    parts = {
        "ingest": ["spool", "assemble"],
        "filter": filters,
        "grid": rasters,
        "export": ["export"],
    }
    names = list(parts)
    stages = chain.from_iterable(parts[name] for name in names[: names.index(until) + 1])
    points, workers = plan.inputs.points, plan.resources.workers
    return {stage: _rate(plan, known, stage) * points / 1e6 / workers for stage in stages}


def _rate(plan: Plan, known: Mapping[str, float], stage: str) -> float:
    """Return the worker seconds per million points of a stage."""
    typical = TYPICAL.get(stage, TYPICAL[re.split(r"[-\d]", stage)[0]])
    return known.get(_name(plan, stage), typical)


def _name(plan: Plan, stage: str) -> str:
    """Return the key of a recorded rate. The rates of filter stages differ by method."""
    return f"{plan.config.method}:{stage}" if stage.startswith("filter") else stage


def _path() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(home) / "tiler-dtm" / "rates.json"


def _read() -> dict[str, float]:
    """Return the rates recorded by this version, or {} if there is no valid file."""
    try:
        content = parse_json_object(_path().read_text())
        if content["version"] != __version__:
            return {}
        return {str(k): float(v) for k, v in content["seconds_per_million"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
