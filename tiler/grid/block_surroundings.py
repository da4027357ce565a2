"""Contents of a block of a raster and its surroundings: points, bodies of water, edits, and cells of whole pixels.

Points, water and edits are read from the store when a function asks for them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ptd.arrays import Bool, Float32, Float64, Floating, Indices, Int32, Int64
from ptd.gridding.above_ground import HighestReturns
from ptd.gridding.ground_cells import CellWindow, add_counts, cell_numbers
from ptd.gridding.nearest import nearest_points
from tiler.core.edits import FLAT, OF_PIXELS, Edit
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, CoordFrame
from tiler.core.points import WATER
from tiler.core.raster import NODATA, Block, RasterSpec
from tiler.core.water import Waters
from tiler.grid.block import pixels_of
from tiler.grid.coarse import padded
from tiler.grid.ground import classed, read_ground, read_ground_and_objects, surface_points
from tiler.grid.records import GroundSelection
from tiler.store import TileStore, read_cells

CELLS_AT_ONCE = 64
"""Number of rows of cells whose pixels are summed at a time, which saves memory."""
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

    def ground_and_objects(self, bounds: Bounds) -> tuple[Int32, Int32]:
        """Return the points of `ground`, and those that are neither ground nor noise, each int32 (3, n)."""
        return read_ground_and_objects(self.store, self.rule, bounds)

    def ground_per_pixel(self) -> Int64:
        """Count the ground points in each pixel of the block, int64 (height, width)."""
        window = cell_window(self.spec, self.block, self.frame.origin)
        counts = np.zeros((window.rows, window.columns), np.int64)
        for part in classed(self.store, self.rule, self.spec.block_bounds(self.block)):
            add_counts(counts, part.xyz, window, part.is_ground)
        return counts

    def surface_per_pixel(self) -> tuple[Int64, Int64]:
        """Count the surface points in each pixel, and those that the input classifies as water (height, width)."""
        window = cell_window(self.spec, self.block, self.frame.origin)
        counts, water = np.zeros((2, window.rows, window.columns), np.int64)
        for cell in self.store.buckets_within(self.spec.block_bounds(self.block)):
            points, chosen = surface_points(self.store, self.rule, cell)
            add_counts(counts, points.xyz, window, chosen)
            if points.classification is not None:
                chosen &= points.classification == WATER
                if chosen.any():
                    add_counts(water, points.xyz, window, chosen)
        return counts, water

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
        window = cell_window(self.spec, wider, self.frame.origin)
        highest = HighestReturns(window, self._limits(wider))
        for cell in self.store.buckets_within(self.spec.block_bounds(wider)):
            points, chosen = surface_points(self.store, self.rule, cell)
            highest.add(points.xyz, chosen)
        supported = highest.supported(reach, float(spike))
        inner = np.s_[reach : reach + block.height, reach : reach + block.width]
        return supported[inner], highest.lowest[inner]

    def _limits(self, block: Block) -> Float64:
        """Return the greatest height in counts that a return may have in each pixel, infinite without terrain."""
        values = read_cells(self.store, self.terrain, self.spec, block, NODATA).ravel()
        terrain = values.astype(np.float64)
        limits = terrain * COUNTS_PER_UNIT + TALLEST_M / float(self.frame.metres_z)
        return np.where(terrain == np.float32(NODATA), np.inf, limits)


def reach_pixels(pixel_m: Fraction) -> int:
    """Return the radius in pixels within which a return needs support: a metre, but at least one pixel."""
    return max(math.ceil(1 / pixel_m), 1)


def cell_window(spec: RasterSpec, block: Block, origin: tuple[int, int]) -> CellWindow:
    """Return the pixels of a block for points in local counts of ``origin``."""
    west, north = spec.west + block.col, spec.north - 1 - block.row
    p, q = spec.lattice.p, spec.lattice.q
    return CellWindow(p, q, west, north, block.height, block.width, *origin)


def pixel_indices(xyz: Int32, origin: tuple[int, int], spec: RasterSpec, block: Block) -> Int64:
    """Return ``row * width + col`` within the block for each point, -1 outside."""
    return cell_numbers(xyz, cell_window(spec, block, origin))


@dataclass(frozen=True)
class WatersNear:
    """Bodies of water that touch a block."""

    waters: Waters | None
    spec: RasterSpec
    block: Block

    @property
    def inside(self) -> Bool:
        """Mask of the pixels in water, bool (height, width)."""
        if self.waters is None:
            return np.zeros((self.block.height, self.block.width), np.bool_)
        return self.waters.inside(self.spec, self.block)

    def set_heights(self, heights: Float32, where: Bool) -> list[tuple[str, int]]:
        """Set the heights of the water's pixels in the mask ``where``, see `Waters.set_heights`."""
        if self.waters is None:
            return []
        return self.waters.set_heights(self.spec, self.block, heights, where)


@dataclass(frozen=True)
class EditsNear:
    """Edits that touch a block, under a key of the store; None if the run has none."""

    store: TileStore
    key: str | None
    spec: RasterSpec
    block: Block

    def of(self, actions: Iterable[str]) -> tuple[Edit, ...]:
        """Return the edits with one of the actions."""
        if self.key is None:
            return ()
        edits = self.store.edits(self.key, self.spec.block_bounds(self.block), actions)
        return () if edits is None else edits.edits

    @property
    def flat(self) -> Bool:
        """Mask of the pixels whose height an edit sets, bool (height, width)."""
        mask = np.zeros((self.block.height, self.block.width), np.bool_)
        for edit in self.of((FLAT,)):
            mask |= self.spec.inside(self.block, edit.area)
        return mask

    def set_heights(self, heights: Float32) -> list[tuple[str, int]]:
        """Set the heights of edits, see `Edits.set_heights`."""
        if self.key is None:
            return []
        bounds = self.spec.block_bounds(self.block)
        edits = self.store.edits(self.key, bounds, OF_PIXELS)
        return [] if edits is None else edits.set_heights(self.spec, self.block, heights)


class PixelCells:
    """Cells of ``side`` x ``side`` pixels: those of a block, and ``rim`` more on each side.

    Attributes
    ----------
    side : int
    window : Block
        Pixels of all cells. It may extend beyond the raster.
    west, north : int
        Column and row of the first cell from pixel 0. Rows increase to the south.
    rows, columns : int (height,), int (width,)
        Rows and columns of the block's pixels in the window.
    """

    def __init__(self, spec: RasterSpec, block: Block, side: int, rim: int) -> None:
        left, top = spec.west + block.col, block.row - spec.north
        self.side = side
        self.west, self.north = left // side - rim, top // side - rim
        east = -(-(left + block.width) // side) + rim
        south = -(-(top + block.height) // side) + rim
        self.window = Block(
            self.north * side + spec.north,
            self.west * side - spec.west,
            (south - self.north) * side,
            (east - self.west) * side,
        )
        self.rows = np.arange(block.height) + (block.row - self.window.row)
        self.columns = np.arange(block.width) + (block.col - self.window.col)

    def means(self, values: Floating, known: Bool) -> Float64:
        """Return the mean of the known pixels of each cell, NaN where none is known.

        Values are rounded to counts, as sums of whole numbers are the same for any start of the block.
        """
        total, n = np.zeros(
            (2, values.shape[0] // self.side, values.shape[1] // self.side), np.int64
        )
        for row in range(0, len(total), CELLS_AT_ONCE):
            cells = slice(row, row + CELLS_AT_ONCE)
            pixels = slice(row * self.side, (row + CELLS_AT_ONCE) * self.side)
            counts = np.where(known[pixels], values[pixels], 0.0).astype(np.float64)
            counts = np.rint(counts * COUNTS_PER_UNIT)
            total[cells] = self.sums(counts.astype(np.int64))
            n[cells] = self.sums(known[pixels].astype(np.int64))
        return np.where(n > 0, total / np.maximum(n, 1) / COUNTS_PER_UNIT, np.nan)

    def sums(self, pixels: Int64) -> Int64:
        """Return the sum of the pixels of each cell."""
        rows, columns = (n // self.side for n in pixels.shape)
        sums = np.zeros((rows, columns), np.int64)
        for row, column in np.ndindex(self.side, self.side):
            sums += pixels[row :: self.side, column :: self.side]
        return sums

    def between(self, pixels: Indices, first: int = 0) -> tuple[Indices, Float64]:
        """Return the cell before each row or column of pixels, and the share of the way to the next one.

        Cells are counted from cell ``first``.
        """
        # Whole numbers of half pixels make the share the same for any start of the block.
        half_pixels = 2 * pixels + 1 - (2 * first + 1) * self.side
        before = half_pixels // (2 * self.side)
        return before, (half_pixels - 2 * self.side * before) / (2 * self.side)


def linear(values: Float64, before: Indices, share: Float64) -> Float64:
    """Interpolate linearly between rows of values."""
    return (
        values[before] * (1 - share)[:, np.newaxis] + values[before + 1] * share[:, np.newaxis]
    )
