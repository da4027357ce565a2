"""Figures of each place from which the rules for photogrammetric and LiDAR clouds start: ``places`` of the state.

Cells of photogrammetric clouds have a side of 1 m, or of 2 m where points are sparse. A point gets the same label as if
the whole survey had cells of the side of its place. So cells of both sides are made where places of both kinds are near
each other.
"""

from __future__ import annotations

from collections.abc import Mapping

from ptd.matched.cells import CELL_M, SPARSE_CELL_M, cell_side_m
from ptd.places import Figures, Table, place_of

DENSITY, SIGMA, CELL_SIGMA, SIDE, BOTH = range(5)
"""Indices of the figures of a place.

- `DENSITY`: points per square metre.
- `SIGMA`: noise of planar patches in metres, or None if unknown.
- `CELL_SIGMA`: noise in metres from which the rules for photogrammetric clouds start.
- `SIDE`: side of the cells in metres.
- `BOTH`: 1 if cells of the other side are needed, too, else 0.
"""
SIDES_M = (CELL_M, SPARSE_CELL_M)
"""Possible sides of cells."""
SIDES_AROUND = 8
"""Distance in places within which cells of a place's side are needed: the radius of all passes on cells together."""


def known(figures: Figures, figure: int) -> float:
    """Return a figure of a place that is always a number."""
    return float(figures[figure] or 0.0)


def sides(table: Table) -> tuple[float, ...]:
    """Return the sides of cells that the places of a table need."""
    needed_sides = {known(figures, SIDE) for figures in table.values()}
    both = any(figures[BOTH] for figures in table.values())
    return SIDES_M if both else tuple(sorted(needed_sides))


def with_sides(table: Mapping[str, list[float | None]]) -> dict[str, list[float | None]]:
    """Return a table with `SIDE` and `BOTH` appended to the figures from which they follow."""
    side_by_name = {name: cell_side_m(known(figures, DENSITY)) for name, figures in table.items()}
    sparse = {place_of(name) for name, side in side_by_name.items() if side == SPARSE_CELL_M}
    fine = {place_of(name) for name, side in side_by_name.items() if side == CELL_M}
    both = fine & _around(sparse, len(fine)) | sparse & _around(fine, len(sparse))
    return {
        name: [*figures, side_by_name[name], float(place_of(name) in both)] for name, figures in table.items()
    }


def _around(places: set[tuple[int, int]], others: int) -> set[tuple[int, int]]:
    """Return all places within `SIDES_AROUND` of given places, or none if the number of other places is 0."""
    steps = range(-SIDES_AROUND, SIDES_AROUND + 1)
    if others == 0:
        return set()
    wide = {(column + step, row) for column, row in places for step in steps}
    return {(column, row + step) for column, row in wide for step in steps}
