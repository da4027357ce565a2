"""Bounds of whole cells."""

from __future__ import annotations

from fractions import Fraction

from tiler.core.lattice import Bounds, Cell, Lattice


def test_cells_around_bounds_hold_them() -> None:
    assert Lattice(Fraction(250)).around(Bounds(-1, 0, 1, 250)) == Bounds(-250, 0, 250, 250)
    assert Lattice(Fraction(1000, 3)).around(Bounds(0, 0, 1, 334)) == Bounds(0, 0, 334, 334)
    assert Lattice(Fraction(1000, 3)).around(Bounds(0, 0, 1, 335)) == Bounds(0, 0, 334, 667)


def test_the_hull_of_cells_holds_each() -> None:
    lattice = Lattice(Fraction(1000, 3))
    assert lattice.hull([Cell(-1, 2), Cell(2, 0)]) == Bounds(-333, 0, 1000, 1000)
    assert lattice.hull([Cell(4, 4)]) == lattice.bounds(Cell(4, 4))
