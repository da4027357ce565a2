"""Squares of a terrain with the numbers of their rising pixels, and random draws of squares by these numbers."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from tiler.apps.evaluate.rasters import blocks_with_files, read_heights
from tiler.apps.statement.rising import margin_pixels, rising
from tiler.core.records import digest_of_bytes

SQUARE_M = 20.0
"""Side of a square, rounded to a whole number of pixels."""

Bools = npt.NDArray[np.bool_]
Int64s = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Squares:
    """Squares of a raster that have rising pixels, row by row from its north-west corner.

    Attributes
    ----------
    row, col : int64, shape (n,)
        Row and column of the square, in squares.
    rising : int64, shape (n,)
        Number of its rising pixels, at least 1.
    side : int
        Side of a square in pixels.
    pixels : int
        Number of pixels with a height in the raster.
    """

    row: Int64s
    col: Int64s
    rising: Int64s
    side: int
    pixels: int

    @cached_property
    def _ends(self) -> Int64s:
        return np.cumsum(self.rising)

    @property
    def all_rising(self) -> int:
        """Number of rising pixels of all squares."""
        return int(self._ends[-1]) if self.rising.size else 0

    def digest(self, terrain: str) -> str:
        """Return a digest of the squares and of the digest of the terrain's files."""
        columns = (each.astype("<i8").tobytes() for each in (self.row, self.col, self.rising))
        return digest_of_bytes(terrain.encode(), *columns)

    def drawn(self, key: str, draw: int) -> int:
        """Return the index of the square of a draw. Its probability is the square's share of all rising pixels.

        Draws with different numbers are independent, and none depends on how many there are. They follow from the
        ``key`` alone: those of numpy may change with its version, and answers would become those of other squares.
        """
        # 256 bits are many more than those of a number of pixels, so the remainders are uniform.
        bits = hashlib.sha256(f"{key} {draw}".encode()).digest()
        pixel = int.from_bytes(bits, "big") % self.all_rising
        return int(np.searchsorted(self._ends, pixel, side="right"))


@dataclass(frozen=True)
class Terrain:
    """Open raster of a terrain, with the side of a pixel and the unit of its heights in metres."""

    raster: Any
    pixel_m: float
    height_m: float

    def rising(self, row: int, col: int, height: int, width: int) -> tuple[Bools, Bools]:
        """Return which pixels of a window rise, and which have a height."""
        margin = margin_pixels(self.pixel_m)
        size = height + 2 * margin, width + 2 * margin
        heights = read_heights(self.raster, row - margin, col - margin, *size)
        if np.isnan(heights[margin:-margin, margin:-margin]).all():
            return np.zeros((height, width), bool), np.zeros((height, width), bool)
        return rising(heights * self.height_m, self.pixel_m)

    def squares(self) -> Squares:
        """Count the rising pixels of all squares, block by block."""
        side = max(round(SQUARE_M / self.pixel_m), 1)
        across, pixels = -(-self.raster.width // side), 0
        found = [np.empty((2, 0), np.int64)]
        for row, col, height, width in blocks_with_files(self.raster):
            rises, is_there = self.rising(row, col, height, width)
            pixels += int(is_there.sum())
            rows, cols = np.nonzero(rises)
            number = (rows + row) // side * across + (cols + col) // side
            found.append(np.stack(np.unique(number, return_counts=True)))
        numbers, counts = np.concatenate(found, axis=1)
        # Squares at the edges of blocks are in several of them.
        number, which = np.unique(numbers, return_inverse=True)
        total = np.zeros(number.size, np.int64)
        np.add.at(total, which, counts)
        return Squares(number // across, number % across, total, side, pixels)

    def outline(self, squares: Squares, index: int) -> tuple[Any, Any]:
        """Return the polygons of the rising pixels of a square, and the square, in units of the CRS."""
        side, transform = squares.side, self.raster.transform
        row, col = int(squares.row[index]) * side, int(squares.col[index]) * side
        height = min(side, self.raster.height - row)
        width = min(side, self.raster.width - col)
        rises, _ = self.rising(row, col, height, width)
        steps = np.diff(np.pad(rises, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        (rows, firsts), (_, ends) = np.nonzero(steps == 1), np.nonzero(steps == -1)

        def box(top: Int64s, left: Int64s, bottom: Int64s, right: Int64s) -> Any:
            west, east = (transform.c + n * transform.a for n in (left, right))
            north, south = (transform.f + n * transform.e for n in (top, bottom))
            return shapely.box(west, south, east, north)

        shape = shapely.union_all(box(row + rows, col + firsts, row + rows + 1, col + ends))
        return shape, box(*np.array([row, col, row + height, col + width]))
