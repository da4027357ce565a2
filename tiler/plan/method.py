"""Method of a run as its plan knows it: parameters, passes, kind of the clouds, and tiles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ptd.matched.evidence import Evidence
from ptd.matched.survey import run_facts
from ptd.passes import State
from tiler.config import RunConfig
from tiler.core.words import stage_title
from tiler.plan.memory import PlannedPass

KEEP = "keep"
"""Name of the method that keeps the classes of the input."""

MIN_CANDIDATES = 500_000
"""Minimum mean number of candidates of joined tiles. Smaller tiles are made only if the memory
requires it."""

MAX_HALF = 0.8
"""A joined tile is halved for more workers only if the window of each half has at most this share
of the area of its window.

Otherwise most of the windows are halo. Two windows of 0.81 on 1.5 km x 2 km took as long as one, in
a third more CPU time.
"""

MIN_MATCHED_M2 = 0.5
"""Density in points per square metre below which clouds of unknown kind are planned as LiDAR
clouds. From positions alone, `auto` classifies clouds as photogrammetric only if they have at
least twice this density."""


@dataclass(frozen=True, kw_only=True)
class MethodPlan:
    """Passes of the method, and the tiles of each pass.

    Attributes
    ----------
    parameters : mapping
        Parameters of the method as plain values; empty for the method `keep`.
    passes : tuple of PlannedPass
        All passes of the method, by number. `steps` are the passes that the run may do.
    candidate_cell_m : float
        Side of the method's thinning cells in metres, 0 if it has none.
    kind : str or None
        Source of the clouds: laser scanning (lidar), image matching (dim), or None if not known yet.
    statistics : mapping or None
        State after each pass, by its name, of the earlier run given by ``--statistics``.
    tile : Fraction
        Side of a tile in metres.
    tile_memory : int
        Memory for which the tiles are cut, in bytes: the memory of a worker in the first run on the store.
    tile_workers : int
        Number of workers of the first run on the store, which determines the number of tiles; 0 if the user chose a
        tile size.
    """

    parameters: Mapping[str, Any]
    passes: tuple[PlannedPass, ...]
    candidate_cell_m: float
    kind: str | None
    statistics: Mapping[str, State] | None
    tile: Fraction
    tile_memory: int
    tile_workers: int

    @property
    def steps(self) -> tuple[PlannedPass, ...]:
        """Passes that the run may do."""
        return steps_of(self.passes, self.kind)

    @property
    def depends_on_kind(self) -> bool:
        """Whether the method treats kinds of clouds differently."""
        return any(step.kind for step in self.passes)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Possible kinds of a cloud of unknown kind.

        Empty if the kind is known or if the method treats all kinds alike.
        """
        if self.kind is not None:
            return ()
        return tuple(dict.fromkeys(step.kind for step in self.steps if step.kind))

    @property
    def halo_m(self) -> float:
        """Widest halo with which a pass starts, in metres."""
        return max((step.halo_m for step in self.steps), default=0.0)

    def halo_of(self, kind: str) -> float:
        """Return the widest halo in metres with which a pass starts on a cloud of a kind."""
        return max(step.halo_m for step in steps_of(self.passes, kind))

    def title_of(self, stage: str) -> str:
        """Return the title of a stage."""
        return stage_title(stage, [step.title for step in self.passes])

    def n_joined_tiles(self, candidates: int) -> int:
        """Return the number of joined tiles of a pass.

        There is one tile per worker, rounded up to a power of two, or fewer if tiles would have less than
        `MIN_CANDIDATES`.
        """
        power_of_two = 1 << (self.tile_workers - 1).bit_length()
        return min(power_of_two, max(candidates // MIN_CANDIDATES, 1))


def known_kind(
    config: RunConfig, statistics: Mapping[str, Any] | None, evidence: Evidence | None
) -> str | None:
    """Return the kind of the clouds, or None if it is not known yet.

    With ``statistics`` of an earlier run, it is the kind in them. Otherwise it is the kind that
    the user gives, or else the kind that the fields of the points decide.
    """
    if statistics is None:
        return run_facts(None, config.source_kind, evidence).kind
    for state in statistics.values():
        if "kind" in state.get("survey", {}):
            kind: str = state["survey"]["kind"]
            return kind
    return None


def steps_of(passes: Iterable[PlannedPass], kind: str | None) -> tuple[PlannedPass, ...]:
    """Return the passes that a cloud of a kind may need. The kind is None if it is not known."""
    return tuple(step for step in passes if step.kind is None or kind in (None, step.kind))


def expected_passes(
    passes: Iterable[PlannedPass], kind: str | None, density: float
) -> tuple[PlannedPass, ...]:
    """Return the passes for which the plan reserves memory.

    They are the passes that the cloud may need. If the kind is unknown and the density is below
    `MIN_MATCHED_M2`, passes for photogrammetric clouds are left out.
    """
    steps = steps_of(passes, kind)
    if kind is None and density < MIN_MATCHED_M2:
        return tuple(step for step in steps if step.kind != "dim")
    return steps
