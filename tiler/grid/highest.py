"""Highest and lowest return of each pixel of a block, read from the store."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.gridding.highest_returns import NOTHING, HighestReturns
from tiler.core.frame import COUNTS_PER_UNIT
from tiler.core.raster import NODATA, Block
from tiler.grid.coarse import padded
from tiler.grid.density import pixel_indices
from tiler.grid.ground import surface_points
from tiler.grid.work import PointsBlock
from tiler.store import TileStore, read_cells

__all__ = ["NOTHING", "ReturnsBlock", "highest_returns", "reach_pixels", "returns_of"]

Int32 = npt.NDArray[np.int32]

TALLEST_M = 1000
"""No structure is taller. Returns above are of clouds, aircraft or errors, however many support one another."""


@dataclass(frozen=True, kw_only=True)
class ReturnsBlock(PointsBlock):
    """Block made from the highest return of each pixel and from the terrain.

    Attributes
    ----------
    spike : Fraction
        Height in vertical counts by which a return may rise above all others within ``reach``.
    reach : int
        Search radius in pixels.
    terrain : str
        Raster of the terrain in the same pixels.
    """

    spike: Fraction
    reach: int
    terrain: str


def highest_returns(store: TileStore, work: ReturnsBlock, block: Block) -> Int32:
    """Return the highest supported return of each pixel, int32 (height, width, 3)."""
    return returns_of(store, work, block)[0]


def returns_of(store: TileStore, work: ReturnsBlock, block: Block) -> tuple[Int32, Int32]:
    """Return the highest supported return of each pixel, and the height of its lowest return (height, width).

    All points except withheld or skipped ones and noise (classes 7 and 18, by the input or by
    the filter) are used, since water and bridges are surface, but none more than `TALLEST_M` above the terrain.
    `HighestReturns.supported` removes spikes among the pixels within ``reach``. The lowest return is defined where
    there is a highest one.
    """
    radius, origin = work.reach, store.meta.frame.origin
    wider = padded(block, radius)
    bounds, limits = work.spec.block_bounds(wider), _limits(store, work, wider)
    lowest_limit = limits.min()
    highest = HighestReturns(wider.height, wider.width)
    lowest = np.full(wider.height * wider.width, np.iinfo(np.int32).max, np.int32)
    for cell in store.buckets_within(bounds):
        points, chosen = surface_points(store, work.rule, cell)
        chosen &= points.inside(bounds, origin)
        xyz = np.ascontiguousarray(points.xyz[:, chosen])
        pixels = pixel_indices(xyz, origin, work.spec, wider)
        if xyz[2].max(initial=NOTHING) > lowest_limit:
            possible = xyz[2] <= limits[pixels]
            pixels, xyz = pixels[possible], xyz[:, possible]
        highest.add(pixels, xyz)
        np.minimum.at(lowest, pixels, xyz[2])
    supported = highest.supported(radius, float(work.spike))
    inner = np.s_[radius : radius + block.height, radius : radius + block.width]
    return supported[inner], lowest.reshape(wider.height, wider.width)[inner]


def _limits(store: TileStore, work: ReturnsBlock, block: Block) -> npt.NDArray[np.float64]:
    """Return the greatest height in counts that a return may have in each pixel, infinite without terrain."""
    terrain = (
        read_cells(store, work.terrain, work.spec, block, NODATA).ravel().astype(np.float64)
    )
    limits = terrain * COUNTS_PER_UNIT + TALLEST_M / float(store.meta.frame.metres_z)
    return np.where(terrain == np.float32(NODATA), np.inf, limits)


def reach_pixels(pixel_m: Fraction) -> int:
    """Return the radius in pixels within which a return needs support: a metre, but at least one pixel."""
    return max(math.ceil(1 / pixel_m), 1)
