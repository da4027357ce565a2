"""A code for each cell: the same for all its points, uncertified beyond what is certain."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale, Window
from ptd.methods.auto.cells import (
    ABOVE_NOISE,
    OUTLIER,
    SEED,
    CellCodes,
    ElectedCells,
    lowest_points,
)
from ptd.passes import Points

SCALE = Scale(origin=(-300, 450))
CELLS = CellLattice.of(1.0, SCALE)


def points(*rows: tuple[int, int, int], labels: list[int] | None = None) -> Points:
    xyz = np.ascontiguousarray(np.array(rows, np.int32).reshape(-1, 3).T)
    return Points(xyz, None if labels is None else np.array(labels, np.uint8))


@pytest.mark.parametrize("far", [3_000, 2_000_000_000])
def test_points_take_the_code_of_their_cell(far: int) -> None:
    """Cells start at 300 and 550 of local counts; whether the raster is kept or searched shows nowhere."""
    x, y = np.array([300, 1300, far], np.int32), np.array([550, 550, 1550], np.int32)
    is_uncertified = np.array([False, True, False])
    window = Window(300, 550, 2_000_000_500, 2_550)
    model = CellCodes(
        x, y, np.array([3, 4, 7], np.uint8), CELLS, window, {"seeds": 2}, is_uncertified
    )
    given = points(
        (1299, 1549, 5),
        (300, 550, -5),
        (1300, 600, 0),
        (far + 9, 1600, 0),
        (299, 550, 0),
        (700, 1550, 0),
    )
    codes, marks = model.label(given)
    assert codes.tolist() == [3, 3, 4, 7, 1, 1]
    assert marks.tolist() == [False, False, True, False, True, False]
    assert model.stats == {"cells": 3, "seeds": 2}
    # of the cells' own points no cell is looked up
    codes, marks = model.label(Points(np.stack([x, y, x])))
    assert (codes.tolist(), marks.tolist()) == ([3, 4, 7], [False, True, False])


def test_without_a_point_all_is_missing() -> None:
    none = np.zeros(0, np.int32)
    empty = CellCodes(none, none, np.zeros(0, np.uint8), CELLS, Window.everything(), {})
    codes, marks = empty.label(points((1, 2, 3)))
    assert (codes.tolist(), marks.tolist()) == ([1], [False])


def test_the_lowest_point_of_a_cell_and_its_label() -> None:
    given = points((1400, 600, 9), (1350, 700, -2), (310, 560, 4), labels=[3, 4, 5])
    x, y, z, labels = lowest_points(given, CELLS)
    assert [c.tolist() for c in (x, y, z, labels)] == [[310, 1350], [560, 700], [4, -2], [5, 4]]
    assert lowest_points(points((1, 2, 3)), CELLS)[3].tolist() == [0]


def test_cells_elect_the_lowest_point_that_is_not_noise() -> None:
    """The second cell has only noise. The bit of the first one is kept by later passes."""
    given = points(
        (310, 560, -9), (320, 570, -5), (330, 580, 2), (340, 590, 1), (1310, 560, -7),
        (1320, 570, -4), (2310, 560, 3), (2320, 570, 4),
    )  # fmt: skip
    noise = np.array([True, True, False, False, True, True, False, False])
    everything = Window.everything()
    model = ElectedCells(Xyz(*given.columns()), noise, CELLS, everything)
    elected = model.elect(everything)
    assert elected.T.tolist() == [[340, 590, 1], [1320, 570, -4], [2310, 560, 3]]
    codes, _ = model.label(Points(elected))
    assert codes.tolist() == [ABOVE_NOISE, OUTLIER, 0]
    assert model.elect(Window(0, 0, 1000, 1000)).T.tolist() == [[340, 590, 1]]
    later = Points(elected, codes)
    x, y, _, stripped = lowest_points(later, CELLS)
    assert stripped.tolist() == [0, OUTLIER, 0]
    new = np.array([SEED, OUTLIER, SEED], np.uint8)
    kept = CellCodes(x, y, new, CELLS, everything, {}).label(later)[0]
    assert kept.tolist() == [SEED | ABOVE_NOISE, OUTLIER, SEED]
