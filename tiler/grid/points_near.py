"""Points around a block of a raster, read from the store when a function asks for them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from ptd.gridding.above_ground import NOTHING, HighestReturns
from ptd.gridding.nearest import nearest_points
from tiler.core.classes import WATER
from tiler.core.frame import COUNTS_PER_UNIT, CoordFrame
from tiler.core.lattice import Bounds, Cell
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.grid.block import pixels_of
from tiler.grid.coarse import padded
from tiler.grid.ground import GroundSelection, read_ground, read_objects, surface_points
from tiler.store import TileStore, read_cells

Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]

TALLEST_M = 1000
"""No structure is taller. Returns above are of clouds, aircraft or errors, however many support one another."""


@dataclass(frozen=True)
class PointsNear:
    """Points around a block.

    Attributes
    ----------
    store : TileStore
    rule : GroundSelection
    spec : RasterSpec
    block : Block
    terrain : str
        Raster of the terrain in the same pixels, for `returns`.
    """

    store: TileStore
    rule: GroundSelection
    spec: RasterSpec
    block: Block
    terrain: str = ""

    @property
    def frame(self) -> CoordFrame:
        """Frame of the store."""
        return self.store.meta.frame

    def ground(self, bounds: Bounds) -> Int32:
        """Return the ground points in ``bounds`` (absolute counts), int32 (3, n) in local counts."""
        return read_ground(self.store, self.rule, bounds).xyz

    def objects(self, bounds: Bounds) -> Int32:
        """Return the points in ``bounds`` that are neither ground nor noise, int32 (3, n) in local counts."""
        return read_objects(self.store, self.rule, bounds)

    def ground_per_pixel(self) -> Int64:
        """Count the ground points in each pixel of the block, int64 (height, width)."""
        block = self.block
        counts = np.zeros(block.height * block.width, np.int64)

        def count(cell: Cell, points: Int32) -> npt.NDArray[np.intp]:
            """Count the points of a bucket, and keep none: a block of large cells may hold too many."""
            pixels = pixel_indices(points, self.frame.origin, self.spec, block)
            counts[:] += np.bincount(pixels, minlength=counts.size)
            return np.empty(0, np.intp)

        read_ground(self.store, self.rule, self.spec.block_bounds(block), count)
        return counts.reshape(block.height, block.width)

    def surface_per_pixel(self) -> tuple[Int64, Int64]:
        """Count the surface points in each pixel, and those that the input classifies as water (height, width)."""
        shape, bounds = (
            (self.block.height, self.block.width),
            self.spec.block_bounds(self.block),
        )
        counts, water = np.zeros((2, shape[0] * shape[1]), np.int64)
        for cell in self.store.buckets_within(bounds):
            points, chosen = surface_points(self.store, self.rule, cell)
            chosen &= points.inside(bounds, self.frame.origin)
            pixels = pixel_indices(
                points.xyz[:, chosen], self.frame.origin, self.spec, self.block
            )
            counts += np.bincount(pixels, minlength=len(counts))
            if points.classification is not None:
                wet = points.classification[chosen] == WATER
                water += np.bincount(pixels[wet], minlength=len(counts))
        return counts.reshape(shape), water.reshape(shape)

    def ground_distance(self, reach: Fraction) -> Float64:
        """Return plan distances from pixels' centres to ground, in counts, infinite beyond ``reach`` counts."""
        bounds = self.spec.block_bounds(self.block).pad(math.ceil(reach) + 1)
        return self.distance_to(self.ground(bounds), reach)

    def distance_to(self, xyz: Int32, reach: Fraction) -> Float64:
        """Return plan distances to points in counts, float64 (height, width), infinite beyond ``reach`` counts.

        ``xyz``, int32 (3, n) in local counts, has to include all points within ``reach`` of the block.
        """
        pixels = pixels_of(self.spec, self.block, self.frame.origin)
        nearest = nearest_points(xyz[0], xyz[1], xyz[2], pixels, 1, float(reach))
        squared = nearest.squared[..., 0].astype(np.float64)
        return np.where(nearest.points[..., 0] < 0, np.inf, np.sqrt(squared))

    def returns(self, block: Block, reach: int, spike: Fraction) -> tuple[Int32, Int32]:
        """Return the highest supported return of each pixel of a block, and the height of its lowest return.

        All points except withheld or skipped ones and noise (classes 7 and 18, by the input or by
        the filter) are used, since water and bridges are surface, but none more than `TALLEST_M` above the terrain.

        Parameters
        ----------
        block : Block
            Any block of the raster. It may extend beyond the raster.
        reach : int
            Radius in pixels within which returns support one another.
        spike : Fraction
            Height in vertical counts by which a return may rise above all others within ``reach``.

        Returns
        -------
        highest : int32 (height, width, 3)
            Local counts of the highest return, `NOTHING` without one.
        lowest : int32 (height, width)
            Height of the lowest return, defined where there is a highest one.
        """
        wider = padded(block, reach)
        bounds, limits = self.spec.block_bounds(wider), self._limits(wider)
        lowest_limit = limits.min()
        highest = HighestReturns(wider.height, wider.width)
        lowest = np.full(wider.height * wider.width, np.iinfo(np.int32).max, np.int32)
        for cell in self.store.buckets_within(bounds):
            points, chosen = surface_points(self.store, self.rule, cell)
            chosen &= points.inside(bounds, self.frame.origin)
            xyz = np.ascontiguousarray(points.xyz[:, chosen])
            pixels = pixel_indices(xyz, self.frame.origin, self.spec, wider)
            if xyz[2].max(initial=NOTHING) > lowest_limit:
                possible = xyz[2] <= limits[pixels]
                pixels, xyz = pixels[possible], xyz[:, possible]
            highest.add(pixels, xyz)
            np.minimum.at(lowest, pixels, xyz[2])
        supported = highest.supported(reach, float(spike))
        inner = np.s_[reach : reach + block.height, reach : reach + block.width]
        return supported[inner], lowest.reshape(wider.height, wider.width)[inner]

    def _limits(self, block: Block) -> Float64:
        """Return the greatest height in counts that a return may have in each pixel, infinite without terrain."""
        values = read_cells(self.store, self.terrain, self.spec, block, NODATA).ravel()
        terrain = values.astype(np.float64)
        limits = terrain * COUNTS_PER_UNIT + TALLEST_M / float(self.frame.metres_z)
        return np.where(terrain == np.float32(NODATA), np.inf, limits)


def reach_pixels(pixel_m: Fraction) -> int:
    """Return the radius in pixels within which a return needs support: a metre, but at least one pixel."""
    return max(math.ceil(1 / pixel_m), 1)


def pixel_indices(xyz: Int32, origin: tuple[int, int], spec: RasterSpec, block: Block) -> Int64:
    """Return ``row * width + col`` within the block for each point. All points have to lie in the block."""
    x, y = (xyz[axis].astype(np.int64) + origin[axis] for axis in (0, 1))
    col = spec.lattice.index(x) - (spec.west + block.col)
    row = (spec.north - 1 - block.row) - spec.lattice.index(y)
    return row * block.width + col
