"""Width of the halo: how far each pass of a method looks beyond its tile."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from ptd.passes import Pass
from tiler.config import RunConfig
from tiler.plan.memory import PlannedPass

MAX_HALO_FACTOR = 4
"""A tile with marks gets at most so many times the halo that it began with."""

Length = TypeVar("Length", int, float)


def widened(step: PlannedPass, halo: Length, fits: Callable[[Length], bool]) -> Length:
    """The halo that a tile of a pass may end with: doubled while that fits, unless it is a proven reach."""
    widest = halo
    while step.work.reach_m is None and 0 < widest < MAX_HALO_FACTOR * halo and fits(2 * widest):
        widest *= 2
    return widest


def own_halo(params: Any) -> float | None:
    """The widest halo that a method asks for by itself, in metres; None if the reaches of all its passes are proven."""
    if params is None:
        return None
    return max((_asked_m(params, step) for step in params.passes if step.reach_m is None), default=None)


def _asked_m(params: Any, step: Pass) -> float:
    if step.halo_m is None:
        return float(params.halo_m)
    return float(step.halo_m)


def planned_passes(
    params: Any, config: RunConfig, kind: str | None, notes: list[str]
) -> tuple[PlannedPass, ...]:
    """The passes of a method, each with the halo that its tiles begin with.

    A note names the passes that ``--halo`` cannot change. ``kind`` is what made the cloud; None: not known yet.
    """

    def halo(step: Pass) -> float:
        if step.reach_m is not None:
            return step.reach_m
        if config.halo is not None:
            return float(config.halo)
        return _asked_m(params, step)

    asked = [step for step in params.passes if step.kind is None or kind in (None, step.kind)]
    fixed = [step for step in asked if step.reach_m is not None]
    if config.halo is not None and fixed:
        notes.append(
            "--halo has no effect on passes with a fixed radius: "
            + ", ".join(f"{step.name} {step.reach_m:g} m" for step in fixed)
        )
    return tuple(PlannedPass(step, halo(step)) for step in params.passes)
