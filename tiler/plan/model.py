"""The plan of a run: all decisions before the first point is read, and values derived from them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path

from ptd.matched.evidence import Evidence, Finding, decided_by
from tiler.config import RunConfig
from tiler.core.area import Area
from tiler.core.breaklines import Counts
from tiler.core.drawn_sheets import DrawnSheet
from tiler.core.edits import Edit
from tiler.core.lattice import Bounds, CoordFrame, Lattice
from tiler.core.raster import BLOCK_PIXELS, MIN_PART
from tiler.core.surveys import REACH_M
from tiler.core.water import Water
from tiler.inputs import SourceInfo
from tiler.plan.memory import (
    BASE_BYTES,
    GROUND_BYTES,
    breakline_bytes,
    elected_bytes,
    joined_bytes,
)
from tiler.plan.method import KEEP, MethodPlan, PlannedPass, nested
from tiler.plan.sizes import DensityMap
from tiler.plan.surveys import Survey
from tiler.store import StoreMeta

BRIDGE_REACH_M = 300
"""Distance around an area within which points are read for bridges across the border of the
area. It is the length of the longest bridge."""

PIECE_POINTS = 1_000_000
"""Number of points that a worker decodes at a time."""
MAX_GROUND = 4_000_000
"""Maximum number of points in the window of a part of a block. The surface of denser clouds is
thinned to one point per cell of a quarter pixel."""
PERCENTILE_CELLS = 2
"""Number of cells along a pixel's side if the surface is a percentile of the heights. Each cell
gives one point."""
THINNING_CELLS = 4
"""Number of cells along a pixel's side if ground points are thinned to save memory. Each cell
gives one point."""
PART = 128
"""Side, in pixels, of the parts into which a block with many points is divided."""


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Inputs that a run reads.

    Attributes
    ----------
    sources : tuple of SourceInfo
        Files that can be read and lie near the area, sorted by path.
    left_out : tuple of (str, str)
        Path and reason of each file that is left out.
    area : Area or None
        Area for which products and labels are made; None for the whole survey.
    points : int
        Number of points that are read.
    covered_m2 : float
        Area in m2 that the points cover. Overlaps of files count once.
    extent : Bounds
        Extent of the points within the area, in absolute counts.
    density_map : DensityMap
        Map that finds the densest place.
    cloud_names : dict of Path to Path
        Path of the classified file of each source, relative to OUT/classified.
    evidence : Evidence
        Evidence on the source of the clouds, found in the fields of their points.
    edits : tuple of Edit
        Edits, in the order of their file.
    lines : tuple of int64 (n, 3)
        Vertices of breaklines, in absolute counts.
    waters : tuple of Water
        Bodies of water in the file given by ``--water``, with heights if it has them.
    sheets : tuple of DrawnSheet
        Sheets in the file given by ``--sheets`` near the points, in the order of their file.
    surveys : tuple of Survey
        Surveys of the setting `priority`, the one that counts most first; empty if all points count.
    """

    sources: tuple[SourceInfo, ...]
    left_out: tuple[tuple[str, str], ...]
    area: Area | None
    points: int
    covered_m2: float
    extent: Bounds
    density_map: DensityMap
    cloud_names: Mapping[Path, Path]
    evidence: Evidence
    edits: tuple[Edit, ...] = ()
    lines: tuple[Counts, ...] = ()
    waters: tuple[Water, ...] = ()
    sheets: tuple[DrawnSheet, ...] = ()
    surveys: tuple[Survey, ...] = ()

    @property
    def filled(self) -> list[SourceInfo]:
        """Sources with points."""
        return filled_sources(self.sources)

    @property
    def area_key(self) -> str | None:
        """Name of the area in the store, or None if the run has no area."""
        return None if self.area is None else self.area.key

    @property
    def density(self) -> float:
        """Points per square metre of the area that they cover. Overlaps count once."""
        return self.points / self.covered_m2 if self.covered_m2 else 0.0

    def max_points(self, side_m: float) -> float:
        """Estimate the number of points in the densest square with a side in metres."""
        densest = max(self.density * side_m**2, self.density_map.max_points(side_m))
        return min(densest, self.points)


def filled_sources(sources: Iterable[SourceInfo]) -> list[SourceInfo]:
    """Return the sources with points."""
    return [s for s in sources if s.points and s.bounds is not None]


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Lattices of the store and of the rasters.

    Attributes
    ----------
    meta : StoreMeta
        Frame of the counts, and lattices of buckets and candidates.
    resolution : Fraction
        Side of a pixel in metres.
    halo_m : Fraction
        Halo in metres of a block of the terrain that usually suffices, 1 % more than `max_edge`.
    thin : bool or None
        Whether the first run on the store thinned the ground points; None if this is the first run.
    finest : Fraction or None
        Side of a pixel in metres of the finest resolution, if this is a coarser one.
    """

    meta: StoreMeta
    resolution: Fraction
    halo_m: Fraction
    thin: bool | None = None
    finest: Fraction | None = None

    @property
    def surface_pixel(self) -> Fraction:
        """Side of a pixel in metres on which the surface depends: heights of all resolutions are on one surface."""
        return self.finest or self.resolution

    @property
    def bucket_m(self) -> float:
        """Side of a bucket in metres."""
        return float(self.meta.bucket.size * self.meta.frame.metres_xy)

    @property
    def fine_m(self) -> Fraction:
        """Side in metres of the store's cells with one candidate each."""
        return self.meta.fine.size * self.meta.frame.metres_xy

    def part_side_m(self, pixels: int) -> float:
        """Return the side in metres of the window of a part of a block. The part has ``pixels`` pixels along a side."""
        return pixels * float(self.resolution) + 2 * float(self.halo_m)


@dataclass(frozen=True, kw_only=True)
class Resources:
    """Workers of a run and the memory of each.

    Attributes
    ----------
    memory : int
        Memory that a worker may use, in bytes.
    workers : int
        Number of workers.
    """

    memory: int
    workers: int


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Plan of a run, with lengths in metres and sizes in bytes."""

    config: RunConfig
    inputs: Inputs
    grid: Grid
    method: MethodPlan
    resources: Resources
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def frame(self) -> CoordFrame:
        """Frame of the counts in the store."""
        return self.grid.meta.frame

    @property
    def buckets(self) -> Lattice:
        """Lattice of the buckets of the store."""
        return self.grid.meta.bucket

    @property
    def writes_clouds(self) -> bool:
        """Whether the run writes classified clouds, not with `--method keep` or `--classified none`."""
        return self.config.method != KEEP and self.config.classified != "none"

    @property
    def writes_overview(self) -> bool:
        """Whether the run writes an overview of its classified clouds, as there are several."""
        return self.writes_clouds and len(self.inputs.cloud_names) > 1

    @property
    def finding(self) -> Finding | None:
        """Source of the clouds with confidence and reasons, if the fields of the points decide it.

        None if they do not decide it, if the method treats all kinds alike, or if the user or
        an earlier run gives the kind.
        """
        if not self.method.depends_on_kind or self.method.kind is None:
            return None
        if self.method.statistics is not None or self.config.source_kind is not None:
            return None
        return decided_by(self.inputs.evidence)

    @property
    def sides_m(self) -> tuple[float, float]:
        """Width and height of the survey, in metres."""
        bounds, metres = self.inputs.extent, float(self.grid.meta.frame.metres_xy)
        return (bounds.x1 - bounds.x0) * metres, (bounds.y1 - bounds.y0) * metres

    @property
    def on_candidates(self) -> bool:
        """Whether the method needs only candidates, as each of its cells is a whole number of the store's cells."""
        return nested(self.method.candidate_cell_m, self.grid.fine_m)

    def joins(self, step: PlannedPass) -> bool:
        """Return whether a pass gets joined tiles: the largest that fit into memory and occupy all workers.

        It gets them if it reads one point per cell, a candidate or an elected point, and the
        user did not choose a tile size.
        """
        if self.method.tile_workers == 0:
            return False
        return step.pass_.elected or (step.on_candidates and self.on_candidates)

    def tile_memory_of(self, step: PlannedPass) -> int:
        """Return the memory of a worker for which the tiles of a pass are cut, in bytes."""
        if self.joins(step):
            return joined_bytes(step, self.method.tile_memory)
        if step.fits_surfaces:
            return elected_bytes(self.method.tile_memory)
        return self.method.tile_memory

    @property
    def margin(self) -> int:
        """Distance around the area within which points are read, in counts.

        It is the largest of three distances: the halos with which passes start, the distance
        over which labels and bridges are decided, and the halo of a block of the terrain.
        With several surveys, the distance over which one covers another is added.
        """
        labels = max(
            (Fraction(step.pass_.label_margin_m) for step in self.method.steps),
            default=Fraction(0),
        )
        if self.config.bridges == "remove":
            labels += BRIDGE_REACH_M
        margin_m = max(Fraction(self.method.halo_m), self.grid.halo_m, labels)
        if self.config.priority is not None:
            margin_m += REACH_M
        return math.ceil(self.grid.meta.frame.counts(margin_m))

    @property
    def thin_ground(self) -> bool:
        """Whether the surface is made of one ground point per cell of a quarter of a pixel's side.

        The first run on a store decides it by `exceeds_max_ground`, and later runs do the same.
        """
        return self.exceeds_max_ground if self.grid.thin is None else self.grid.thin

    @property
    def exceeds_max_ground(self) -> bool:
        """Whether a part of a block may have more than `MAX_GROUND` points.

        It is true for a part with the mean density, or for the smallest part in the densest
        place. No part has more points than the inputs.
        """
        mean = self.inputs.density * self.grid.part_side_m(PART) ** 2
        densest = self.inputs.density_map.max_points(self.grid.part_side_m(MIN_PART))
        return min(max(mean, densest), self.inputs.points) > MAX_GROUND

    @property
    def surface_cells(self) -> int | None:
        """Number of cells along a pixel's side, each with one point of the surface.

        None if all ground points make the surface.
        """
        if self.config.surface_percent is not None:
            return PERCENTILE_CELLS
        if self.thin_ground:
            return THINNING_CELLS
        return None

    @property
    def max_part_points(self) -> float:
        """Approximate number of points in the smallest part of a block, in the densest place."""
        side = self.grid.part_side_m(MIN_PART)
        points = self.inputs.max_points(side)
        if self.surface_cells is None:
            return points
        return min(points, (side * self.surface_cells / float(self.grid.surface_pixel)) ** 2)

    @property
    def block_points(self) -> int:
        """Maximum number of points in the window of a block that is not divided into parts."""
        return max(
            (self.resources.memory - BASE_BYTES - self.line_bytes) // GROUND_BYTES,
            MAX_GROUND // 8,
        )

    @property
    def tiles(self) -> int:
        """Approximate number of filter tiles: the area that the points cover, divided by the area of a tile."""
        return max(math.ceil(self.inputs.covered_m2 / float(self.method.tile) ** 2), 1)

    @property
    def max_bucket_points(self) -> float:
        """Approximate number of points in the densest bucket."""
        return self.inputs.max_points(self.grid.bucket_m)

    def max_window_points(self) -> int:
        """Estimate the number of points in the densest window of a filter tile with its halo."""
        side = float(self.method.tile) + 2 * self.method.halo_m
        mean = min(self.inputs.density * side**2, self.inputs.points)
        return int(max(mean, self.inputs.density_map.max_points(side)))

    @cached_property
    def line_bytes(self) -> int:
        """Bytes that a worker needs for breaklines."""
        counts = self.grid.meta.frame.counts
        pixel = float(counts(self.grid.surface_pixel))
        window = float(counts(Fraction(self.grid.part_side_m(BLOCK_PIXELS))))
        return breakline_bytes(self.inputs.lines, pixel, window)
