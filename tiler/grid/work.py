"""Arguments of the tasks that make the terrain, and base classes of the arguments of other rasters."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

from tiler.core.digests import NOT_IN_DIGEST
from tiler.core.lattice import Bounds, Lattice
from tiler.core.raster import Block, RasterSpec
from tiler.grid.ground import GroundSelection


@dataclass(frozen=True, kw_only=True)
class BlockWork:
    """Arguments of a task that writes one block of a raster.

    Attributes
    ----------
    name : str
        Name of the raster in the store.
    spec : RasterSpec
        Size and position of the whole raster.
    block : Block
        Block that is aligned to the raster's chunks.
    """

    name: str
    spec: RasterSpec
    block: Block


@dataclass(frozen=True, kw_only=True)
class Facets:
    """Facets of a TIN that fill the pixels of a block.

    Attributes
    ----------
    data : Bounds
        Bounds of all points of the run.
    max_edge : Fraction
        Limit in counts of a facet's longest edge and circumradius.
    halo : int
        Halo of the first try, in counts.
    interpolation : str
        Interpolation method: ``linear``, ``natural`` or ``idw``. All fill the same pixels.
    """

    data: Bounds
    max_edge: Fraction
    halo: int
    interpolation: str = "linear"


@dataclass(frozen=True, kw_only=True)
class GridBlock(Facets, BlockWork):
    """Block of the terrain, interpolated on a TIN.

    Attributes
    ----------
    rule : GroundSelection
    max_halo : int or None
        Largest halo in counts; None for `tiler.grid.block.full_halo`.
    thin : Lattice or None
        Cells in which only one ground point is used: the point at ``percent`` of their heights, or the central point if
        ``percent`` is None. All blocks of a run have the same cells, since other cells make another surface.
    percent : int or None
        Percentile of heights.
    breaklines : str or None
        Key in the store of lines that the surface follows. The digest includes those that may change the block.
    max_points : int or None
        Number of points in a window above which a block is divided into quarters; None for no limit. Pixels do not
        depend on it.
    """

    rule: GroundSelection
    max_halo: int | None = None
    thin: Lattice | None = None
    percent: int | None = None
    breaklines: str | None = field(default=None, metadata=NOT_IN_DIGEST)
    max_points: int | None = field(default=None, metadata=NOT_IN_DIGEST)
