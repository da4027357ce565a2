"""Integer coordinates (counts): their scale in metres, lattices of square cells, and windows of known points."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ptd.arrays import Bool, Int32, Int64

OPEN = 2**40
"""Coordinate of an open side of a window, in counts. It is larger than the coordinates of all
points."""


@dataclass(frozen=True)
class Scale:
    """Metres in one count, and the position of local count 0.

    Attributes
    ----------
    metres_xy : Fraction
        Metres in one horizontal count.
    metres_z : Fraction
        Metres in one vertical count.
    origin : (int, int)
        Absolute counts of the local position (0, 0). Lattices are anchored at absolute count 0.
    """

    metres_xy: Fraction = Fraction(1, 1000)
    metres_z: Fraction = Fraction(1, 1000)
    origin: tuple[int, int] = (0, 0)

    def counts(self, metres: float) -> float:
        """Convert a horizontal length in metres to counts."""
        return float(Fraction(metres) / self.metres_xy)

    def counts_z(self, metres: float) -> float:
        """Convert a height in metres to vertical counts."""
        return float(Fraction(metres) / self.metres_z)

    @property
    def z_ratio(self) -> float:
        """Length of a vertical count in horizontal counts."""
        return float(self.metres_z / self.metres_xy)


class CellGrid(NamedTuple):
    """Lattice whose columns and rows are counted from a first cell, as an argument of kernels.

    Attributes
    ----------
    p, q, origin_x, origin_y : int
        Fields of the `CellLattice`.
    column, row : int
        Column and row of the first cell in the lattice.
    """

    p: int
    q: int
    origin_x: int
    origin_y: int
    column: int
    row: int


@dataclass(frozen=True)
class CellLattice:
    """Lattice of square cells with a size of ``p / q`` counts, anchored at absolute count 0. Positions are local.

    Local count ``x`` lies in column ``((x + origin_x) * q) // p``.
    """

    p: int
    q: int
    origin_x: int
    origin_y: int

    @classmethod
    def of(cls, size_m: float, scale: Scale) -> CellLattice:
        """Return a lattice of cells of ``size_m`` metres. The exact size is the decimal number in ``repr(size_m)``."""
        size = Fraction(repr(float(size_m))) / scale.metres_xy
        return cls(size.numerator, size.denominator, scale.origin[0], scale.origin[1])

    def grid(self, column: int, row: int) -> CellGrid:
        """Return the lattice with columns and rows counted from a first cell."""
        return CellGrid(self.p, self.q, self.origin_x, self.origin_y, column, row)

    def column(self, x: int) -> int:
        """Return the column of local count ``x``. Columns increase to the east."""
        return ((x + self.origin_x) * self.q) // self.p

    def row(self, y: int) -> int:
        """Return the row of local count ``y``. Rows increase to the north."""
        return ((y + self.origin_y) * self.q) // self.p

    def cell_indices(self, x: Int32, y: Int32) -> tuple[Int64, Int64]:
        """Return columns and rows of local counts: int64 [n] each."""
        columns: Int64 = ((x.astype(np.int64) + self.origin_x) * self.q) // self.p
        rows: Int64 = ((y.astype(np.int64) + self.origin_y) * self.q) // self.p
        return columns, rows

    def extent(self, x: Int32, y: Int32, margin: int = 0) -> tuple[int, int, int, int]:
        """Return the rectangle of cells around at least one point, with a margin of cells on each side.

        Returns its first column, its first row, and its numbers of columns and rows.
        """
        column, row = self.column(int(x.min())) - margin, self.row(int(y.min())) - margin
        columns = self.column(int(x.max())) + margin + 1 - column
        rows = self.row(int(y.max())) + margin + 1 - row
        return column, row, columns, rows

    def corners(self, columns: Int64, rows: Int64) -> tuple[Int64, Int64]:
        """Return the western edges of columns and the southern edges of rows, in local counts: int64 [n] each.

        An edge is the first count within the column or row.
        """
        west: Int64 = -((-columns * self.p) // self.q) - self.origin_x
        south: Int64 = -((-rows * self.p) // self.q) - self.origin_y
        return west, south

    def west(self, column: int) -> int:
        """Return the western edge of a column, in local counts."""
        return -((-column * self.p) // self.q) - self.origin_x

    def south(self, row: int) -> int:
        """Return the southern edge of a row, in local counts."""
        return -((-row * self.p) // self.q) - self.origin_y


@dataclass(frozen=True)
class Window:
    """Half-open rectangle of local counts in which all points are known.

    A side is *open* (at -OPEN or OPEN) if there are no points beyond it, and otherwise
    *closed*.
    """

    west: int
    south: int
    east: int
    north: int

    @classmethod
    def everything(cls) -> Window:
        """Return the window of a whole cloud, with no points outside."""
        return cls(-OPEN, -OPEN, OPEN, OPEN)

    @property
    def closed(self) -> bool:
        """Whether at least one side is closed, so that points may lie beyond it."""
        return self != Window.everything()

    def inside(self, cells: CellLattice, steps: int = 0) -> Window:
        """Return the window, shrunk at its closed sides to whole cells and by `steps` further cells."""
        west, south, east, north = self.west, self.south, self.east, self.north
        if west > -OPEN:
            column = cells.column(west)
            if cells.west(column) < west:  # The window cuts this column.
                column += 1
            west = cells.west(column + steps)
        if south > -OPEN:
            row = cells.row(south)
            if cells.south(row) < south:  # The window cuts this row.
                row += 1
            south = cells.south(row + steps)
        if east < OPEN:
            east = cells.west(cells.column(east) - steps)
        if north < OPEN:
            north = cells.south(cells.row(north) - steps)
        return Window(west, south, east, north)

    def contains_box(self, west: int, south: int, east: int, north: int) -> bool:
        """Return whether a half-open rectangle of local counts lies within the window."""
        return (
            west >= self.west
            and south >= self.south
            and east <= self.east
            and north <= self.north
        )

    def contains(self, x: Int32, y: Int32) -> Bool:
        """Return a mask of the positions (local counts) within the window: bool [n]."""
        if not self.closed:
            return np.ones(x.shape, np.bool_)
        return (x >= self.west) & (x < self.east) & (y >= self.south) & (y < self.north)
