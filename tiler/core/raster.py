"""The raster: pixels on a lattice anchored at CRS coordinate 0, rows from north to south."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tiler.core.area import Area
from tiler.core.lattice import Bounds, Cell, Lattice, row_by_row
from tiler.core.nodata import NODATA as NODATA  # here for those that deal with rasters

BLOCK_PIXELS = 512
"""Side of a block of a raster: what one task makes, a chunk in the store, and a tile in the files."""


@dataclass(frozen=True)
class Block:
    """A window of a raster: ``row, col`` of its north-west pixel, and its size in pixels."""

    row: int
    col: int
    height: int
    width: int

    @property
    def name(self) -> str:
        """A name that sorts: row and column of the north-west pixel."""
        return f"r{self.row:07d}c{self.col:07d}"


def north_west(block: Block) -> tuple[int, int]:
    """Sorts blocks row by row from the north-west."""
    return block.row, block.col


def hull_of(blocks: Iterable[Block]) -> Block:
    """The smallest block that holds some blocks, of which there is one at least."""
    found = list(blocks)
    row, col = min(b.row for b in found), min(b.col for b in found)
    bottom, right = max(b.row + b.height for b in found), max(b.col + b.width for b in found)
    return Block(row, col, bottom - row, right - col)


@dataclass(frozen=True)
class RasterSpec:
    """Place and size of a raster: its lattice, its north-west pixel, its rows and columns.

    Pixel ``(row, col)`` is cell ``(west + col, north - 1 - row)`` of `lattice`: its centre is
    at ``(west + col + 1/2) * size`` absolute counts east, ``(north - row - 1/2) * size`` north.
    """

    lattice: Lattice
    west: int
    north: int
    height: int
    width: int

    @classmethod
    def covering(cls, lattice: Lattice, extent: Bounds) -> RasterSpec:
        """The smallest raster whose pixels hold every count of ``extent``."""
        west, south = lattice.index_of(extent.x0), lattice.index_of(extent.y0)
        east, north = lattice.index_of(extent.x1 - 1) + 1, lattice.index_of(extent.y1 - 1) + 1
        return cls(lattice, west, north, north - south, east - west)

    def blocks(self, size: int) -> Iterator[Block]:
        """Blocks of ``size`` pixels (smaller at the south and east end) that cover each pixel once."""
        for row in range(0, self.height, size):
            for col in range(0, self.width, size):
                yield self.block_at(row, col, size)

    def block_at(self, row: int, col: int, size: int) -> Block:
        """The one of the `blocks` whose north-west pixel this is."""
        return Block(row, col, min(size, self.height - row), min(size, self.width - col))

    def block_named(self, name: str, size: int) -> Block:
        """The one of the `blocks` with this `Block.name`."""
        row, _, col = name.removeprefix("r").partition("c")
        return self.block_at(int(row), int(col), size)

    def blocks_near(
        self, lattice: Lattice, cells: Iterable[Cell], size: int, reach: int = 0
    ) -> dict[Block, list[Cell]]:
        """The `blocks` within ``reach`` counts of some cells, row by row, each with these cells, row by row.

        Follows the cells: of a raster that is mostly empty the blocks are not looked at one by one.
        """
        found: dict[Block, list[Cell]] = defaultdict(list)
        for cell in sorted(cells, key=row_by_row):
            for block in self.blocks_within(lattice.bounds(cell).pad(reach), size):
                found[block].append(cell)
        return {block: found[block] for block in sorted(found, key=north_west)}

    def blocks_within(self, bounds: Bounds, size: int) -> Iterator[Block]:
        """Those of the `blocks` that hold a count of ``bounds``, in the same order."""
        if bounds.empty:
            return
        index = self.lattice.index_of
        left, right = index(bounds.x0) - self.west, index(bounds.x1 - 1) - self.west
        top, bottom = self.north - 1 - index(bounds.y1 - 1), self.north - 1 - index(bounds.y0)
        for row in range(max(top, 0) // size * size, min(bottom + 1, self.height), size):
            for col in range(max(left, 0) // size * size, min(right + 1, self.width), size):
                yield self.block_at(row, col, size)

    def block_bounds(self, block: Block) -> Bounds:
        """The absolute counts that the pixels of a block cover."""
        first = self.lattice.first
        west, north = self.west + block.col, self.north - block.row
        return Bounds(first(west), first(north - block.height), first(west + block.width), first(north))

    def centres(self, block: Block) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Absolute counts, x and y, at the centres of the pixels of a block or next below, shape (height, width)."""
        p, q = self.lattice.p, self.lattice.q
        cols = np.arange(self.west + block.col, self.west + block.col + block.width, dtype=np.int64)
        rows = np.arange(
            self.north - block.row - 1, self.north - block.row - 1 - block.height, -1, dtype=np.int64
        )
        x, y = np.meshgrid(((2 * cols + 1) * p) // (2 * q), ((2 * rows + 1) * p) // (2 * q))
        return x, y

    def inside(self, block: Block, area: Area | None) -> npt.NDArray[np.bool_]:
        """Mask of the pixels of a block whose centres lie in an area, shape (height, width); None: all."""
        shape, bounds = (block.height, block.width), self.block_bounds(block)
        if area is None or area.covers(bounds):
            return np.ones(shape, np.bool_)
        if not area.touches(bounds):
            return np.zeros(shape, np.bool_)
        x, y = self.centres(block)
        return area.inside(x.ravel(), y.ravel()).reshape(shape)

    def transform(self, counts_per_unit: int) -> tuple[float, float, float, float, float, float]:
        """Affine coefficients (a, b, c, d, e, f), GDAL order of rasterio's ``Affine``, units of the CRS."""
        size = self.lattice.size / counts_per_unit
        return float(size), 0.0, float(self.west * size), 0.0, -float(size), float(self.north * size)

    def to_json(self) -> dict[str, Any]:
        """A JSON-able description; `from_json` reads it back."""
        return {
            "lattice": self.lattice.to_json(),
            "west": self.west,
            "north": self.north,
            "height": self.height,
            "width": self.width,
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> RasterSpec:
        """The raster that `to_json` described."""
        return cls(
            Lattice.from_json(data["lattice"]), data["west"], data["north"], data["height"], data["width"]
        )
