"""Method of a run as its plan knows it: parameters, passes and their halos, kind of the clouds, and tiles."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeVar

from ptd.matched.evidence import DIM, LIDAR, Evidence
from ptd.matched.survey import run_facts
from ptd.methods import METHODS, make_params
from ptd.passes import Pass, State
from tiler.config import RunConfig
from tiler.core.words import stage_title
from tiler.errors import ConfigError

KEEP = "keep"
"""Name of the method that keeps the classes of the input."""

KIND_WORDS = {LIDAR: "a LiDAR cloud", DIM: "a photogrammetric cloud"}

FINE_CELL_M = Fraction(1, 2)
"""Side in metres of the store's cells with one candidate each, if the method's cells do not
divide a bucket evenly."""

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

MAX_HALO_FACTOR = 4
"""Largest ratio of the last to the first halo of a tile with uncertified labels."""

Length = TypeVar("Length", int, float)

EQUIVALENTS = {
    "csf": "cloth simulation is not among the methods, but auto uses a stiffer cloth for photogrammetric clouds; ",
    "smrf": "the morphological filter SMRF is not among the methods, but chen2023 also uses stepwise openings; ",
    "pmf": "the morphological filter PMF is not among the methods, but chen2023 also uses stepwise openings; ",
    "ptd": "progressive TIN densification is --method classic; ",
    "mcc": "curvature filtering is not among the methods, but ridge2016 tests seeds against curved surfaces; ",
}
"""Beginning of the message about a filter of other programs, by the name of the filter in small
letters."""


@dataclass(frozen=True)
class PlannedPass:
    """Pass of the method, with the first halo of its tiles in metres."""

    pass_: Pass
    halo_m: float

    @property
    def name(self) -> str:
        """Name of the pass."""
        return self.pass_.name

    @property
    def title(self) -> str:
        """Short description of the pass, or else its name."""
        return self.pass_.title or self.pass_.name

    @property
    def kind(self) -> str | None:
        """Kind of the clouds that the pass is for, or None for all kinds."""
        return self.pass_.kind

    @property
    def sometimes(self) -> bool:
        """Whether the pass may be skipped for some clouds."""
        return type(self.pass_).applies is not Pass.applies

    @property
    def fits_surfaces(self) -> bool:
        """Whether the pass uses elected points of photogrammetric clouds, whose surfaces need more memory."""
        return self.pass_.elected and self.kind == "dim"

    @property
    def on_candidates(self) -> bool:
        """Whether the pass uses only one candidate per cell and makes no raster of its window."""
        return not (self.pass_.every_point or self.pass_.elected or self.pass_.raster_cell_m)


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


def params_of(config: RunConfig) -> Any:
    """Return the parameters of the method, or None for `keep`."""
    if config.method == KEEP:
        if config.parameters:
            raise ConfigError(
                f"--set {config.parameters[0][0]}: method keep has no parameters; leave it out"
            )
        if not config.ground_classes:
            raise ConfigError(
                "--ground-classes none: method keep needs the classes of the ground; give at least one, such as 2"
            )
        return None
    if config.method not in METHODS:
        known = EQUIVALENTS.get(config.method.lower(), "does not exist; ")
        raise ConfigError(
            f"--method {config.method}: {known}use one of {', '.join([*METHODS, KEEP])}"
        )
    try:
        return make_params(config.method, dict(config.parameters))
    except ValueError as error:
        raise ConfigError(f"--set {error} (method {config.method})") from error


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


def fine_cell_m(cell_m: float, bucket_m: Fraction) -> Fraction:
    """Return the side of the cells with one candidate each, in metres.

    It is the cell of the method (``cell_m``, 0 if it has none) if the side of a bucket is a
    whole number of cells, or else `FINE_CELL_M`.
    """
    method_cell_m = Fraction(repr(float(cell_m)))
    if method_cell_m > 0 and (bucket_m / method_cell_m).denominator == 1:
        return method_cell_m
    return FINE_CELL_M


def nested(cell_m: float, fine_m: Fraction) -> bool:
    """Return whether a method needs only candidates: its cell is a whole number of fine cells."""
    return cell_m > 0 and (Fraction(repr(float(cell_m))) / fine_m).denominator == 1
