"""What the stage grid works on, and a row of the table of rasters (`tiler.stages.raster_table`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction
from typing import Any

from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import RasterSpec
from tiler.core.water import Waters
from tiler.export.work import DrawnDeck
from tiler.grid import GroundRule
from tiler.plan import Plan
from tiler.schedule import Task, Work
from tiler.stages.tasks import Assembled, ground_rule, raster_spec
from tiler.store import Commits

COARSE_CELL_M = 2
"""Side of a coarse cell, where `--max-edge` is not small, nor a pixel larger."""
GAP_M = 20
"""Gaps up to this width belong to every survey: shadows of buildings, gaps between strips."""
MAX_COARSE_CELLS = 8_000_000
"""Coarse cells of a run at most; larger runs have larger cells, so that the memory of one worker suffices."""


class Grid(Enum):
    """Which lattice a raster is on."""

    PIXELS = "the pixels of the products"
    COARSE = "the coarse cells of the run"


@dataclass(frozen=True)
class Raster:
    """One raster of the store.

    Attributes
    ----------
    name : str
        In the store; the stage that makes it is ``grid-<name>``.
    inputs : tuple of str
        The rasters that it is made from, made before it, in the order in which ``tasks`` expects them.
    work : Work
        What makes a block of it, or the whole.
    grid : Grid
    tasks : callable
        ``tasks(raster, gridding)``: how its work is divided, and what the digest of each task depends on.
    fill : float
        What it holds where no block was written.
    """

    name: str
    inputs: tuple[str, ...]
    work: Work
    grid: Grid
    tasks: Callable[[Raster, Gridding], Iterator[Task]]
    fill: float = 0.0

    @property
    def stage(self) -> str:
        """Name of the stage of its tasks."""
        return f"grid-{self.name}"


@dataclass
class Gridding:
    """What the stage grid works on, and what it has made: name of a raster -> commits of its blocks.

    Attributes
    ----------
    holes : sequence of Bounds
        Where tiles failed, so that heights there, if any, come from elsewhere.
    decks : sequence of DrawnDeck
        Of bridges that are left out of the terrain.
    waters : Waters
        Bodies of water, once the terrain around them is made.
    """

    plan: Plan
    assembled: Assembled
    labels: Mapping[Cell, str]
    holes: Sequence[Bounds] = ()
    made: dict[str, Commits] = field(default_factory=dict)
    decks: Sequence[DrawnDeck] = ()
    waters: Waters = field(default_factory=lambda: Waters(()))

    @property
    def rule(self) -> GroundRule:
        """Which points are ground."""
        return ground_rule(self.plan)

    @property
    def water_key(self) -> str | None:
        """Name of the bodies of water in the store; None where there is none."""
        return self.waters.key if self.waters.bodies else None

    def seen(self, cells: Iterable[Cell]) -> list[list[Any]]:
        """What results depend on that see the points and labels of some buckets."""
        return [[cell.ix, cell.iy, self.labels[cell]] for cell in cells]

    def points(self, cells: Iterable[Cell]) -> int:
        """Points of some buckets."""
        return sum(self.assembled.records[cell]["n"] for cell in cells)

    def checksums(self, raster: str, blocks: Iterable[str] | None = None) -> list[list[str]]:
        """Name and checksum of each block of a raster, or of those of some blocks that were made."""
        made = self.made[raster]
        wanted = sorted(made) if blocks is None else (name for name in blocks if name in made)
        return [[name, made[name][1]["checksum"]] for name in wanted]

    @property
    def spec(self) -> RasterSpec:
        """Pixels of the products."""
        return raster_spec(self.plan, self.assembled)

    @property
    def coarse(self) -> RasterSpec:
        """Coarse cells of the run."""
        size, bounds = self.coarse_m, self.assembled.bounds
        return RasterSpec.covering(Lattice(self.plan.meta.frame.counts(size)), bounds)

    @property
    def coarse_m(self) -> Fraction:
        """Metres of a coarse cell."""
        size = max(min(Fraction(COARSE_CELL_M), self.plan.config.max_edge / 4), self.plan.resolution)
        area = self.assembled.bounds.area() * self.plan.meta.frame.metres_xy**2
        while area / size**2 > MAX_COARSE_CELLS:
            size *= 2
        return size

    def spec_of(self, raster: Raster) -> RasterSpec:
        """Pixels or cells of a raster."""
        return self.coarse if raster.grid is Grid.COARSE else self.spec
