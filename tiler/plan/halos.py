"""Width of the halo of each pass of a method."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from ptd.passes import Pass
from tiler.config import RunConfig
from tiler.plan.memory import PlannedPass

MAX_HALO_FACTOR = 4
"""Largest ratio of the last to the first halo of a tile with uncertified labels."""

Length = TypeVar("Length", int, float)


def widest_halo(step: PlannedPass, halo: Length, fits: Callable[[Length], bool]) -> Length:
    """Return the widest halo that a tile of a pass may get.

    The first ``halo`` is doubled while it fits, up to `MAX_HALO_FACTOR` times its width. A pass
    with a fixed radius keeps its halo.
    """
    widest = halo
    while (
        step.pass_.influence_radius_m is None
        and 0 < widest < MAX_HALO_FACTOR * halo
        and fits(2 * widest)
    ):
        widest *= 2
    return widest


def default_halo_m(params: Any) -> float | None:
    """Return the widest default halo of a method in metres, or None if no pass has a variable halo."""
    if params is None:
        return None
    halos = [
        _first_halo_m(params, pass_)
        for pass_ in params.passes
        if pass_.influence_radius_m is None
    ]
    return max(halos, default=None)


def _first_halo_m(params: Any, pass_: Pass) -> float:
    """Return the default first halo of a pass with a variable halo, in metres."""
    if pass_.halo_m is None:
        return float(params.halo_m)
    return float(pass_.halo_m)


def planned_passes(
    params: Any, config: RunConfig, kind: str | None, notes: list[str]
) -> tuple[PlannedPass, ...]:
    """Return the passes of a method with the first halos of their tiles.

    A note lists the passes that ``--halo`` cannot change. ``kind`` is the source of the cloud;
    None if it is unknown.
    """

    def halo(pass_: Pass) -> float:
        if pass_.influence_radius_m is not None:
            return pass_.influence_radius_m
        if config.halo is not None:
            return float(config.halo)
        return _first_halo_m(params, pass_)

    planned = tuple(PlannedPass(pass_, halo(pass_)) for pass_ in params.passes)
    fixed = [
        f"{pass_.name} {pass_.influence_radius_m:g} m"
        for pass_ in params.passes
        if pass_.influence_radius_m is not None
        and (pass_.kind is None or kind in (None, pass_.kind))
    ]
    if config.halo is not None and fixed:
        notes.append(f"--halo has no effect on passes with a fixed radius: {', '.join(fixed)}")
    return planned
