"""Arguments of the tasks that make rasters: one frozen dataclass for each kind of work."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

from tiler.core.area import Area
from tiler.core.edits import Edit
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.core.water import Water
from tiler.grid.ground import GroundRule
from tiler.schedule import NOT_IN_DIGEST


@dataclass(frozen=True, kw_only=True)
class BlockWork:
    """Work that writes one block of a raster.

    Attributes
    ----------
    name : str
        Of the raster in the store.
    spec : RasterSpec
        Of the whole raster.
    block : Block
        Aligned to the raster's chunks.
    """

    name: str
    spec: RasterSpec
    block: Block

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the block."""
        return self.spec.block_bounds(self.block)


@dataclass(frozen=True, kw_only=True)
class PointsBlock(BlockWork):
    """A block made from points: their density, or which coarse cells they occupy."""

    rule: GroundRule


@dataclass(frozen=True, kw_only=True)
class DistanceBlock(PointsBlock):
    """``cap``: counts; what lies farther from all ground points has this distance."""

    cap: Fraction


@dataclass(frozen=True, kw_only=True)
class TinBlock(PointsBlock):
    """A block whose pixels are interpolated on a TIN.

    Attributes
    ----------
    data : Bounds
        Of all points of the run; there are none beyond.
    max_edge : Fraction
        Counts: limit of a facet's longest edge and circumradius.
    halo : int
        Counts around the block to begin with.
    interpolation : str
        ``linear``, ``natural`` or ``idw``; all fill the same pixels.
    """

    data: Bounds
    max_edge: Fraction
    halo: int
    interpolation: str = "linear"


@dataclass(frozen=True, kw_only=True)
class GridBlock(TinBlock):
    """A block of the terrain.

    Attributes
    ----------
    max_halo : int or None
        Counts at most; None: `tiler.grid.full_halo`.
    thin : Lattice or None
        Of the ground points in a cell of it only one is used: that at ``percent`` of their heights, or the central one
        where that is None. One value for the whole run, as another one is another surface.
    percent : int or None
    breaklines : str or None
        Key in the store of lines that the surface follows; which of them touch a block is in its digest.
    max_points : int or None
        A block whose window holds more is done in quarters, with the same pixels; None: never.
    """

    max_halo: int | None = None
    thin: Lattice | None = None
    percent: int | None = None
    breaklines: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    max_points: int | None = field(default=None, metadata=NOT_IN_DIGEST)


@dataclass(frozen=True)
class GridBlocks:
    """Blocks of the terrain, which differ in their places alone, that are made from one TIN."""

    blocks: tuple[GridBlock, ...]


@dataclass(frozen=True, kw_only=True)
class SurfaceBlock(TinBlock):
    """A block of the surface model.

    Attributes
    ----------
    spike : Fraction
        Vertical counts by which a return may rise above all others within ``reach``.
    reach : int
        Pixels.
    terrain : str
        Raster of the same pixels, below which the surface never is.
    """

    spike: Fraction
    reach: int
    terrain: str


@dataclass(frozen=True, kw_only=True)
class FindDeckCells(BlockWork):
    """A block of coarse cells of which some may be decks of bridges; ``rule`` as without corrections."""

    rule: GroundRule


@dataclass(frozen=True)
class ExamineDecks:
    """Places of which each may be the deck of a bridge.

    Attributes
    ----------
    rule : GroundRule
    spec : RasterSpec
        Of the cells.
    places : tuple of tuples of (row, column, direction)
        The cells of each, see `tiler.grid.deck_cells.deck_cells`.
    """

    rule: GroundRule
    spec: RasterSpec
    places: tuple[tuple[tuple[int, int, int], ...], ...]


@dataclass(frozen=True)
class SurveyEdit:
    """A correction whose points are counted: ``cell`` as of `tiler.core.edits.Edits`, ``cells`` that it touches."""

    rule: GroundRule
    edit: Edit
    cell: Lattice
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class MakeSurvey:
    """The raster of the survey, made at once.

    Attributes
    ----------
    name : str
    spec : RasterSpec
        Of the coarse cells.
    occupancy : str
        Name of that raster.
    gap, most_gap : float
        Cells: a gap that belongs to every survey, and the widest that belongs to one of sparse points.
    pixels : RasterSpec
        Of the products.
    """

    name: str
    spec: RasterSpec
    occupancy: str
    gap: float
    most_gap: float
    pixels: RasterSpec


@dataclass(frozen=True, kw_only=True)
class OutlineBlock(BlockWork):
    """A block of a model with its water level, and without the heights beyond the survey.

    Attributes
    ----------
    heights : str
        The model.
    survey : str
    coarse : RasterSpec
        Of the cells of the survey.
    cut : bool
        Leave out what lies beyond the survey.
    waters, edits : str or None
        Keys in the store of bodies of water and of corrections, which come after them; those that touch a block are
        in its digest.
    """

    heights: str
    survey: str
    coarse: RasterSpec
    cut: bool = True
    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)


@dataclass(frozen=True)
class FindWater:
    """The water of a run, found at once.

    Attributes
    ----------
    heights : str
        The terrain.
    spec : RasterSpec
        Of its pixels.
    blocks : tuple of str
        Names of its blocks.
    occupancy : str
    coarse : RasterSpec
        Of the coarse cells.
    gap : float
        Cells: a gap between points up to this width may be water.
    trusted : bool
        Few returns tell of water; False: only the input's class does.
    lake_m2, river_width_m, island_m2 : float
        The smallest that are wanted.
    """

    heights: str
    spec: RasterSpec
    blocks: tuple[str, ...]
    occupancy: str
    coarse: RasterSpec
    gap: float
    trusted: bool
    lake_m2: float
    river_width_m: float
    island_m2: float


@dataclass(frozen=True)
class LevelWater:
    """A body of water whose height is to be found.

    Attributes
    ----------
    body : Water
    others : tuple of Area
        Water beside it, which is no shore.
    heights : str
        The terrain.
    spec : RasterSpec
    """

    body: Water
    others: tuple[Area, ...]
    heights: str
    spec: RasterSpec

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the water."""
        return self.body.area.bounds


@dataclass(frozen=True)
class VoidRasters:
    """The rasters that say where a model has voids.

    Attributes
    ----------
    heights : str
        The model.
    spec : RasterSpec
        Of its pixels.
    survey : str
    coarse : RasterSpec
        Of the cells of the survey.
    numbers : str
        The raster of the same cells with the number of the void in each.
    """

    heights: str
    spec: RasterSpec
    survey: str
    coarse: RasterSpec
    numbers: str


@dataclass(frozen=True)
class Void:
    """A void of a model: its number from 1 on, and the window of coarse cells that it lies in."""

    number: int
    cells: Block


@dataclass(frozen=True)
class FillBlock:
    """A block of a model with its voids filled.

    Attributes
    ----------
    name : str
    block : Block
    rasters : VoidRasters
    voids : tuple of Void
        Those that may touch the block.
    edits : str or None
        Key in the store of corrections of heights; which of them touch a block is in its digest.
    """

    name: str
    block: Block
    rasters: VoidRasters
    voids: tuple[Void, ...]
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)

    def place(self, buckets: Lattice) -> Bounds | None:
        """Bounds of the block."""
        return self.rasters.spec.block_bounds(self.block)


@dataclass(frozen=True, kw_only=True)
class MaskBlock(PointsBlock):
    """A block of the mask.

    Attributes
    ----------
    dtm, filled : str
        Rasters of heights within the limit, and of those that people get, with holes filled and cut by the outline.
    survey : str
    coarse : RasterSpec
        Of the cells of the survey.
    holes : tuple of Bounds
        Of tiles that failed.
    area : str or None
        Key in the store of the area, outside of which all is outside.
    waters : str or None
        Key in the store of bodies of water; those that touch a block are in its digest.
    """

    dtm: str
    filled: str
    survey: str
    coarse: RasterSpec
    holes: tuple[Bounds, ...] = ()
    area: str | None = None
    waters: str | None = field(default=None, metadata=NOT_IN_DIGEST)


@dataclass(frozen=True, kw_only=True)
class DeriveBlock(BlockWork):
    """A block of a raster that follows from others.

    Attributes
    ----------
    sources : tuple of str
        The terrain's raster; for ``ndsm`` the surface's and the terrain's.
    fill : float
        Where it has no value.
    """

    sources: tuple[str, ...]
    fill: float


@dataclass(frozen=True)
class BlankBlocks:
    """Blocks of a raster that are to hold nothing any more."""

    name: str
    blocks: tuple[Block, ...]
