"""Coverage of several surveys in cells, from which follows which survey counts at a place.

A survey covers places with points up to `NEAR_M` apart that are at least as wide as `MIN_WIDTH_M`, and the gaps of up
to `GAP_M` between such places. Points by themselves cover nothing: they may be noise, which only the points of other
surveys show. Next to these cells, points of other surveys do not count over a width of `SEAM_M`, so that the terrain
has a ramp between two surveys and no step.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ptd.arrays import Bool
from tiler.core.lattice import CoordFrame, Lattice
from tiler.core.records import Record

CELL_M = 2
"""Side of a cell in metres. The side of every bucket is a multiple of it."""
NEAR_M = 8
"""Largest distance in metres of points that cover the place between them."""
MIN_WIDTH_M = 8
"""Smallest width in metres of a place that such points cover."""
GAP_M = 20
"""Widest gap, in metres, between covered places that is covered as well."""
SEAM_M = 4
"""Width in metres of the seam, in which only the facets between two surveys give heights."""
REACH_M = NEAR_M + MIN_WIDTH_M + GAP_M + SEAM_M + CELL_M
"""Distance in metres over which points of a survey decide which survey counts."""


def survey_cells_of(frame: CoordFrame) -> Lattice:
    """Return the lattice of the cells. It depends neither on the inputs nor on the buckets."""
    return Lattice(frame.counts(Fraction(CELL_M)))


@dataclass(frozen=True, slots=True)
class CellMask(Record):
    """Some cells of a rectangle of cells.

    Attributes
    ----------
    column, row, width, height : int
        Column and row of the south-west cell, and size of the rectangle.
    bits : str
        One bit per cell, row by row, compressed, as base64.
    """

    column: int
    row: int
    width: int
    height: int
    bits: str

    @classmethod
    def packed(cls, column: int, row: int, cells: Bool) -> CellMask:
        """Return the mask of cells, bool (height, width), whose south-west cell is at a column and row."""
        bits = base64.b64encode(zlib.compress(np.packbits(cells).tobytes())).decode()
        return cls(column, row, cells.shape[1], cells.shape[0], bits)

    @classmethod
    def united(
        cls, masks: Iterable[CellMask], column: int, row: int, width: int, height: int
    ) -> CellMask | None:
        """Return the cells of any of the masks in a rectangle, or None if it has none."""
        cells = union_in(masks, column, row, width, height)
        return cls.packed(column, row, cells) if cells.any() else None

    @property
    def cells(self) -> Bool:
        """The cells, bool (height, width)."""
        raw = np.frombuffer(zlib.decompress(base64.b64decode(self.bits)), np.uint8)
        bits = np.unpackbits(raw, count=self.width * self.height)
        return bits.reshape(self.height, self.width).astype(np.bool_)


def union_in(masks: Iterable[CellMask], column: int, row: int, width: int, height: int) -> Bool:
    """Return the cells of any of the masks in a rectangle, bool (height, width)."""
    window = np.zeros((height, width), np.bool_)
    for mask in masks:
        west, south = max(mask.column, column), max(mask.row, row)
        east = min(mask.column + mask.width, column + width)
        north = min(mask.row + mask.height, row + height)
        if west < east and south < north:
            part = mask.cells[
                south - mask.row : north - mask.row, west - mask.column : east - mask.column
            ]
            window[south - row : north - row, west - column : east - column] |= part
    return window
