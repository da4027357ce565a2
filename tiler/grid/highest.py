"""Highest return of each pixel of a block, read from the store."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.gridding.highest_returns import NOTHING, HighestReturns
from tiler.core.raster import Block
from tiler.grid.density import pixel_indices
from tiler.grid.ground import surface_points
from tiler.grid.work import PointsBlock
from tiler.store import TileStore

__all__ = ["NOTHING", "ReturnsBlock", "highest_returns", "reach_pixels"]

Int32 = npt.NDArray[np.int32]


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
    """Return the highest supported return of each pixel, int32 (height, width, 3).

    All points except withheld or skipped ones and noise (classes 7 and 18, by the input or by
    the filter) are used, since water and bridges are surface. `HighestReturns.supported`
    removes spikes among the pixels within ``reach``.
    """
    radius, origin = work.reach, store.meta.frame.origin
    wider = Block(
        block.row - radius,
        block.col - radius,
        block.height + 2 * radius,
        block.width + 2 * radius,
    )
    bounds = work.spec.block_bounds(wider)
    highest = HighestReturns(wider.height, wider.width)
    for cell in store.buckets_within(bounds):
        points, chosen = surface_points(store, work.rule, cell)
        chosen &= points.inside(bounds, origin)
        xyz = np.ascontiguousarray(points.xyz[:, chosen])
        highest.add(pixel_indices(xyz, origin, work.spec, wider), xyz)
    supported = highest.supported(radius, float(work.spike))
    return supported[radius : radius + block.height, radius : radius + block.width]


def reach_pixels(pixel_m: Fraction) -> int:
    """Return the radius in pixels within which a return needs support: a metre, but at least one pixel."""
    return max(math.ceil(1 / pixel_m), 1)
