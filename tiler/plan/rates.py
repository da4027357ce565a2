"""Estimates how long a run takes from earlier runs on this machine, kept in the user's cache folder."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tiler.io.atomic_files import replace_file
from tiler.io.json_text import parse_json_object
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
"""Worker seconds a million points where nothing is known of a stage; measured on a city, other machines differ."""

MIN_POINTS = 1_000_000
"""Points of the smallest run that is remembered: the time of smaller ones is mostly start-up."""

_NEWEST = 0.5
"""Weight of the newest run in what is remembered."""


def remember(plan: Plan, stages: Mapping[str, Mapping[str, Any]]) -> None:
    """Keep the rates of the stages that a run did from beginning to end.

    A cache that cannot be written is none: the plan then says that its time is another machine's.

    Parameters
    ----------
    plan : Plan
    stages : mapping
        Name -> ``tasks``, ``computed`` (of these, in this run) and ``seconds``, as in ``run.json``.
    """
    if plan.points < MIN_POINTS or plan.config.scheduler is not None:
        return
    known = _read()
    for stage, facts in stages.items():
        if facts["computed"] and facts["computed"] == facts["tasks"]:
            rate, name = facts["seconds"] * plan.workers / plan.points * 1e6, _name(plan, stage)
            known[name] = rate if name not in known else (1 - _NEWEST) * known[name] + _NEWEST * rate
    path = _path()
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(
            json.dumps({"version": __version__, "seconds_per_million": known}, indent=1), "utf-8"
        )
        replace_file(partial, path)


def projected_seconds(plan: Plan) -> tuple[float, bool]:
    """Seconds of the whole job, and whether all of it rests on earlier runs of this machine."""
    products = dict.fromkeys(("dtm", *plan.config.exported))
    stages, known = stage_seconds(plan, [f"grid-{name}" for name in products]), _read()
    return sum(stages.values()), all(_name(plan, stage) in known for stage in stages)


def stage_seconds(plan: Plan, rasters: Iterable[str], until: str = "export") -> dict[str, float]:
    """Seconds of each stage of a job that may take its time, in their order.

    Parameters
    ----------
    plan : Plan
    rasters : iterable of str
        Stages of the rasters that are made.
    until : str
        Last part of the job: ``ingest``, ``filter``, ``grid`` or ``export``.
    """
    known = _read()
    filters = {f"filter{number}": step for number, step in enumerate(plan.passes) if step in plan.steps}
    # Of passes that do not always apply those count that earlier runs did, if they did any.
    did = [stage for stage, step in filters.items() if step.sometimes and _name(plan, stage) in known]
    filters = {s: step for s, step in filters.items() if s in did or not (did and step.sometimes)}
    if plan.kinds:  # the points will show which passes apply: those that take longest
        costs = {
            k: sum(_rate(plan, known, s) for s, step in filters.items() if step.kind == k) for k in plan.kinds
        }
        dearest = max(costs, key=lambda kind: costs[kind])
        filters = {s: step for s, step in filters.items() if step.kind in (None, dearest)}
    parts = {"ingest": ["spool", "assemble"], "filter": filters, "grid": rasters, "export": ["export"]}
    names = list(parts)
    stages = [stage for name in names[: names.index(until) + 1] for stage in parts[name]]
    return {stage: _rate(plan, known, stage) * plan.points / 1e6 / plan.workers for stage in stages}


def _rate(plan: Plan, known: Mapping[str, float], stage: str) -> float:
    """Worker seconds a million points."""
    typical = TYPICAL.get(stage, TYPICAL[re.split(r"[-\d]", stage)[0]])
    return known.get(_name(plan, stage), typical)


def _name(plan: Plan, stage: str) -> str:
    """Under which a rate is kept: filters differ by method."""
    return f"{plan.config.method}:{stage}" if stage.startswith("filter") else stage


def _path() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(home) / "tiler-dtm" / "rates.json"


def _read() -> dict[str, float]:
    """What is remembered of this version; a file of another one, or a damaged one, is as none."""
    try:
        content = parse_json_object(_path().read_text())
        if content["version"] != __version__:
            return {}
        return {str(k): float(v) for k, v in content["seconds_per_million"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
