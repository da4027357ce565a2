"""Width of the halo of each pass of a method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from ptd.passes import Pass
from tiler.config import RunConfig
from tiler.plan.memory import PlannedPass

MAX_HALO_FACTOR = 4
"""Largest ratio of the final to the first halo of a tile with uncertified labels."""

Length = TypeVar("Length", int, float)


def widened(step: PlannedPass, halo: Length, fits: Callable[[Length], bool]) -> Length:
    """Return the widest halo that a tile of a pass may get.

    The first ``halo`` is doubled while it fits, up to `MAX_HALO_FACTOR` times its width. A pass with a fixed radius
    keeps its halo.
    """
    widest = halo
    while step.work.reach_m is None and 0 < widest < MAX_HALO_FACTOR * halo and fits(2 * widest):
        widest *= 2
    return widest


def own_halo(params: Any) -> float | None:
    """Return the widest default halo of a method in metres, or None if no pass has a variable halo."""
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
    """Return the passes of a method with the first halos of their tiles.

    A note lists the passes that ``--halo`` cannot change. ``kind`` is the source of the cloud, None if still unknown.
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
