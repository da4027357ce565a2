"""Integer frame: coordinates are int32 counts of a thousandth of a unit of the CRS.

Bounds are half-open and in absolute counts, and lattices of exact rational cells are anchored at count 0.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from ptd.arrays import Float64, Int32, Int64
from tiler.core.units import Units

COUNTS_PER_UNIT = 1000
"""Counts per unit of the CRS, independent of the scales of the files.

A count is a millimetre if the CRS is in metres and 0.3 mm if it is in feet."""

INT32_LIMIT = 2**31 - 1


@dataclass(frozen=True)
class CoordFrame:
    """Frame that gives the int32 counts their meaning.

    An *absolute* count is ``round(coordinate * 1000)``, an int64. The *local* count that is
    stored is the absolute count minus ``origin``. Heights have no origin, since int32 counts
    are enough for heights up to 2147 km. All lattices are anchored at absolute count 0, so the
    origin does not influence results.
    """

    units: Units = field(default_factory=Units)
    origin: tuple[int, int] = (0, 0)
    crs_wkt: str | None = None

    @property
    def metres_xy(self) -> Fraction:
        """Metres in one horizontal count."""
        return self.units.horizontal / COUNTS_PER_UNIT

    @property
    def metres_z(self) -> Fraction:
        """Metres in one vertical count."""
        return self.units.vertical / COUNTS_PER_UNIT

    def counts(self, metres: Fraction) -> Fraction:
        """Convert a horizontal length in metres to an exact number of counts."""
        return metres / self.metres_xy

    def coordinate(self, absolute: npt.ArrayLike) -> Float64:
        """Convert absolute counts to coordinates in units of the CRS, float64."""
        return np.asarray(absolute, dtype=np.float64) / COUNTS_PER_UNIT

    def coordinates(self, xyz: Int32) -> Float64:
        """Convert local counts int32 (3, n) to coordinates in units of the CRS, float64 (n, 3)."""
        return self.coordinate(xyz.T + np.array([*self.origin, 0], dtype=np.int64))

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-able description, which `from_json` reads."""
        return {
            "units": [str(self.units.horizontal), str(self.units.vertical)],
            "origin": list(self.origin),
            "crs_wkt": self.crs_wkt,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> CoordFrame:
        """Return the frame that `to_json` described."""
        horizontal, vertical = (Fraction(u) for u in data["units"])
        x, y = data["origin"]
        return cls(Units(horizontal, vertical), (int(x), int(y)), data["crs_wkt"])


@dataclass(frozen=True)
class Bounds:
    """Half-open rectangle ``x0 <= x < x1, y0 <= y < y1`` in absolute counts (int)."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def empty(self) -> bool:
        """Whether the bounds contain no count."""
        return self.x0 >= self.x1 or self.y0 >= self.y1

    def pad(self, counts: int) -> Bounds:
        """Return these bounds, extended by ``counts`` on every side."""
        return Bounds(self.x0 - counts, self.y0 - counts, self.x1 + counts, self.y1 + counts)

    def union(self, other: Bounds) -> Bounds:
        """Return the smallest bounds that contain both."""
        return Bounds(
            min(self.x0, other.x0),
            min(self.y0, other.y0),
            max(self.x1, other.x1),
            max(self.y1, other.y1),
        )

    def intersection(self, other: Bounds) -> Bounds:
        """Return the counts in both bounds, which may be empty."""
        return Bounds(
            max(self.x0, other.x0),
            max(self.y0, other.y0),
            min(self.x1, other.x1),
            min(self.y1, other.y1),
        )

    def overlaps(self, other: Bounds) -> bool:
        """Return whether some count is in both bounds."""
        return (
            self.x0 < other.x1
            and other.x0 < self.x1
            and self.y0 < other.y1
            and other.y0 < self.y1
        )

    def area(self) -> int:
        """Return the area in square counts."""
        return max(self.x1 - self.x0, 0) * max(self.y1 - self.y0, 0)

    def to_json(self) -> list[int]:
        """Return ``[x0, y0, x1, y1]``."""
        return [self.x0, self.y0, self.x1, self.y1]

    @classmethod
    def from_json(cls, data: list[int]) -> Bounds:
        """Return the bounds that `to_json` wrote."""
        x0, y0, x1, y1 = (int(v) for v in data)
        return cls(x0, y0, x1, y1)


@dataclass(frozen=True, order=True)
class Cell:
    """Cell of a lattice: column ``ix`` to the east, row ``iy`` to the north."""

    ix: int
    iy: int

    @property
    def name(self) -> str:
        """Readable name, like ``+12-03``."""
        return f"{self.ix:+03d}{self.iy:+03d}"


def row_by_row(cell: Cell) -> tuple[int, int]:
    """Return a sort key that orders cells row by row from the south-west."""
    return cell.iy, cell.ix


@dataclass(frozen=True)
class Lattice:
    """Square cells of ``size`` counts (an exact fraction). Cell 0 starts at absolute count 0.

    A count belongs to cell ``floor(count * q / p)`` with ``size = p / q``, in int64 arithmetic
    without a tolerance.
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

    def index(self, absolute: Int64) -> Int64:
        """Return the cell indices of absolute counts, int64 of the same shape."""
        return (absolute * self.q) // self.p

    def index_of(self, absolute: int) -> int:
        """Return the cell index of one absolute count."""
        return (absolute * self.q) // self.p

    def end_of(self, absolute: int) -> int:
        """Return the index of the first cell that begins at or after one absolute count."""
        return -((-absolute * self.q) // self.p)

    def first(self, index: int) -> int:
        """Return the first absolute count that belongs to cell ``index``."""
        return -((-index * self.p) // self.q)

    def bounds(self, cell: Cell) -> Bounds:
        """Return the bounds of the counts that belong to a cell."""
        return Bounds(
            self.first(cell.ix),
            self.first(cell.iy),
            self.first(cell.ix + 1),
            self.first(cell.iy + 1),
        )

    def cells(self, bounds: Bounds) -> Iterator[Cell]:
        """Yield every cell that overlaps ``bounds``, row by row from the south-west. Use it only for small bounds."""
        if bounds.empty:
            return
        for iy in range(self.index_of(bounds.y0), self.index_of(bounds.y1 - 1) + 1):
            for ix in range(self.index_of(bounds.x0), self.index_of(bounds.x1 - 1) + 1):
                yield Cell(ix, iy)

    def among(self, bounds: Bounds, occupied: Collection[Cell]) -> list[Cell]:
        """Return the occupied cells that overlap ``bounds``, row by row from the south-west.

        The loop is over the cells of the bounds or over the occupied cells, if these are fewer:
        the bounds of a few distant points can have a thousand million cells.
        """
        if bounds.empty:
            return []
        west, east = self.index_of(bounds.x0), self.index_of(bounds.x1 - 1)
        south, north = self.index_of(bounds.y0), self.index_of(bounds.y1 - 1)
        if (east - west + 1) * (north - south + 1) <= len(occupied):
            return [cell for cell in self.cells(bounds) if cell in occupied]
        cells = [c for c in occupied if west <= c.ix <= east and south <= c.iy <= north]
        return sorted(cells, key=row_by_row)

    def around(self, bounds: Bounds) -> Bounds:
        """Return the bounds of all cells that overlap ``bounds``, which must not be empty."""
        index = self.index_of
        return Bounds(
            self.first(index(bounds.x0)),
            self.first(index(bounds.y0)),
            self.first(index(bounds.x1 - 1) + 1),
            self.first(index(bounds.y1 - 1) + 1),
        )

    def within(self, bounds: Bounds) -> Bounds:
        """Return the bounds of all cells that lie completely inside ``bounds``, which are empty if there are none."""
        index = self.index_of
        return Bounds(
            self.first(index(bounds.x0 - 1) + 1),
            self.first(index(bounds.y0 - 1) + 1),
            self.first(index(bounds.x1)),
            self.first(index(bounds.y1)),
        )

    def hull(self, cells: Iterable[Cell]) -> Bounds:
        """Return the smallest bounds that contain all ``cells`` (at least one)."""
        return reduce(Bounds.union, map(self.bounds, cells))

    def to_json(self) -> str:
        """Return the cell size as ``"p/q"``."""
        return str(self.size)

    @classmethod
    def from_json(cls, data: Any) -> Lattice:
        """Return the lattice that `to_json` wrote."""
        return cls(Fraction(data))
