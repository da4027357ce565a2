"""Bounds of whole cells."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.core.lattice import Bounds, Cell, Lattice


def test_cells_around_bounds_hold_the_bounds() -> None:
    assert Lattice(Fraction(250)).around(Bounds(-1, 0, 1, 250)) == Bounds(-250, 0, 250, 250)
    assert Lattice(Fraction(1000, 3)).around(Bounds(0, 0, 1, 334)) == Bounds(0, 0, 334, 334)
    assert Lattice(Fraction(1000, 3)).around(Bounds(0, 0, 1, 335)) == Bounds(0, 0, 334, 667)


def test_the_hull_of_cells_holds_each() -> None:
    lattice = Lattice(Fraction(1000, 3))
    assert lattice.hull([Cell(-1, 2), Cell(2, 0)]) == Bounds(-333, 0, 1000, 1000)
    assert lattice.hull([Cell(4, 4)]) == lattice.bounds(Cell(4, 4))


@pytest.mark.parametrize(
    "bounds",
    [
        Bounds(-700, -1, 2400, 1700),
        Bounds(0, 0, 1, 1),
        Bounds(5, 5, 5, 9),
        Bounds(-(10**15), 0, 10**15, 9),
    ],
)
def test_occupied_cells_of_bounds_are_found_however_wide_these_are(bounds: Bounds) -> None:
    lattice = Lattice(Fraction(1000, 3))
    occupied = {Cell(ix, iy) for ix in range(-9, 9) for iy in range(-9, 9) if (ix * iy) % 3}
    found = lattice.among(bounds, occupied)
    assert set(found) == {
        c for c in occupied if not bounds.empty and lattice.bounds(c).overlaps(bounds)
    }
    assert found == sorted(found, key=lambda c: (c.iy, c.ix))
