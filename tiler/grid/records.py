"""Values that tasks of the stage grid get, and records that they return."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from ptd.arrays import Bool, Float32
from tiler.core.lattice import Bounds, Lattice
from tiler.core.points import GROUND, UNCERTIFIED_BIT, WITHHELD_FLAG
from tiler.core.raster import Block, RasterSpec
from tiler.core.records import NOT_IN_DIGEST, BlockRecord, Record


@dataclass(frozen=True)
class GroundSelection:
    """Rule for the points that are ground.

    Attributes
    ----------
    labels : str or None
        Name in the store of the labels that are the classes. None for the classes of the input.
    classes : tuple of int
    skip_flags : int
        Bits of `PointBlock.flags` that exclude a point. Withheld points are always excluded.
    erode : Fraction
        Plan distance in counts. A ground point this near to a point of an object that is at least ``erode_rise``
        vertical counts higher is left out, as image matching smears walls onto the ground next to them. 0 keeps all.
    edits : str or None
        Key in the store of the edits, which override the classification of ground.
    """

    labels: str | None
    classes: tuple[int, ...] = (GROUND,)
    skip_flags: int = WITHHELD_FLAG
    erode: Fraction = Fraction(0)
    erode_rise: int = 0
    edits: str | None = field(default=None, metadata=NOT_IN_DIGEST)

    def is_ground(self) -> Bool:
        """Return whether each class or label is ground: bool (256,)."""
        table = np.zeros(256, np.bool_)
        for value in self.classes:
            table[[value, value | UNCERTIFIED_BIT] if self.labels is not None else [value]] = (
                True
            )
        return table


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


@dataclass(frozen=True, slots=True, kw_only=True)
class TerrainRecord(BlockRecord):
    """Record of a block of the terrain.

    Attributes
    ----------
    nodata, marked : int
        Number of pixels without a height, and of uncertified pixels.
    tries, halo : int
        Number of tries, and the halo of the last one in counts.
    ground_read, ground_used, ground_marked : int
        Number of ground points in the window of the last try: all, vertices of the TIN, and uncertified points.
    """

    nodata: int
    marked: int
    tries: int
    halo: int
    ground_read: int
    ground_used: int
    ground_marked: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelRecord(Record):
    """Record of a body of water with its level.

    Attributes
    ----------
    shore : int
        Number of pixels of the shore with a height.
    body : mapping or None
        Water with its level (`Water.to_json`), or None if shore and water have too few heights.
    floating : (float, [x, y] or None)
        Share of the shore that lies more than `tiler.grid.water_level.NOISE_M` below the level, and the position
        deepest below the level in counts. None if the share is 0.
    uneven : bool
        Whether the body has one level although its heights differ by more than waves cause.
    """

    shore: int
    body: Mapping[str, Any] | None
    floating: tuple[float, list[int] | None]
    uneven: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class DeckRecord(Record):
    """Deck of a bridge.

    Attributes
    ----------
    ring : list of [x, y]
        Outline in counts.
    surface : list of float
        First eight fields of `tiler.core.edits.DeckSurface`, in counts.
    length_m, width_m, clearance_m : float
    below : int
        Number of points below the deck.
    """

    ring: list[list[int]]
    surface: list[float]
    length_m: float
    width_m: float
    clearance_m: float
    below: int


def checksum(values: Float32) -> str:
    """Return the BLAKE2b of the pixels, row by row. A task that reads the block depends on it."""
    return hashlib.blake2b(values.tobytes(), digest_size=16).hexdigest()
