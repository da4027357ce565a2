"""Rasters: pixels on a lattice anchored at CRS coordinate 0, with rows from north to south."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptd.arrays import Bool, Int64
from tiler.core.area import Area
from tiler.core.lattice import COUNTS_PER_UNIT, Bounds, Cell, Lattice, row_by_row

# Modules that work with rasters import it from here.
from tiler.core.products import NODATA as NODATA

BLOCK_PIXELS = 512
"""Side of a block of a raster, in pixels. One task makes a block, which is a chunk in the store
and a tile in files."""
MIN_PART = 32
"""Side up to which a block is not divided further, in pixels."""

FEW_PIXELS = 4096
"""Maximum number of pixels that are tested one by one, since testing the outline of the area
would take as long."""


@dataclass(frozen=True)
class Block:
    """Window of a raster: ``row, col`` of its north-west pixel, and its size in pixels."""

    row: int
    col: int
    height: int
    width: int

    @property
    def name(self) -> str:
        """Sortable name: row and column of the north-west pixel."""
        return f"r{self.row:07d}c{self.col:07d}"


def north_west(block: Block) -> tuple[int, int]:
    """Return a sort key that orders blocks row by row from the north-west."""
    return block.row, block.col


def within(part: Block, block: Block) -> tuple[slice, slice]:
    """Return the rows and columns of ``part`` in an array of the pixels of ``block``."""
    row = part.row - block.row
    col = part.col - block.col
    return slice(row, row + part.height), slice(col, col + part.width)


def hull_of(blocks: Iterable[Block]) -> Block:
    """Return the smallest block that contains all ``blocks`` (at least one)."""
    all_blocks = list(blocks)
    row = min(b.row for b in all_blocks)
    col = min(b.col for b in all_blocks)
    bottom = max(b.row + b.height for b in all_blocks)
    right = max(b.col + b.width for b in all_blocks)
    return Block(row, col, bottom - row, right - col)


@dataclass(frozen=True)
class RasterSpec:
    """Position and size of a raster: its lattice, its north-west pixel, its rows and columns.

    Pixel ``(row, col)`` is cell ``(west + col, north - 1 - row)`` of `lattice`. Its centre is at
    ``(west + col + 1/2) * size`` absolute counts east and ``(north - row - 1/2) * size`` north.
    """

    lattice: Lattice
    west: int
    north: int
    height: int
    width: int

    @classmethod
    def covering(cls, lattice: Lattice, extent: Bounds) -> RasterSpec:
        """Return the smallest raster whose pixels contain every count of ``extent``."""
        west = lattice.index_of(extent.x0)
        south = lattice.index_of(extent.y0)
        east = lattice.index_of(extent.x1 - 1) + 1
        north = lattice.index_of(extent.y1 - 1) + 1
        return cls(lattice, west, north, north - south, east - west)

    @classmethod
    def enclosing(cls, lattice: Lattice, extent: Bounds) -> RasterSpec:
        """Return the smallest raster that has every count of ``extent`` in its pixels or on its outer edge.

        Unlike `covering`, it adds no row or column that only has points on its edge and so no
        heights. The raster has at least one row and one column.
        """
        west = lattice.index_of(extent.x0)
        south = lattice.index_of(extent.y0)
        east = max(lattice.end_of(extent.x1 - 1), west + 1)
        north = max(lattice.end_of(extent.y1 - 1), south + 1)
        return cls(lattice, west, north, north - south, east - west)

    def blocks(self, size: int) -> Iterator[Block]:
        """Yield blocks of ``size`` pixels (smaller at the south and east end) that cover each pixel once."""
        for row in range(0, self.height, size):
            for col in range(0, self.width, size):
                yield self.block_at(row, col, size)

    def block_at(self, row: int, col: int, size: int) -> Block:
        """Return the block whose north-west pixel is (row, col)."""
        return Block(row, col, min(size, self.height - row), min(size, self.width - col))

    def block_named(self, name: str, size: int) -> Block:
        """Return the block with this `Block.name`."""
        row, _, col = name.removeprefix("r").partition("c")
        return self.block_at(int(row), int(col), size)

    def blocks_near(
        self, lattice: Lattice, cells: Iterable[Cell], size: int, reach: int = 0
    ) -> dict[Block, list[Cell]]:
        """Return the `blocks` within ``reach`` counts of ``cells``, each with its cells.

        Blocks and cells are in order, row by row. The cost depends on the number of cells, not
        on the number of blocks in the raster.
        """
        cells_by_block: dict[Block, list[Cell]] = defaultdict(list)
        for cell in sorted(cells, key=row_by_row):
            for block in self.blocks_within(lattice.bounds(cell).pad(reach), size):
                cells_by_block[block].append(cell)
        return {
            block: cells_by_block[block] for block in sorted(cells_by_block, key=north_west)
        }

    def blocks_within(self, bounds: Bounds, size: int) -> Iterator[Block]:
        """Yield the `blocks` that overlap ``bounds``, in the same order."""
        if bounds.empty:
            return
        index = self.lattice.index_of
        left = index(bounds.x0) - self.west
        right = index(bounds.x1 - 1) - self.west
        top = self.north - 1 - index(bounds.y1 - 1)
        bottom = self.north - 1 - index(bounds.y0)
        for row in range(max(top, 0) // size * size, min(bottom + 1, self.height), size):
            for col in range(max(left, 0) // size * size, min(right + 1, self.width), size):
                yield self.block_at(row, col, size)

    def block_bounds(self, block: Block) -> Bounds:
        """Return the bounds of the pixels of a block, in absolute counts."""
        first = self.lattice.first
        west = self.west + block.col
        north = self.north - block.row
        return Bounds(
            first(west), first(north - block.height), first(west + block.width), first(north)
        )

    def axes(self, block: Block) -> tuple[Int64, Int64]:
        """Return x of the columns and y of the rows of a block at pixel centres, in absolute counts rounded down."""
        p, q = self.lattice.p, self.lattice.q
        west = self.west + block.col
        north = self.north - block.row
        cols = np.arange(west, west + block.width, dtype=np.int64)
        rows = np.arange(north - 1, north - 1 - block.height, -1, dtype=np.int64)
        return ((2 * cols + 1) * p) // (2 * q), ((2 * rows + 1) * p) // (2 * q)

    def centres(self, block: Block) -> tuple[Int64, Int64]:
        """Return x and y of the pixel centres of a block, in absolute counts rounded down, each (height, width)."""
        x, y = np.meshgrid(*self.axes(block))
        return x, y

    @property
    def bounds(self) -> Bounds:
        """Bounds of all pixels, in absolute counts."""
        return self.block_bounds(Block(0, 0, self.height, self.width))

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """West, south, east and north edge in units of the CRS."""
        size = self.lattice.size / COUNTS_PER_UNIT
        west, north = self.west * size, self.north * size
        return (
            float(west),
            float(north - self.height * size),
            float(west + self.width * size),
            float(north),
        )

    def window(self, block: Block) -> RasterSpec:
        """Return the pixels of a block as a separate raster."""
        west = self.west + block.col
        north = self.north - block.row
        return RasterSpec(self.lattice, west, north, block.height, block.width)

    def inside(self, block: Block, area: Area | None) -> Bool:
        """Return the mask of the pixels of a block whose centres lie in ``area``, shape (height, width).

        The mask has all pixels if ``area`` is None.
        """
        shape = (block.height, block.width)
        if area is None:
            return np.ones(shape, np.bool_)
        is_inside = np.zeros(shape, np.bool_)
        part = self.part(block, area.bounds)
        if part.height * part.width > FEW_PIXELS:
            bounds = self.block_bounds(part)
            if part == block and area.covers(bounds):
                return np.ones(shape, np.bool_)
            if not area.touches(bounds):
                return is_inside
        is_inside[within(part, block)] = area.inside_grid(*self.axes(part))
        return is_inside

    def part(self, block: Block, bounds: Bounds) -> Block:
        """Return the pixels of a block that touch ``bounds``. If no pixel does, the height or width is 0."""
        index = self.lattice.index_of
        left = max(index(bounds.x0) - self.west, block.col)
        right = min(index(bounds.x1) - self.west + 1, block.col + block.width)
        top = max(self.north - 1 - index(bounds.y1), block.row)
        bottom = min(self.north - index(bounds.y0), block.row + block.height)
        return Block(top, left, max(bottom - top, 0), max(right - left, 0))

    def transform(
        self, counts_per_unit: int
    ) -> tuple[float, float, float, float, float, float]:
        """Return affine coefficients (a, b, c, d, e, f) in the order of rasterio's ``Affine``, in units of the CRS."""
        size = self.lattice.size / counts_per_unit
        return (
            float(size),
            0.0,
            float(self.west * size),
            0.0,
            -float(size),
            float(self.north * size),
        )

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-able description, which `from_json` reads."""
        return {
            "lattice": self.lattice.to_json(),
            "west": self.west,
            "north": self.north,
            "height": self.height,
            "width": self.width,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> RasterSpec:
        """Return the raster that `to_json` described."""
        return cls(**{**data, "lattice": Lattice.from_json(data["lattice"])})
