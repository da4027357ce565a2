"""Records of the tasks of the stage grid, with a type for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tiler.core.records import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockRecord(Record):
    """Record of a block of a raster.

    Attributes
    ----------
    filled : int
        Number of pixels or cells that have a value.
    checksum : str
        Checksum of the pixels, empty before they are written.
    pixels : int, optional
        Number of pixels. Rasters of coarse cells that no step makes do not have it.
    """

    filled: int
    checksum: str = ""
    pixels: int | None = None


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
    edited : list of [number, pixels], optional
        Number (name) of each edit in the block, and count of the pixels that it changed.
    """

    nodata: int
    marked: int
    tries: int
    halo: int
    ground_read: int
    ground_used: int
    ground_marked: int
    edited: list[tuple[int, int]] | None = None


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
