"""Arguments of the tasks that make rasters: one frozen dataclass for each kind of work."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.ground import GroundSelection
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

    rule: GroundSelection


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
