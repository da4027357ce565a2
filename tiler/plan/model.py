"""The plan: what was settled before the first point is read, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.breaklines import Counts
from tiler.core.edits import Edit
from tiler.core.lattice import Bounds
from tiler.core.raster import BLOCK_PIXELS
from tiler.core.stage_names import stage_title
from tiler.core.water import Water
from tiler.grid import SMALLEST_PART
from tiler.ingest import SourceInfo
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
"""Distance around an area within which points are read for bridges across its border: the length of the longest."""
KEEP = "keep"
"""The method that trusts the classes of the input."""

PIECE_POINTS = 1_000_000
MAX_GROUND = 4_000_000
"""Points that the window of a part of a block may hold; denser clouds give one a quarter pixel, everywhere."""
SURFACE_SHARE, THIN_SHARE = 2, 4
"""Cells along a pixel's side of which each gives one point to the surface: by percentile, and to save memory."""
PART = 128
"""Pixels a side of the parts into which blocks are divided where points are many."""


LEAST_CANDIDATES = 500_000
"""A tile is not halved for want of others if it holds less than twice as many."""

LEAST_MATCHED_M2 = 0.5
"""Sparser clouds are no matched ones if nobody says so: `auto` asks for twice as many points a square metre."""


def known_kind(config: RunConfig, statistics: Mapping[str, Any] | None) -> str | None:
    """What made the cloud, as the user or the run whose statistics are used says; None: the points will show."""
    if statistics is None:
        return config.source_kind
    found = (state["survey"]["kind"] for state in statistics.values() if "kind" in state.get("survey", {}))
    return next(found, None)


def likely_of(steps: Iterable[PlannedPass], kind: str | None, density: float) -> tuple[PlannedPass, ...]:
    """The passes for which memory is needed: of those that a run may do, all that suit the density."""
    sparse = kind is None and density < LEAST_MATCHED_M2
    return tuple(step for step in steps if not (sparse and step.kind == "dim"))


def steps_of(passes: Iterable[PlannedPass], kind: str | None) -> tuple[PlannedPass, ...]:
    """The passes that a cloud of that kind (None: not known) may need."""
    return tuple(step for step in passes if step.kind is None or kind in (None, step.kind))


@dataclass(frozen=True)
class Plan:
    """What a run will do; lengths in metres, sizes in bytes.

    Attributes
    ----------
    sources : tuple of SourceInfo
        That can be read and come near the area, in the order of their names.
    unreadable : tuple of (str, str)
        Path and reason of each file that is left out.
    area : Area or None
        Of which products and labels are wanted; None: everywhere.
    memory : int
        That a worker may use.
    tile_memory : int
        That the tiles are cut for: `memory` of the first run on a store, whatever later ones may use.
    thin : bool or None
        As the first run on a store decided; None: as `thin_ground` does.
    density_map : DensityMap
        Where the points are thickest.
    names : dict of Path to Path
        Of each source's classified file, below OUT/classified.
    passes : tuple of PlannedPass
        All of the method, by number; `steps` are those that may be done.
    statistics : dict or None
        State after each pass, by its name, of the earlier run that ``--statistics`` names.
    edits : tuple of Edit
        Corrections, in the order of their file.
    lines : tuple of int64 (n, 3)
        Vertices of breaklines, absolute counts.
    waters : tuple of Water
        Bodies of water that a file says, in its order; heights where it has them.
    tile_workers : int
        `workers` of the first run on a store: there are as many tiles, if the points suffice. 0: a size was asked for.
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

    @property
    def writes_clouds(self) -> bool:
        """Whether the run writes classified clouds: not with the classes of the input, nor if none are wanted."""
        return self.config.method != KEEP and self.config.classified != "none"

    @property
    def area_key(self) -> str | None:
        """Name of the area in the store; None where all is wanted."""
        return None if self.area is None else self.area.key

    @property
    def filled(self) -> list[SourceInfo]:
        """Sources that hold points."""
        return [s for s in self.sources if s.points and s.bounds is not None]

    @property
    def kind(self) -> str | None:
        """What made the cloud, laser scanning (lidar) or image matching (dim); None: the points will show."""
        return known_kind(self.config, self.statistics)

    @property
    def steps(self) -> tuple[PlannedPass, ...]:
        """The passes that the run may do."""
        return steps_of(self.passes, self.kind)

    def title_of(self, stage: str) -> str:
        """A stage of the run in words."""
        return stage_title(stage, [step.title for step in self.passes])

    @property
    def likely(self) -> tuple[PlannedPass, ...]:
        """The passes for which the plan reserves memory."""
        return likely_of(self.steps, self.kind, self.density)

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the cloud may be, where the method has passes for one kind alone and it is not known; else nothing."""
        return (
            tuple(dict.fromkeys(step.kind for step in self.steps if step.kind)) if self.kind is None else ()
        )

    def halo_of(self, kind: str) -> float:
        """The widest halo that a pass starts with, metres, if the cloud is of that kind."""
        return max(step.halo_m for step in steps_of(self.passes, kind))

    @property
    def sides_m(self) -> tuple[float, float]:
        """Of the survey, west to east and south to north."""
        bounds, metres = self.extent, float(self.meta.frame.metres_xy)
        return (bounds.x1 - bounds.x0) * metres, (bounds.y1 - bounds.y0) * metres

    def wanted_tiles(self, candidates: int) -> int:
        """How many joined tiles a pass on so many points wants: one a worker, a power of two, none of them small."""
        return min(1 << (self.tile_workers - 1).bit_length(), max(candidates // LEAST_CANDIDATES, 1))

    @property
    def fine_m(self) -> Fraction:
        """Side of the store's cells with one candidate each."""
        return self.meta.fine.size * self.meta.frame.metres_xy

    @property
    def on_candidates(self) -> bool:
        """Whether the method's cells are made of the store's: then its passes need no other points than candidates."""
        return nested(self.candidate_cell_m, self.fine_m)

    def joins(self, step: PlannedPass) -> bool:
        """Whether tiles of a pass are as large as memory allows: it looks at candidates, and no size was asked for."""
        return self.tile_workers > 0 and step.on_candidates and self.on_candidates

    def tile_memory_of(self, step: PlannedPass) -> int:
        """Bytes of a worker that the tiles of a pass are cut for."""
        return min(self.tile_memory, JOINED_BYTES) if self.joins(step) else self.tile_memory

    @property
    def margin(self) -> int:
        """Counts around the area within which points are read.

        The widest halo that a pass starts with, what labels are made with and bridges are found by, and what a facet at
        the edge can reach.
        """
        labels = max((Fraction(step.work.label_margin_m) for step in self.steps), default=Fraction(0))
        labels += BRIDGE_REACH_M if self.config.bridges == "remove" else 0
        return math.ceil(self.meta.frame.counts(max(Fraction(self.halo_m), self.grid_halo, labels)))

    @property
    def density(self) -> float:
        """Points per square metre of the sources' bounds."""
        return self.points / self.area_m2 if self.area_m2 else 0.0

    @property
    def bucket_m(self) -> float:
        """Side of a bucket."""
        return float(self.meta.bucket.size * self.meta.frame.metres_xy)

    @property
    def grid_halo(self) -> Fraction:
        """Metres around a block with which it seldom needs more: a little more than the limit of a facet's edges."""
        return self.config.max_edge * Fraction(101, 100)

    @property
    def thin_ground(self) -> bool:
        """Whether only one ground point per quarter of a pixel's side makes the surface.

        It is so where a part of the mean density, or the smallest part in the fullest place, would hold too many.
        """
        if self.thin is not None:
            return self.thin
        mean = self.density * self._part_side_m(PART) ** 2
        return max(mean, self.density_map.fullest(self._part_side_m(SMALLEST_PART))) > MAX_GROUND

    @property
    def surface_share(self) -> int | None:
        """Cells along a pixel's side of which each gives one point to the surface; None: all ground points make it."""
        if self.config.surface_percent is not None:
            return SURFACE_SHARE
        return THIN_SHARE if self.thin_ground else None

    def _part_side_m(self, pixels: int) -> float:
        """Side of the window of a part of a block, metres."""
        return pixels * float(self.resolution) + 2 * float(self.grid_halo)

    @property
    def fullest_part(self) -> float:
        """About how many points a worker holds of the smallest part of a block, in the fullest place."""
        side = self._part_side_m(SMALLEST_PART)
        points = max(self.density * side**2, self.density_map.fullest(side))
        if self.surface_share is None:
            return points
        return min(points, (side * self.surface_share / float(self.resolution)) ** 2)

    @property
    def block_points(self) -> int:
        """Points in the window of a block above which it is done in parts."""
        return max((self.memory - BASE_BYTES - self.line_bytes) // GROUND_BYTES, MAX_GROUND // 8)

    @property
    def halo_m(self) -> float:
        """The widest halo that a pass starts with, metres."""
        return max((step.halo_m for step in self.steps), default=0.0)

    @property
    def tiles(self) -> int:
        """Filter tiles, if the sources' bounds were filled."""
        return max(math.ceil(self.area_m2 / float(self.tile) ** 2), 1)

    @property
    def fullest_bucket(self) -> float:
        """About how many points the fullest bucket holds."""
        return max(self.density * self.bucket_m**2, self.density_map.fullest(self.bucket_m))

    def fullest_window(self) -> int:
        """About how many points the fullest window of a filter tile holds, halo included."""
        side = float(self.tile) + 2 * self.halo_m
        mean = min(self.density * side**2, self.points)
        return int(max(mean, self.density_map.fullest(side)))

    @cached_property
    def line_bytes(self) -> int:
        """What a worker needs for the lines that the terrain follows."""
        frame, window_m = self.meta.frame, Fraction(self._part_side_m(BLOCK_PIXELS))
        return breakline_bytes(
            self.lines, float(frame.counts(self.resolution)), float(frame.counts(window_m))
        )
