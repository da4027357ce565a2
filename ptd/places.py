"""Figures that differ from place to place: places are squares of 256 m on a lattice anchored at CRS coordinate 0.

The state of a run contains a table of them under `PLACES`: keys are places as "column,row", values are the figures at
their middles. Between middles a figure is bilinear (`Field`). The table of a country has a million entries, so a task
gets only those around its window (`near`). The figure at a point depends only on the four middles around it, so these
suffice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ptd.frame import OPEN, CellLattice, Scale, Window
from ptd.kernel import as_int64, kernel

PLACE_M = 256.0
"""Side of a place in metres. A place has some hundreds of planar patches, and is not wider than a flight strip."""
PLACES = "places"
"""Name of the table in the state of a run."""

Float64 = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
Figures = Sequence[float | None]
Table = Mapping[str, Figures]


def name_of(column: int, row: int) -> str:
    """Name of a place in a table."""
    return f"{column},{row}"


def place_of(name: str) -> tuple[int, int]:
    """Column and row of a place by its name in a table."""
    column, row = name.split(",")
    return int(column), int(row)


def near(table: Table, window: Window, scale: Scale) -> dict[str, Figures]:
    """Return the places of a table on which figures in a window depend, or all of them for an open window."""
    if OPEN in (window.east, window.north, -window.west, -window.south):
        return dict(table)
    cells = CellLattice.of(PLACE_M, scale)
    names = (
        name_of(column, row)
        for row in range(cells.row(window.south) - 1, cells.row(window.north) + 2)
        for column in range(cells.column(window.west) - 1, cells.column(window.east) + 2)
    )
    return {name: table[name] for name in names if name in table}


class Field(NamedTuple):
    """A figure by place, bilinear between the middles of places, as an argument of kernels.

    Attributes
    ----------
    values : float64 [rows, columns]
        Values at the middles of places, southern row first, at least two rows and columns.
    column, row : int
        Column and row of the first place.
    p, q, origin_x, origin_y : int
        Fields of the lattice (`ptd.frame.CellLattice`).
    even : bool
        Whether the figure is the same everywhere.
    low, high : float
        Smallest and largest value.
    """

    values: Float64
    column: int
    row: int
    p: int
    q: int
    origin_x: int
    origin_y: int
    even: bool
    low: float
    high: float

    def times(self, factor: float) -> Field:
        """Return the figure in another unit, by a positive factor."""
        return self._replace(values=factor * self.values, low=factor * self.low, high=factor * self.high)


def everywhere(value: float) -> Field:
    """Return a figure that is the same everywhere."""
    return Field(np.full((2, 2), float(value)), 0, 0, 1, 1, 0, 0, True, float(value), float(value))


def field(table: Table, figure: int, scale: Scale, otherwise: float) -> Field:
    """Return one figure of all places in a table.

    Parameters
    ----------
    table : mapping
    figure : int
        Index of the figure among those of a place.
    scale : Scale
    otherwise : float
        Value at places that the table does not contain. No figure at a point depends on them.
    """
    known = {place_of(name): figures[figure] for name, figures in table.items()}
    found = {place: float(value) for place, value in known.items() if value is not None}
    if not found:
        return everywhere(otherwise)
    columns, rows = (sorted(place[axis] for place in found) for axis in (0, 1))
    values = np.full((rows[-1] - rows[0] + 2, columns[-1] - columns[0] + 2), float(otherwise))
    for (column, row), value in found.items():
        values[row - rows[0], column - columns[0]] = value
    even = len(set(found.values())) == 1
    if even:
        values[:] = next(iter(found.values()))
    cells = CellLattice.of(PLACE_M, scale)
    lattice = cells.p, cells.q, cells.origin_x, cells.origin_y
    return Field(values, columns[0], rows[0], *lattice, even, float(values.min()), float(values.max()))


def as_field(figure: float | Field) -> Field:
    """Return a figure by place. A number becomes a figure that is the same everywhere."""
    return figure if isinstance(figure, Field) else everywhere(figure)


@kernel
def _between(position: int, p: int, q: int, first: int, n: int) -> tuple[int, float]:
    """Index of the middle before a position (absolute counts), and the fraction of the way to the next one, 0 to 1."""
    beyond = 2 * q * position - p  # the middle of place k lies at 2 k p
    place = beyond // (2 * p)
    index = place - first
    if index < 0:
        return 0, 0.0
    if index > n - 2:
        return n - 2, 1.0
    return index, (beyond - 2 * p * place) / (2 * p)


@kernel
def value_at(field: Field, x: int, y: int) -> float:
    """Return the figure at a position in local counts."""
    values = field.values
    if field.even:
        return float(values[0, 0])
    rows, columns = values.shape
    i, v = _between(as_int64(y) + field.origin_y, field.p, field.q, field.row, rows)
    j, u = _between(as_int64(x) + field.origin_x, field.p, field.q, field.column, columns)
    # In this form equal values give just that value.
    lower = values[i, j] + u * (values[i, j + 1] - values[i, j])
    upper = values[i + 1, j] + u * (values[i + 1, j + 1] - values[i + 1, j])
    return float(lower + v * (upper - lower))


@kernel
def values_at(field: Field, x: Int32, y: Int32) -> Float64:
    """Return the figure at each of some positions in local counts: float64 [n]."""
    if field.even:
        return np.full(x.size, field.values[0, 0])
    found = np.empty(x.size, np.float64)
    for k in range(x.size):
        found[k] = value_at(field, as_int64(x[k]), as_int64(y[k]))
    return found


def of_places(table: Table, figure: int, x: Int32, y: Int32, scale: Scale) -> Float64:
    """Return the figure of the place of each position (local counts), without interpolation: float64 [n]."""
    found = field(table, figure, scale, 0.0)
    if found.even:
        return np.full(x.size, found.values[0, 0])
    columns, rows = CellLattice.of(PLACE_M, scale).places(x, y)
    height, width = found.values.shape
    values: Float64 = found.values[
        np.clip(rows - found.row, 0, height - 1), np.clip(columns - found.column, 0, width - 1)
    ]
    return values


@kernel
def _raster_of(field: Field, x: Int64, y: Int64) -> Float64:
    found = np.empty((y.size, x.size), np.float64)
    for row in range(y.size):
        for column in range(x.size):
            found[row, column] = value_at(field, x[column], y[row])
    return found


def on_cells(
    figure: float | Field, cells: CellLattice, row: int, column: int, shape: tuple[int, ...]
) -> Float64:
    """Return the figure at the middles of a raster's cells from a row and column on: float64 [rows, columns]."""
    field = as_field(figure)
    if field.even:
        return np.full(shape, field.values[0, 0])
    columns, rows = np.arange(column, column + shape[1] + 1), np.arange(row, row + shape[0] + 1)
    west, _ = cells.corners(columns, np.zeros_like(columns))
    _, south = cells.corners(np.zeros_like(rows), rows)
    return _raster_of(field, (west[:-1] + west[1:]) // 2, (south[:-1] + south[1:]) // 2)


def span(values: Sequence[float], digits: int, unit: str = "") -> str:
    """Return the smallest and largest of some values in words, or one number if both look the same."""
    low, high = (f"{value:.{digits}g}" for value in (min(values), max(values)))
    return f"{low}{unit}" if low == high else f"{low} to {high}{unit}"
