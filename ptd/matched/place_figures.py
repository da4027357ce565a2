"""Figures of a place that the rules of matched clouds and of laser scans start from, in ``places`` of the state.

Cells of matched clouds are of 1 m, or of 2 m where points are sparse. What a point gets is what it would get if the
whole survey had the cells of its place: so where places of both kinds are near each other, cells of both are made.
"""

from __future__ import annotations

from collections.abc import Mapping

from ptd.matched.cells import CELL_M, SPARSE_CELL_M, cell_side_m
from ptd.places import Figures, Table, place_of

DENSITY, SIGMA, CELL_SIGMA, SIDE, BOTH = range(5)
"""Points per square metre; noise of planar patches in metres (None: not known); noise that the rules of matched clouds
start from; side of the cells in metres; 1 where cells of the other side are needed, too, else 0."""
SIDES_M = (CELL_M, SPARSE_CELL_M)
"""Sides that cells have."""
SIDES_AROUND = 7
"""Places within which cells of a place's side are needed: what the passes after the cells see together."""


def known(figures: Figures, figure: int) -> float:
    """A figure of a place that always is a number."""
    return float(figures[figure] or 0.0)


def sides(table: Table) -> tuple[float, ...]:
    """Sides of cells that some places need."""
    own = {known(figures, SIDE) for figures in table.values()}
    both = any(figures[BOTH] for figures in table.values())
    return SIDES_M if both else tuple(sorted(own))


def with_sides(table: Mapping[str, list[float | None]]) -> dict[str, list[float | None]]:
    """A table with `SIDE` and `BOTH` after the figures that they follow from."""
    own = {name: cell_side_m(known(figures, DENSITY)) for name, figures in table.items()}
    sparse = {place_of(name) for name, side in own.items() if side == SPARSE_CELL_M}
    fine = {place_of(name) for name, side in own.items() if side == CELL_M}
    both = fine & _around(sparse, len(fine)) | sparse & _around(fine, len(sparse))
    return {name: [*figures, own[name], float(place_of(name) in both)] for name, figures in table.items()}


def _around(places: set[tuple[int, int]], others: int) -> set[tuple[int, int]]:
    """All places near some; none of them if there are no others."""
    steps = range(-SIDES_AROUND, SIDES_AROUND + 1)
    if others == 0:
        return set()
    wide = {(column + step, row) for column, row in places for step in steps}
    return {(column, row + step) for column, row in wide for step in steps}
