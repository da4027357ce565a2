"""Virtual points around the points of a TIN."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ptd.frame import CellLattice, Scale
from ptd.methods.dong2017.growth import rim

SCALE = Scale(Fraction(1, 100), Fraction(1, 100), (1_234_567, -7_654_321))
CELLS = CellLattice.of(4.0, SCALE)


def block(rows: int, columns: int) -> np.ndarray:
    """One point in each cell of a block, on a plane: int32 [3, n]."""
    rng = np.random.default_rng(3)
    c0, r0 = CELLS.column(0) + 1, CELLS.row(0) + 1
    corners = np.array(
        [(CELLS.west(c0 + c), CELLS.south(r0 + r)) for r in range(rows) for c in range(columns)]
    )
    xy = corners.T + rng.integers(0, 400, (2, len(corners)))
    return np.vstack([xy, plane(*xy)]).astype(np.int32)


def plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 5000 + 0.2 * x - 0.1 * y


def cells_of(points: np.ndarray) -> set[tuple[int, int]]:
    return {
        (CELLS.column(int(x)), CELLS.row(int(y)))
        for x, y in zip(points[0], points[1], strict=True)
    }


def test_each_empty_cell_within_two_has_a_point_in_its_middle() -> None:
    points = block(3, 4)
    found = rim(*points, CELLS)
    filled = cells_of(points)
    wanted = {
        (c + i, r + j) for c, r in filled for i in range(-2, 3) for j in range(-2, 3)
    } - filled
    assert cells_of(found.T) == wanted
    assert len(found) == len(wanted) == 7 * 8 - 12
    for x, y, _ in found:
        assert x == CELLS.west(CELLS.column(int(x))) + 200
        assert y == CELLS.south(CELLS.row(int(y))) + 200


def test_virtual_points_extend_the_plane_of_the_ground() -> None:
    found = rim(*block(4, 4), CELLS)
    # few cells near there
    corner = abs(found[:, :2] - np.median(found[:, :2], axis=0)).min(axis=1) > 1000
    assert abs(found[:, 2] - plane(found[:, 0], found[:, 1]))[~corner].max() <= 2


def test_a_hole_is_filled() -> None:
    points = block(7, 7)
    kept = np.delete(points, 24, axis=1)
    found = rim(*kept, CELLS)
    hole = cells_of(points[:, 24:25])
    inner = [
        z - plane(x, y)
        for x, y, z in found
        if (CELLS.column(int(x)), CELLS.row(int(y))) in hole
    ]
    assert len(inner) == 1
    assert abs(inner[0]) <= 2


def test_few_points_give_their_mean_height() -> None:
    found = rim(*np.array([[100, 500], [100, 100], [0, 300]], np.int32), CELLS)
    near = found[(found[:, 0] > 0) & (found[:, 0] < 800)]
    assert set(near[:, 2].tolist()) == {150}


def test_points_on_a_line_give_their_mean_height() -> None:
    x = np.arange(5, dtype=np.int32) * 400 + 33
    found = rim(x, np.full(5, 50, np.int32), np.full(5, 7, np.int32), CELLS)
    assert set(found[:, 2].tolist()) == {7}


def test_no_points_no_rim() -> None:
    none = np.zeros(0, np.int32)
    assert rim(none, none, none, CELLS).shape == (0, 3)
