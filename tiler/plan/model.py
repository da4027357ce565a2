"""The plan of a run: all decisions before the first point is read, and values derived from them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

from ptd.matched.evidence import Evidence, Finding, decided_by
from ptd.matched.survey import run_facts
from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.breaklines import Counts
from tiler.core.edits import Edit
from tiler.core.lattice import Bounds
from tiler.core.raster import BLOCK_PIXELS, MIN_PART
from tiler.core.stage_names import stage_title
from tiler.core.water import Water
from tiler.inputs import SourceInfo
from tiler.plan.density_map import DensityMap
from tiler.plan.memory import (
    BASE_BYTES,
    GROUND_BYTES,
    JOINED_BYTES,
    PlannedPass,
    breakline_bytes,
    nested,
)
from tiler.store import StoreMeta

BRIDGE_REACH_M = 300
"""Distance around an area within which points are read for bridges across the border of the area. It is the length of
the longest bridge."""
KEEP = "keep"
"""Name of the method that keeps the classes of the input."""

PIECE_POINTS = 1_000_000
"""Number of points that a worker decodes at a time."""
MAX_GROUND = 4_000_000
"""Maximum number of points in the window of a part of a block. The surface of denser clouds is thinned to one point per
cell of a quarter pixel."""
SURFACE_SHARE = 2
"""Number of cells along a pixel's side if the surface is a percentile of the heights. Each cell gives one point."""
THIN_SHARE = 4
"""Number of cells along a pixel's side if ground points are thinned to save memory. Each cell gives one point."""
PART = 128
"""Side, in pixels, of the parts into which a block with many points is divided."""

MIN_CANDIDATES = 500_000
"""Minimum number of candidates in a half of a tile that is split only to occupy workers."""

MIN_MATCHED_M2 = 0.5
"""Density in points per square metre below which the plan reserves no memory for photogrammetric clouds if the kind is
not known. From positions alone, `auto` classifies clouds as photogrammetric only from twice this density on."""


def known_kind(
    config: RunConfig, statistics: Mapping[str, Any] | None, evidence: Evidence | None
) -> str | None:
    """Return the kind of the clouds, or None if it is not known yet.

    With ``statistics`` of an earlier run, it is the kind in them. Otherwise it is the kind that the user gives, or
    else the kind that the fields of the points decide.
    """
    if statistics is None:
        return run_facts(None, config.source_kind, evidence).kind
    for state in statistics.values():
        if "kind" in state.get("survey", {}):
            kind: str = state["survey"]["kind"]
            return kind
    return None


def expected_passes(
    steps: Iterable[PlannedPass], kind: str | None, density: float
) -> tuple[PlannedPass, ...]:
    """Return the passes for which the plan reserves memory.

    If the kind is unknown and the density is low, passes for photogrammetric clouds are left out.
    """
    if kind is None and density < MIN_MATCHED_M2:
        return tuple(step for step in steps if step.kind != "dim")
    return tuple(steps)


def steps_of(passes: Iterable[PlannedPass], kind: str | None) -> tuple[PlannedPass, ...]:
    """Return the passes that a cloud of a kind may need. The kind is None if it is not known."""
    return tuple(step for step in passes if step.kind is None or kind in (None, step.kind))


@dataclass(frozen=True)
class Plan:
    """Plan of a run, with lengths in metres and sizes in bytes.

    Attributes
    ----------
    sources : tuple of SourceInfo
        Files that can be read and lie near the area, sorted by path.
    unreadable : tuple of (str, str)
        Path and reason of each file that is left out.
    area : Area or None
        Area for which products and labels are made; None for the whole survey.
    memory : int
        Memory that a worker may use, in bytes.
    tile_memory : int
        Memory for which the tiles are cut, in bytes: `memory` of the first run on the store, also in later runs.
    area_m2 : float
        Area in m2 that the points cover. Overlaps of files count once.
    thin : bool or None
        Decision of the first run on the store on `thin_ground`; None if there was no earlier run.
    density_map : DensityMap
        Map that finds the densest place.
    names : dict of Path to Path
        Path of the classified file of each source, relative to OUT/classified.
    passes : tuple of PlannedPass
        All passes of the method, by number. `steps` are the passes that the run may do.
    statistics : dict or None
        State after each pass, by its name, of the earlier run given by ``--statistics``.
    edits : tuple of Edit
        Edits, in the order of their file.
    lines : tuple of int64 (n, 3)
        Vertices of breaklines, in absolute counts.
    waters : tuple of Water
        Bodies of water in the file given by ``--water``, with heights if it has them.
    tile_workers : int
        `workers` of the first run on the store, which determine the number of tiles; 0 if the user chose a tile size.
    evidence : Evidence or None
        Evidence in the fields of the points on the source of the clouds; None for the method `keep`.
    """

    config: RunConfig
    sources: tuple[SourceInfo, ...]
    unreadable: tuple[tuple[str, str], ...]
    meta: StoreMeta
    area: Area | None
    parameters: dict[str, Any]
    resolution: Fraction
    tile: Fraction
    passes: tuple[PlannedPass, ...]
    memory: int
    tile_memory: int
    workers: int
    candidate_cell_m: float
    points: int
    area_m2: float
    extent: Bounds
    density_map: DensityMap
    thin: bool | None = None
    names: dict[Path, Path] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = field(default=())
    statistics: dict[str, Any] | None = None
    edits: tuple[Edit, ...] = ()
    lines: tuple[Counts, ...] = ()
    waters: tuple[Water, ...] = ()
    tile_workers: int = 0
    evidence: Evidence | None = None

    @property
    def writes_clouds(self) -> bool:
        """Whether the run writes classified clouds, not with `--method keep` or `--classified none`."""
        return self.config.method != KEEP and self.config.classified != "none"

    @property
    def area_key(self) -> str | None:
        """Name of the area in the store, or None if the run has no area."""
        return None if self.area is None else self.area.key

    @property
    def filled(self) -> list[SourceInfo]:
        """Sources with points."""
        return [s for s in self.sources if s.points and s.bounds is not None]

    @property
    def kind(self) -> str | None:
        """Source of the cloud: laser scanning (lidar), image matching (dim), or None if not known yet."""
        return known_kind(self.config, self.statistics, self.evidence)

    @property
    def finding(self) -> Finding | None:
        """Source of the clouds with confidence and reasons, if the fields of the points decide it.

        None if they do not decide it, if the method treats all kinds alike, or if the user or an earlier run gives the
        kind.
        """
        if self.evidence is None or not self.depends_on_kind or self.kind is None:
            return None
        if self.statistics is not None or self.config.source_kind is not None:
            return None
        return decided_by(self.evidence)

    @property
    def steps(self) -> tuple[PlannedPass, ...]:
        """Passes that the run may do."""
        return steps_of(self.passes, self.kind)

    def title_of(self, stage: str) -> str:
        """Return the title of a stage."""
        return stage_title(stage, [step.title for step in self.passes])

    @property
    def expected_passes(self) -> tuple[PlannedPass, ...]:
        """Passes for which the plan reserves memory."""
        return expected_passes(self.steps, self.kind, self.density)

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

    def halo_of(self, kind: str) -> float:
        """Return the widest halo in metres with which a pass starts on a cloud of a kind."""
        return max(step.halo_m for step in steps_of(self.passes, kind))

    @property
    def sides_m(self) -> tuple[float, float]:
        """Width and height of the survey, in metres."""
        bounds, metres = self.extent, float(self.meta.frame.metres_xy)
        return (bounds.x1 - bounds.x0) * metres, (bounds.y1 - bounds.y0) * metres

    def n_joined_tiles(self, candidates: int) -> int:
        """Return the number of joined tiles of a pass.

        There is one tile per worker, rounded up to a power of two, or fewer if tiles would have less than
        `MIN_CANDIDATES`.
        """
        return min(1 << (self.tile_workers - 1).bit_length(), max(candidates // MIN_CANDIDATES, 1))

    @property
    def fine_m(self) -> Fraction:
        """Side in metres of the store's cells with one candidate each."""
        return self.meta.fine.size * self.meta.frame.metres_xy

    @property
    def on_candidates(self) -> bool:
        """Whether the method needs only candidates, as each of its cells is a whole number of the store's cells."""
        return nested(self.candidate_cell_m, self.fine_m)

    def joins(self, step: PlannedPass) -> bool:
        """Return whether a pass gets the largest tiles that fit into memory and occupy all workers.

        This is the case if candidates suffice for the pass and the user did not choose a tile size.
        """
        return self.tile_workers > 0 and step.on_candidates and self.on_candidates

    def tile_memory_of(self, step: PlannedPass) -> int:
        """Return the memory of a worker for which the tiles of a pass are cut, in bytes."""
        if self.joins(step):
            return min(self.tile_memory, JOINED_BYTES)
        return self.tile_memory

    @property
    def margin(self) -> int:
        """Distance around the area within which points are read, in counts.

        It is the largest of three distances: the halos with which passes start, the distance over which labels and
        bridges are decided, and the halo of a block of the terrain.
        """
        labels = max((Fraction(step.pass_.label_margin_m) for step in self.steps), default=Fraction(0))
        if self.config.bridges == "remove":
            labels += BRIDGE_REACH_M
        return math.ceil(self.meta.frame.counts(max(Fraction(self.halo_m), self.grid_halo, labels)))

    @property
    def density(self) -> float:
        """Points per square metre of the area that they cover. Overlaps count once."""
        return self.points / self.area_m2 if self.area_m2 else 0.0

    @property
    def bucket_m(self) -> float:
        """Side of a bucket in metres."""
        return float(self.meta.bucket.size * self.meta.frame.metres_xy)

    @property
    def grid_halo(self) -> Fraction:
        """Halo in metres of a block of the terrain that usually suffices, 1 % more than `max_edge`."""
        return self.config.max_edge * Fraction(101, 100)

    @property
    def thin_ground(self) -> bool:
        """Whether the surface is made of one ground point per cell of a quarter of a pixel's side.

        This is the case if a part of a block would have more than `MAX_GROUND` points with the mean density, or if the
        smallest part would have more in the densest place.
        """
        if self.thin is not None:
            return self.thin
        mean = self.density * self._part_side_m(PART) ** 2
        return max(mean, self.density_map.max_points(self._part_side_m(MIN_PART))) > MAX_GROUND

    @property
    def surface_share(self) -> int | None:
        """Number of cells along a pixel's side, each with one point of the surface.

        None if all ground points make the surface.
        """
        if self.config.surface_percent is not None:
            return SURFACE_SHARE
        if self.thin_ground:
            return THIN_SHARE
        return None

    def _part_side_m(self, pixels: int) -> float:
        """Return the side of the window of a part of a block, in metres."""
        return pixels * float(self.resolution) + 2 * float(self.grid_halo)

    @property
    def max_part_points(self) -> float:
        """Approximate number of points in the smallest part of a block, in the densest place."""
        side = self._part_side_m(MIN_PART)
        points = max(self.density * side**2, self.density_map.max_points(side))
        if self.surface_share is None:
            return points
        return min(points, (side * self.surface_share / float(self.resolution)) ** 2)

    @property
    def block_points(self) -> int:
        """Maximum number of points in the window of a block that is not divided into parts."""
        return max((self.memory - BASE_BYTES - self.line_bytes) // GROUND_BYTES, MAX_GROUND // 8)

    @property
    def halo_m(self) -> float:
        """Widest halo with which a pass starts, in metres."""
        return max((step.halo_m for step in self.steps), default=0.0)

    @property
    def tiles(self) -> int:
        """Approximate number of filter tiles: the area that the points cover, divided by the area of a tile."""
        return max(math.ceil(self.area_m2 / float(self.tile) ** 2), 1)

    @property
    def max_bucket_points(self) -> float:
        """Approximate number of points in the densest bucket."""
        return max(self.density * self.bucket_m**2, self.density_map.max_points(self.bucket_m))

    def max_window_points(self) -> int:
        """Estimate the number of points in the densest window of a filter tile with its halo."""
        side = float(self.tile) + 2 * self.halo_m
        mean = min(self.density * side**2, self.points)
        return int(max(mean, self.density_map.max_points(side)))

    @cached_property
    def line_bytes(self) -> int:
        """Bytes that a worker needs for breaklines."""
        frame, window_m = self.meta.frame, Fraction(self._part_side_m(BLOCK_PIXELS))
        return breakline_bytes(
            self.lines, float(frame.counts(self.resolution)), float(frame.counts(window_m))
        )
