"""Context of the stage grid: what all its tasks have in common, corrections, and the rasters that were made.

A correction changes only the digests of the buckets and blocks that it can affect. No others are processed again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from fractions import Fraction
from typing import Any

from tiler.core.breaklines import Breaklines
from tiler.core.edits import DrawnDeck, Edits
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.points import GROUND, LABELS
from tiler.core.products import PRODUCTS
from tiler.core.raster import BLOCK_PIXELS, Block, RasterSpec
from tiler.core.records import BlockRecord, records_of
from tiler.core.water import Waters
from tiler.grid.block import full_halo
from tiler.grid.coarse import Joined, coarse_raster, join_pieces
from tiler.grid.records import Facets, GroundSelection
from tiler.grid.steps import Counts, Sources
from tiler.plan import KEEP, Plan
from tiler.runs.found import (
    CanopyCells,
    Gridded,
    IngestResult,
    checksums,
    final_raster,
    skip_flags,
)
from tiler.store import Commits


@dataclass(frozen=True)
class Corrections:
    """Edits and breaklines of a run, applied on top of the labels.

    Attributes
    ----------
    edits : Edits or None
    lines : Breaklines or None
    line_digests : mapping of Cell to str
        Digest of the breaklines in each bucket, even if the bucket has no points.
    decks : tuple of DrawnDeck
        Decks of bridges. ``edits`` remove the points of these decks from the terrain.
    """

    edits: Edits | None = None
    lines: Breaklines | None = None
    line_digests: Mapping[Cell, str] = field(default_factory=dict)
    decks: tuple[DrawnDeck, ...] = ()

    @property
    def edits_key(self) -> str | None:
        """Key in the store of the edits, or None if there are none."""
        return None if self.edits is None else self.edits.key

    @property
    def lines_key(self) -> str | None:
        """Key in the store of the breaklines, or None if there are none."""
        return None if self.lines is None else self.lines.key

    def edit_digests(self, extent: Bounds, actions: Sequence[str]) -> list[Any]:
        """Return the values of the edits with some actions within an extent, for digests."""
        return [] if self.edits is None else self.edits.digest(extent, actions)

    def line_digests_near(self, extent: Bounds, plan: Plan) -> list[Any]:
        """Return column, row and digest of the buckets whose breaklines can change facets within an extent."""
        counts, lattice = plan.frame.counts, plan.buckets
        facet_reach = full_halo(counts(plan.config.max_edge))
        facet_reach += math.ceil(3 * counts(plan.grid.resolution))
        near = lattice.among(extent.pad(facet_reach), self.line_digests)
        return [[cell.ix, cell.iy, self.line_digests[cell]] for cell in near]


COARSE_CELL_M = 2
"""Side of a coarse cell in metres, unless ``--max-edge`` is small or pixels are large.

Pixels up to `MAX_USUAL_PIXEL_M` do not change the side, so that the same water is found with
all of them.
"""
CANOPY_CELL_M = 2
"""Side of the cells of canopies in metres, unless pixels are larger."""
MAX_USUAL_PIXEL_M = 10
"""Pixels larger than this, in metres, are the coarse cells themselves.

Clouds for which such pixels are chosen are too sparse to find water.
"""
GAP_M = 20
"""Gaps up to this width, in metres, count as surveyed: shadows of buildings, gaps between
flight strips."""
ERODE_RISE_M = 1
"""Objects at least this much higher than a ground point near them exclude the point
(``--erode``), in metres."""
Place = tuple[int, int]
"""First row and column of a block."""


def ground_rule(plan: Plan) -> GroundSelection:
    """Return the rule for the points that are ground."""
    keep = plan.config.method == KEEP
    return GroundSelection(
        None if keep else LABELS,
        plan.config.ground_classes if keep else (GROUND,),
        skip_flags(plan),
        plan.frame.counts(plan.config.erosion),
        math.ceil(ERODE_RISE_M / plan.frame.metres_z),
    )


def coarse_cell_m(plan: Plan) -> Fraction:
    """Return the side of a coarse cell in metres."""
    usual = min(Fraction(COARSE_CELL_M), plan.config.max_edge / 4)
    if plan.grid.resolution <= MAX_USUAL_PIXEL_M:
        return usual
    return max(usual, plan.grid.resolution)


def has_large_pixels(plan: Plan) -> bool:
    """Return whether a pixel is larger than a coarse cell."""
    return plan.grid.resolution > coarse_cell_m(plan)


def canopy_cell_m(plan: Plan) -> Fraction:
    """Return the side in metres of the cells in which canopies are compared with the terrain around them."""
    return max(Fraction(CANOPY_CELL_M), plan.grid.surface_pixel)


class Grid(Enum):
    """Lattice of a raster."""

    PIXELS = "the pixels of the products"
    COARSE = "the coarse cells of the run"
    CANOPY = "cells in which canopies are compared with the terrain around them"


@dataclass
class GridContext:
    """Inputs and results of the stage grid.

    Attributes
    ----------
    labels : mapping of Cell to str
        Digest of the contents and labels of each bucket.
    holes : sequence of Bounds
        Bounds of the tiles that failed. Heights there, if any, come from points around the tiles.
    made : dict of str to Commits
        Commits of the blocks of each raster that was made.
    corrections : Corrections
    waters : Waters
        Bodies of water. They are set after the terrain around them is made.
    returns_show_water : bool
        Whether few returns are a sign of water: true for LiDAR, false for photogrammetric clouds, which have gaps
        anywhere.
    kind : str or None
        Kind of the clouds (`ptd.passes.KINDS`); None if it is not known.
    canopy : CanopyCells or None
        Cells in which the filter found a closed canopy, if there is any.
    fills : dict of str to float
        Value of the pixels of each raster that no block has.
    """

    plan: Plan
    assembled: IngestResult
    labels: Mapping[Cell, str]
    holes: Sequence[Bounds] = ()
    made: dict[str, Commits] = field(default_factory=dict)
    corrections: Corrections = field(default_factory=Corrections)
    waters: Waters = field(default_factory=lambda: Waters(()))
    returns_show_water: bool = True
    kind: str | None = None
    canopy: CanopyCells | None = None
    fills: dict[str, float] = field(default_factory=dict)
    _areas: dict[str, Joined] = field(default_factory=dict)

    @property
    def rule(self) -> GroundSelection:
        """Rule for the points that are ground, with the edits."""
        return replace(ground_rule(self.plan), edits=self.corrections.edits_key)

    def found(self) -> Gridded:
        """Return what later stages need."""
        return Gridded(
            plan=self.plan,
            assembled=self.assembled,
            spec=self.spec,
            coarse=self.coarse,
            made=self.made,
            fills=self.fills,
            waters=self.waters,
            edits=self.corrections.edits_key,
            decks=self.corrections.decks,
        )

    @property
    def sources(self) -> Sources:
        """What the reads of all steps have in common."""
        return Sources(
            rule=self.rule,
            pixels=self.spec,
            coarse=self.coarse,
            canopy_grid=self.canopy_cells,
            waters=self.waters.stored_key,
            area=self.plan.inputs.area_key,
            facets=self.facets,
            kind=self.kind,
            canopy=("", "")
            if self.canopy is None
            else (self.canopy.elected, self.canopy.labels),
        )

    @property
    def facets(self) -> Facets:
        """Facets of a TIN that fill pixels."""
        plan = self.plan
        return Facets(
            data=self.assembled.bounds,
            max_edge=plan.frame.counts(plan.config.max_edge),
            halo=math.ceil(plan.frame.counts(plan.grid.halo_m)),
        )

    def near(
        self, spec: RasterSpec, margin: int = 0, side: int = BLOCK_PIXELS
    ) -> dict[Block, list[Cell]]:
        """Return the blocks with buckets within ``margin`` counts (plus ``--erode``), each with these buckets."""
        margin += math.ceil(self.plan.frame.counts(self.plan.config.erosion))
        return spec.blocks_near(self.plan.buckets, self.labels, side, margin)

    def label_digests(self, cells: Iterable[Cell]) -> list[list[Any]]:
        """Return column, row and label digest of some buckets, for digests of tasks that read them."""
        return [[cell.ix, cell.iy, self.labels[cell]] for cell in cells]

    def n_points(self, cells: Iterable[Cell]) -> int:
        """Return the number of points of some buckets."""
        return sum(self.assembled.records[cell].n for cell in cells)

    def checksums(self, raster: str, blocks: Iterable[str] | None = None) -> list[list[str]]:
        """Return `checksums` of a raster."""
        return checksums(self.made[raster], blocks)

    def counts(
        self, raster: str, grid: Grid = Grid.COARSE, side: int = BLOCK_PIXELS
    ) -> dict[Block, Counts]:
        """Return the counts of each finished block of a raster that is made by a step."""
        spec, made = self.spec_of(grid), self.made[raster].items()
        return {spec.block_named(name, side): stored for name, (_, stored) in made}

    def delivered_heights(self, model: str) -> int:
        """Return the number of pixels with a height in the raster that is delivered as a model."""
        made = self.made[final_raster(model, self.plan.config)]
        return sum(record.filled for record in records_of(BlockRecord, made))

    def counts_at(self, raster: str, grid: Grid = Grid.COARSE) -> dict[Place, Counts]:
        """Return the counts of each finished block of a raster by place."""
        counts = self.counts(raster, grid).items()
        return {(block.row, block.col): of_block for block, of_block in counts}

    def places_with(self, raster: str, count: str, grid: Grid = Grid.COARSE) -> list[Place]:
        """Return the places of the blocks of a raster in which a count is not 0."""
        counts = self.counts_at(raster, grid).items()
        return [place for place, of_block in counts if of_block[count]]

    def areas(self, raster: str, corners: bool = False) -> Joined:
        """Return the connected areas of a raster of labels. ``corners``: cells may be connected by a corner."""
        if raster not in self._areas:
            self._areas[raster] = join_pieces(self.counts_at(raster), corners)
        return self._areas[raster]

    @property
    def water_is_sought(self) -> bool:
        """Whether water can be found, because few returns show it or because the input has the class of water."""
        return self.returns_show_water or any(
            counts["water"] for counts in self.counts("occupancy").values()
        )

    @property
    def spec(self) -> RasterSpec:
        """Pixel grid of the products around the stored points, or around their part in the area of the run.

        The edges of pixels lie at multiples of the resolution. Points exactly on the outer edge of
        the grid do not add pixels.
        """
        plan = self.plan
        extent = self.assembled.bounds
        if plan.inputs.area is not None:
            extent = extent.intersection(plan.inputs.area.bounds)
        return RasterSpec.enclosing(Lattice(plan.frame.counts(plan.grid.resolution)), extent)

    @property
    def coarse(self) -> RasterSpec:
        """Raster of the coarse cells, in blocks whose positions do not depend on the run."""
        return coarse_raster(
            Lattice(self.plan.frame.counts(self.coarse_m)), self.assembled.bounds
        )

    @property
    def coarse_m(self) -> Fraction:
        """Side of a coarse cell in metres."""
        return coarse_cell_m(self.plan)

    @property
    def canopy_cells(self) -> RasterSpec:
        """Raster of the cells of canopies, in blocks whose positions do not depend on the run."""
        side = self.plan.frame.counts(canopy_cell_m(self.plan))
        return coarse_raster(Lattice(side), self.assembled.bounds)

    def spec_of(self, grid: Grid) -> RasterSpec:
        """Return the lattice of a raster, and its extent."""
        if grid is Grid.CANOPY:
            return self.canopy_cells
        return self.coarse if grid is Grid.COARSE else self.spec


ABOVE = "dtm-above"
"""Step without pixels that counts where the terrain lies above all returns."""
LEFT = "dtm-left"
"""Step without pixels that finds objects left in the terrain."""
CANOPY, BELOW_CANOPY = "canopy", "canopy-below"
"""Rasters of a canopy that hides the ground, and of the terrain below it."""
CANOPY_CELLS, CANOPY_TERRAIN = "canopy-cells", "canopy-terrain"
"""Rasters of cells of canopies: the canopy, and the interpolated terrain around it."""


def nodata_of(product: str) -> float:
    """Return the nodata value of a product, or 0 if all pixels of the product have a value."""
    nodata = PRODUCTS[product].nodata
    return 0.0 if nodata is None else nodata
