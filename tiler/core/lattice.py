"""Half-open bounds in absolute counts, and lattices of exact rational cells anchored at count 0."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, reduce
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Bounds:
    """The half-open rectangle ``x0 <= x < x1, y0 <= y < y1`` in absolute counts (int)."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def empty(self) -> bool:
        """Whether no count lies inside."""
        return self.x0 >= self.x1 or self.y0 >= self.y1

    def pad(self, counts: int) -> Bounds:
        """These bounds, made wider by ``counts`` on every side."""
        return Bounds(self.x0 - counts, self.y0 - counts, self.x1 + counts, self.y1 + counts)

    def union(self, other: Bounds) -> Bounds:
        """The smallest bounds that hold both."""
        return Bounds(
            min(self.x0, other.x0), min(self.y0, other.y0), max(self.x1, other.x1), max(self.y1, other.y1)
        )

    def intersection(self, other: Bounds) -> Bounds:
        """The counts that both bounds hold; may be empty."""
        return Bounds(
            max(self.x0, other.x0), max(self.y0, other.y0), min(self.x1, other.x1), min(self.y1, other.y1)
        )

    def overlaps(self, other: Bounds) -> bool:
        """Whether both bounds hold some count."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def area(self) -> int:
        """Area in square counts."""
        return max(self.x1 - self.x0, 0) * max(self.y1 - self.y0, 0)

    def to_json(self) -> list[int]:
        """``[x0, y0, x1, y1]``."""
        return [self.x0, self.y0, self.x1, self.y1]

    @classmethod
    def from_json(cls, data: list[int]) -> Bounds:
        """The bounds that `to_json` wrote."""
        x0, y0, x1, y1 = (int(v) for v in data)
        return cls(x0, y0, x1, y1)


@dataclass(frozen=True, order=True)
class Cell:
    """A cell of a lattice: column ``ix`` to the east, row ``iy`` to the north."""

    ix: int
    iy: int

    @property
    def name(self) -> str:
        """A name that sorts and reads well: ``+12-03``."""
        return f"{self.ix:+03d}{self.iy:+03d}"


def row_by_row(cell: Cell) -> tuple[int, int]:
    """Sorts cells row by row from the south-west."""
    return cell.iy, cell.ix


@dataclass(frozen=True)
class Lattice:
    """Square cells of ``size`` counts (an exact fraction), cell 0 starting at absolute count 0.

    A count belongs to cell ``floor(count * q / p)`` with ``size = p / q``: int64 arithmetic, no tolerance.
    """

    size: Fraction

    @cached_property
    def p(self) -> int:
        """Numerator of the cell size in counts."""
        return self.size.numerator

    @cached_property
    def q(self) -> int:
        """Denominator of the cell size in counts."""
        return self.size.denominator

    def index(self, absolute: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Cell indices of absolute counts, int64 of the same shape."""
        return (absolute * self.q) // self.p

    def index_of(self, absolute: int) -> int:
        """The cell index of one absolute count."""
        return (absolute * self.q) // self.p

    def end_of(self, absolute: int) -> int:
        """The index of the first cell that begins at or beyond one absolute count."""
        return -((-absolute * self.q) // self.p)

    def first(self, index: int) -> int:
        """The first absolute count that belongs to cell ``index``."""
        return -((-index * self.p) // self.q)

    def bounds(self, cell: Cell) -> Bounds:
        """The counts that belong to a cell."""
        return Bounds(
            self.first(cell.ix), self.first(cell.iy), self.first(cell.ix + 1), self.first(cell.iy + 1)
        )

    def cells(self, bounds: Bounds) -> Iterator[Cell]:
        """Every cell that overlaps ``bounds``, row by row from the south-west. Use it for small bounds only."""
        if bounds.empty:
            return
        for iy in range(self.index_of(bounds.y0), self.index_of(bounds.y1 - 1) + 1):
            for ix in range(self.index_of(bounds.x0), self.index_of(bounds.x1 - 1) + 1):
                yield Cell(ix, iy)

    def among(self, bounds: Bounds, occupied: Collection[Cell]) -> list[Cell]:
        """The occupied cells that overlap ``bounds``, row by row from the south-west.

        It goes through the cells of the bounds or through the occupied cells, whichever are fewer: the bounds of a few
        distant points can have a thousand million cells.
        """
        if bounds.empty:
            return []
        west, east = self.index_of(bounds.x0), self.index_of(bounds.x1 - 1)
        south, north = self.index_of(bounds.y0), self.index_of(bounds.y1 - 1)
        if (east - west + 1) * (north - south + 1) <= len(occupied):
            return [cell for cell in self.cells(bounds) if cell in occupied]
        found = [c for c in occupied if west <= c.ix <= east and south <= c.iy <= north]
        return sorted(found, key=row_by_row)

    def around(self, bounds: Bounds) -> Bounds:
        """The counts of all cells that overlap ``bounds``, which must not be empty."""
        index = self.index_of
        return Bounds(
            self.first(index(bounds.x0)),
            self.first(index(bounds.y0)),
            self.first(index(bounds.x1 - 1) + 1),
            self.first(index(bounds.y1 - 1) + 1),
        )

    def within(self, bounds: Bounds) -> Bounds:
        """The counts of all cells that lie inside ``bounds`` as a whole; empty if there is no such cell."""
        index = self.index_of
        return Bounds(
            self.first(index(bounds.x0 - 1) + 1),
            self.first(index(bounds.y0 - 1) + 1),
            self.first(index(bounds.x1)),
            self.first(index(bounds.y1)),
        )

    def hull(self, cells: Iterable[Cell]) -> Bounds:
        """The smallest bounds that hold all ``cells`` (at least one)."""
        return reduce(Bounds.union, map(self.bounds, cells))

    def to_json(self) -> str:
        """``"p/q"``."""
        return str(self.size)

    @classmethod
    def from_json(cls, data: Any) -> Lattice:
        """The lattice that `to_json` wrote."""
        return cls(Fraction(data))
