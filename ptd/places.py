"""Figures that differ from place to place, such as the noise of heights.

A place is a square of 256 m, on a lattice anchored at coordinate 0 of the CRS. The state of a
run contains a table under the name `PLACES`. The keys of the table are places as "column,row",
and its values are the figures at the middles of the places. Between middles, a figure is
interpolated bilinearly (`Field`). So the figure at a point depends only on the four middles
around the point. The table of a country has a million entries. So a task is passed only the
entries around its window (`near`).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ptd.arrays import Float64, Int32, Int64
from ptd.frame import OPEN, CellGrid, CellLattice, Scale, Window
from ptd.kernel import as_int64, kernel

PLACE_M = 256.0
"""Size of a place in metres. A place has some hundred planar patches, and is no wider than a
flight strip."""
PLACES = "places"
"""Name of the table in the state of a run."""
TREES = "trees"
"""Name of a second table, if a canopy was found: the height of the trees around each place."""
TABLES = (PLACES, TREES)

Figures = Sequence[float | None]
Table = Mapping[str, Figures]


def name_of(column: int, row: int) -> str:
    """Return the name of a place in a table."""
    return f"{column},{row}"


def place_of(name: str) -> tuple[int, int]:
    """Return column and row of a place from its name in a table."""
    column, row = name.split(",")
    return int(column), int(row)


def near(table: Table, window: Window, scale: Scale) -> dict[str, Figures]:
    """Return the entries of a table on which figures in a window depend, or all entries if a side is open."""
    if OPEN in (window.east, window.north, -window.west, -window.south):
        return dict(table)
    cells = CellLattice.of(PLACE_M, scale)
    rows = range(cells.row(window.south) - 1, cells.row(window.north) + 2)
    columns = range(cells.column(window.west) - 1, cells.column(window.east) + 2)
    entries = {}
    for row, column in itertools.product(rows, columns):
        name = name_of(column, row)
        if name in table:
            entries[name] = table[name]
    return entries


class Field(NamedTuple):
    """One figure of all places, interpolated bilinearly between the middles of places, as an argument of kernels.

    Attributes
    ----------
    values : float64 [rows, columns]
        Values at the middles of places, southern row first, at least two rows and columns.
    grid : CellGrid
        Lattice of the places, counted from the first one.
    even : bool
        Whether the figure is the same everywhere.
    low, high : float
        Smallest and largest value.
    """

    values: Float64
    grid: CellGrid
    even: bool
    low: float
    high: float

    def times(self, factor: float) -> Field:
        """Return the figure multiplied by a positive factor, to convert its unit."""
        return self._replace(
            values=factor * self.values, low=factor * self.low, high=factor * self.high
        )


def everywhere(value: float) -> Field:
    """Return a figure that is the same everywhere."""
    return Field(
        np.full((2, 2), float(value)),
        CellGrid(1, 1, 0, 0, 0, 0),
        True,
        float(value),
        float(value),
    )


def field(table: Table, figure: int, scale: Scale, otherwise: float) -> Field:
    """Return one figure of all places in a table.

    Parameters
    ----------
    table : mapping
    figure : int
        Index of the figure in the values of the table.
    scale : Scale
    otherwise : float
        Value at places that are not in the table. This value does not change figures at points of the run.
    """
    known: dict[tuple[int, int], float] = {}
    for name, figures in table.items():
        value = figures[figure]
        if value is not None:
            known[place_of(name)] = float(value)
    if not known:
        return everywhere(otherwise)
    columns = sorted(column for column, _ in known)
    rows = sorted(row for _, row in known)
    values = np.full((rows[-1] - rows[0] + 2, columns[-1] - columns[0] + 2), float(otherwise))
    for (column, row), value in known.items():
        values[row - rows[0], column - columns[0]] = value
    even = len(set(known.values())) == 1
    if even:
        values[:] = next(iter(known.values()))
    grid = CellLattice.of(PLACE_M, scale).grid(columns[0], rows[0])
    return Field(values, grid, even, float(values.min()), float(values.max()))


def as_field(figure: float | Field) -> Field:
    """Return a `Field` unchanged. Convert a number to a figure that is the same everywhere."""
    return figure if isinstance(figure, Field) else everywhere(figure)


@kernel
def _between(position: int, p: int, q: int, first: int, n: int) -> tuple[int, float]:
    """Return the index of the last middle before a position, and the fraction of the way to the next middle, 0 to 1.

    The position is in absolute counts. ``first`` is the number of the place with the index 0,
    and ``n`` is the number of places.
    """
    # The distance from the middle of place 0, in units of 1 / (2 q) counts. In these units a
    # place has the size 2 p.
    scaled = 2 * q * position - p
    place = scaled // (2 * p)
    index = place - first
    if index < 0:
        return 0, 0.0
    if index > n - 2:
        return n - 2, 1.0
    return index, (scaled - 2 * p * place) / (2 * p)


@kernel
def value_at(field: Field, x: int, y: int) -> float:
    """Return the figure at a position in local counts."""
    values = field.values
    if field.even:
        return float(values[0, 0])
    rows, columns = values.shape
    p, q, origin_x, origin_y, first_column, first_row = field.grid
    i, v = _between(as_int64(y) + origin_y, p, q, first_row, rows)
    j, u = _between(as_int64(x) + origin_x, p, q, first_column, columns)
    # This form of the interpolation returns exactly the same value if all four values are
    # equal.
    lower = values[i, j] + u * (values[i, j + 1] - values[i, j])
    upper = values[i + 1, j] + u * (values[i + 1, j + 1] - values[i + 1, j])
    return float(lower + v * (upper - lower))


@kernel
def values_at(field: Field, x: Int32, y: Int32) -> Float64:
    """Return the figure at each of several positions in local counts: float64 [n]."""
    if field.even:
        return np.full(x.size, field.values[0, 0])
    values = np.empty(x.size, np.float64)
    for k in range(x.size):
        values[k] = value_at(field, as_int64(x[k]), as_int64(y[k]))
    return values


def of_places(table: Table, figure: int, x: Int32, y: Int32, scale: Scale) -> Float64:
    """Return the figure of the place of each position (local counts), without interpolation: float64 [n]."""
    by_place = field(table, figure, scale, 0.0)
    if by_place.even:
        return np.full(x.size, by_place.values[0, 0])
    columns, rows = CellLattice.of(PLACE_M, scale).cell_indices(x, y)
    height, width = by_place.values.shape
    rows = np.clip(rows - by_place.grid.row, 0, height - 1)
    columns = np.clip(columns - by_place.grid.column, 0, width - 1)
    return by_place.values[rows, columns]


@kernel
def _raster_of(field: Field, x: Int64, y: Int64) -> Float64:
    raster = np.empty((y.size, x.size), np.float64)
    for row in range(y.size):
        for column in range(x.size):
            raster[row, column] = value_at(field, x[column], y[row])
    return raster


def on_cells(
    figure: float | Field, cells: CellLattice, row: int, column: int, shape: tuple[int, ...]
) -> Float64:
    """Return the figure at the middles of the cells of a raster: float64 [rows, columns].

    ``row`` and ``column`` are the row and column of the first cell of the raster.
    """
    field = as_field(figure)
    if field.even:
        return np.full(shape, field.values[0, 0])
    columns = np.arange(column, column + shape[1] + 1)
    rows = np.arange(row, row + shape[0] + 1)
    west, _ = cells.corners(columns, np.zeros_like(columns))
    _, south = cells.corners(np.zeros_like(rows), rows)
    return _raster_of(field, (west[:-1] + west[1:]) // 2, (south[:-1] + south[1:]) // 2)


def span(values: Sequence[float], digits: int, unit: str = "") -> str:
    """Return the smallest and the largest value as a text, or one number if they are equal after rounding."""
    low, high = (f"{value:.{digits}g}" for value in (min(values), max(values)))
    return f"{low}{unit}" if low == high else f"{low} to {high}{unit}"
