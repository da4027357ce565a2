"""Figures by place: bilinear between middles of a lattice anchored at coordinate 0, alike in any window and frame."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from ptd.frame import CellLattice, Scale, Window
from ptd.places import (
    PLACE_M,
    everywhere,
    field,
    name_of,
    near,
    of_places,
    on_cells,
    span,
    value_at,
    values_at,
)

SCALES = [
    Scale(),
    Scale(Fraction(1, 1000), Fraction(1, 1000), (-98_765_432, 5_400_000_321)),
    Scale(Fraction(1200, 3_937_000), Fraction(1, 1000), (12_345, -678)),
]


def table_around(scale: Scale, seed: int, side: int = 9) -> dict[str, list[float | None]]:
    cells, random = CellLattice.of(PLACE_M, scale), np.random.default_rng(seed)
    column, row = cells.column(0) - 2, cells.row(0) - 2
    return {
        name_of(column + c, row + r): [float(random.random())]
        for r in range(side)
        for c in range(side)
    }


def slow_value(table: dict[str, list[float | None]], x: int, y: int, scale: Scale) -> float:
    """The formula in exact numbers."""
    at_x, at_y = (
        (v + o) * scale.metres_xy / 256 - Fraction(1, 2)
        for v, o in zip((x, y), scale.origin, strict=True)
    )
    column, row = at_x // 1, at_y // 1
    u, v = at_x - column, at_y - row
    corners = [
        (0, 0, (1 - u) * (1 - v)),
        (1, 0, u * (1 - v)),
        (0, 1, (1 - u) * v),
        (1, 1, u * v),
    ]
    return float(
        sum(Fraction(table[name_of(column + c, row + r)][0]) * w for c, r, w in corners)
    )


@pytest.mark.parametrize("scale", SCALES)
def test_a_figure_is_bilinear_between_middles(scale: Scale) -> None:
    table = table_around(scale, 1)
    found = field(table, 0, scale, 0.0)
    reach = int(scale.counts(4 * PLACE_M))
    x, y = np.random.default_rng(2).integers(0, reach, (2, 200)).astype(np.int32)
    expected = [slow_value(table, int(a), int(b), scale) for a, b in zip(x, y, strict=True)]
    assert values_at(found, x, y) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("scale", SCALES)
def test_a_window_knows_what_its_figures_rest_on(scale: Scale) -> None:
    """To the bit; and so does a raster of cells."""
    table, side = table_around(scale, 3), int(scale.counts(100))
    window = Window(side, 2 * side, 5 * side, 4 * side)
    part = near(table, window, scale)
    assert len(part) < 30
    x, y = (
        np.random.default_rng(4)
        .integers((side, 2 * side), (5 * side, 4 * side), (300, 2))
        .astype(np.int32)
        .T
    )
    whole, cut = (values_at(field(t, 0, scale, 0.0), x, y) for t in (table, part))
    assert whole.tobytes() == cut.tobytes()
    cells = CellLattice.of(2.0, scale)
    row, column = cells.row(2 * side) + 1, cells.column(side) + 1
    rasters = [
        on_cells(field(t, 0, scale, 0.0), cells, row, column, (30, 40)) for t in (table, part)
    ]
    assert rasters[0].tobytes() == rasters[1].tobytes()
    own = (of_places(t, 0, x, y, scale) for t in (table, part))
    assert np.array_equal(*own)


def test_another_frame_changes_no_bit() -> None:
    other = Scale(origin=(-1_000_003, 70_000))
    table = table_around(Scale(), 5)
    x, y = np.random.default_rng(6).integers(0, 1_000_000, (2, 300)).astype(np.int32)
    moved = values_at(
        field(table, 0, other, 0.0), x + np.int32(1_000_003), y - np.int32(70_000)
    )
    assert moved.tobytes() == values_at(field(table, 0, Scale(), 0.0), x, y).tobytes()


def test_equal_figures_are_the_same_everywhere_to_the_bit() -> None:
    """A window with other places has to say the same between four equal ones."""
    alike = {name_of(c, r): [0.1] for c in range(3) for r in range(3)}
    mixed = field({**alike, name_of(7, 0): [0.7]}, 0, Scale(), 0.0)
    assert not mixed.even
    x = np.arange(130_000, 600_000, 7919, dtype=np.int32)
    assert set(values_at(mixed, x, x)) == {0.1}
    assert field(alike, 0, Scale(), 0.0).even


def test_the_figure_of_a_place_is_not_between_middles() -> None:
    table = {name_of(0, 0): [1.0], name_of(1, 0): [2.0]}
    x = np.array([0, 255_999, 256_000, 511_999], np.int32)
    assert of_places(table, 0, x, np.full(4, 9, np.int32), Scale()).tolist() == [
        1.0,
        1.0,
        2.0,
        2.0,
    ]


def test_what_is_not_known_anywhere_is_the_same_everywhere() -> None:
    assert value_at(field({}, 0, Scale(), 3.5), 1, 2) == 3.5
    assert value_at(field({"0,0": [None]}, 0, Scale(), 3.5), 1, 2) == 3.5
    assert value_at(everywhere(0.25), -9, 10**6) == 0.25


def test_a_span_in_words() -> None:
    assert (span([0.12, 0.24], 2), span([0.2, 0.2001], 2)) == ("0.12 to 0.24", "0.2")
