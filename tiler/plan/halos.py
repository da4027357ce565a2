"""How wide the halo is: how far beyond its tile each pass of a method looks, and who decides it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from ptd.passes import Pass
from tiler.config import RunConfig
from tiler.plan.memory import PlannedPass

MAX_HALO_FACTOR = 4
"""A tile with marks takes so many times the halo that it began with at most."""

Length = TypeVar("Length", int, float)


def widened(step: PlannedPass, halo: Length, fits: Callable[[Length], bool]) -> Length:
    """The halo that a tile of a pass may end with: doubled and doubled again while that fits; a fixed one stays."""
    widest = halo
    while step.work.reach_m is None and 0 < widest < MAX_HALO_FACTOR * halo and fits(2 * widest):
        widest *= 2
    return widest


def own_halo(params: Any) -> float | None:
    """The halo that a method asks for, whatever ``--halo`` says; None if it has none or all its reaches are proven."""
    steps = [] if params is None else [step for step in params.passes if step.reach_m is None]
    return max((float(params.halo_m if s.halo_m is None else s.halo_m) for s in steps), default=None)


def planned_passes(
    params: Any, config: RunConfig, kind: str | None, notes: list[str]
) -> tuple[PlannedPass, ...]:
    """The passes of a method with the halo that each starts with, for a cloud of that kind (None: not known)."""

    def halo(step: Pass) -> float:
        if step.reach_m is not None:
            return step.reach_m
        if config.halo is not None:
            return float(config.halo)
        return float(params.halo_m if step.halo_m is None else step.halo_m)

    asked = [step for step in params.passes if step.kind is None or kind in (None, step.kind)]
    fixed = [step for step in asked if step.reach_m is not None]
    if config.halo is not None and fixed:
        notes.append(
            "--halo does not count for passes that know how far they look: "
            + ", ".join(f"{step.name} {step.reach_m:g} m" for step in fixed)
        )
    return tuple(PlannedPass(step, halo(step)) for step in params.passes)
