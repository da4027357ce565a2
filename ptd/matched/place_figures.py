"""Figures per place from which the rules for photogrammetric and LiDAR clouds start: ``places`` of the state.

A place is a square of 256 m (`ptd.places`).

Cells of photogrammetric clouds have a size of 1 m, or of 2 m where points are sparse. A point
gets the same label as if the whole survey had cells of the size of its place. So cells of both
sizes are made where places of both kinds are near each other.
"""

from __future__ import annotations

from collections.abc import Mapping

from ptd.matched.cells import CELL_M, SPARSE_CELL_M, cell_size_m
from ptd.places import Figures, Table, place_of

DENSITY, SIGMA, CELL_SIGMA, CELL_SIZE, BOTH = range(5)
"""Indices of the figures of a place.

- `DENSITY`: points per square metre.
- `SIGMA`: noise of planar patches in metres, or None if unknown.
- `CELL_SIGMA`: noise in metres from which the rules for photogrammetric clouds start.
- `CELL_SIZE`: size of the cells in metres.
- `BOTH`: 1 if cells of the other size are needed, too, else 0.
"""
CELL_SIZES_M = (CELL_M, SPARSE_CELL_M)
"""Possible sizes of cells."""
SIZES_AROUND = 8
"""Number of places around a place in which cells of its size are needed. This distance covers
the summed radii of all passes on cells."""


def known(figures: Figures, figure: int) -> float:
    """Return a figure of a place as a number, for figures that are never None."""
    return float(figures[figure] or 0.0)


def cell_sizes(table: Table) -> tuple[float, ...]:
    """Return the sizes of cells that the places of a table need."""
    needed_sizes = {known(figures, CELL_SIZE) for figures in table.values()}
    both = any(figures[BOTH] for figures in table.values())
    return CELL_SIZES_M if both else tuple(sorted(needed_sizes))


def with_cell_sizes(table: Mapping[str, list[float | None]]) -> dict[str, list[float | None]]:
    """Return a table with `CELL_SIZE` and `BOTH` appended to the figures from which they follow."""
    size_by_name = {
        name: cell_size_m(known(figures, DENSITY)) for name, figures in table.items()
    }
    sparse = {
        place_of(name) for name, size_m in size_by_name.items() if size_m == SPARSE_CELL_M
    }
    fine = {place_of(name) for name, size_m in size_by_name.items() if size_m == CELL_M}
    both = fine & _around(sparse, len(fine)) | sparse & _around(fine, len(sparse))
    return {
        name: [*figures, size_by_name[name], float(place_of(name) in both)]
        for name, figures in table.items()
    }


def _around(places: set[tuple[int, int]], others: int) -> set[tuple[int, int]]:
    """Return all places within `SIZES_AROUND` of given places, or none if the number of other places is 0."""
    steps = range(-SIZES_AROUND, SIZES_AROUND + 1)
    if others == 0:
        return set()
    wide = {(column + step, row) for column, row in places for step in steps}
    return {(column, row + step) for column, row in wide for step in steps}
