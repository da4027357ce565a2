"""Facades and the roads beside them, on scenes with known answers."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np

from ptd.frame import CellLattice, Scale
from ptd.methods.dong2017.facades import FacadeRule, Facades, density_of, facade_threshold

CM = 100
SCALE = Scale(Fraction(1, CM), Fraction(1, CM), (4_000_000, 8_000_000))
CELLS = CellLattice.of(1.0, SCALE)
RULE = FacadeRule(straight=4, diagonal=3, min_drop=250.0, variation=10.0, z_ratio=1.0)


def test_threshold_of_equation_3_by_hand() -> None:
    """35 points/m2, a facade of 5 m over a cell of 1 m, half of it glass: (35 5 1 + 35 1 1) / 2."""
    assert facade_threshold(35.0, 5.0, 1.0, 0.5) == 105.0
    assert facade_threshold(10.0, 6.0, 0.5, 1.0) == 10 * 6 * 0.5 + 10 * 0.25


def test_a_sparse_cloud_is_not_all_facades() -> None:
    """At 1 point/m2, equation 3 gives 2, which a quarter of all flat cells exceed by chance."""
    assert facade_threshold(1.0, 3.0, 1.0, 0.5) == 1 + 5 * 1
    assert facade_threshold(9.0, 3.0, 1.0, 0.5) == 9 + 5 * 3


def test_density_is_that_of_the_median_cell() -> None:
    """Cells of 1, 8, 9, 9, 60 points: the median holds 9."""
    points_by_count = Counter({1: 1, 8: 8, 9: 18, 60: 60})
    assert density_of(points_by_count, 0.25) == 36.0
    assert density_of({}, 1.0) == 0.0


def grid(heights: np.ndarray, per_cell: int = 9, seed: int = 3) -> np.ndarray:
    """Points scattered over cells of 1 m, ``heights[row, column]`` in metres: int32 [3, n]."""
    rng = np.random.default_rng(seed)
    rows, columns = (np.repeat(i.ravel(), per_cell) for i in np.indices(heights.shape))
    x = columns * CM + rng.integers(0, CM, columns.size)
    y = rows * CM + rng.integers(0, CM, rows.size)
    z = np.rint(heights[rows, columns] * CM + rng.normal(0, 3, x.size))
    return np.stack([x, y, z]).astype(np.int32)


def wall(column: int, rows: int, top: float, n: int = 60) -> np.ndarray:
    """A facade in one column of cells."""
    rng = np.random.default_rng(column)
    y, z = rng.integers(0, rows * CM, n * rows), rng.integers(0, int(top * CM), n * rows)
    return np.stack([np.full(y.size, column * CM + 5), y, z]).astype(np.int32)


def cloud(*parts: np.ndarray) -> np.ndarray:
    joined = np.concatenate(parts, axis=1)
    return np.ascontiguousarray(
        joined[:, np.random.default_rng(0).permutation(joined.shape[1])]
    )


def house() -> np.ndarray:
    """Ground at 0, a roof at 8 m from column 10 on, a facade in column 10."""
    heights = np.zeros((20, 20))
    heights[:, 10:] = 8.0
    return cloud(grid(heights), wall(10, 20, 8.0))


def seeds_of(points: np.ndarray, rule: FacadeRule = RULE) -> np.ndarray:
    """Columns and rows of the seeds' cells, and their heights: int [m, 3]."""
    found = points[:, Facades(*points, CELLS, 30.0).seeds(rule)]
    return np.stack([found[0] // CM, found[1] // CM, found[2]], axis=1)


def test_cells_above_the_threshold_hold_the_facade() -> None:
    points = house()
    facades = Facades(*points, CELLS, 30.0)
    inside = points[:, facades.points()]
    assert set((inside[0] // CM).tolist()) == {10}
    assert facades.holds.sum() == 20
    assert Facades(*points, CELLS, 300.0).holds.sum() == 0


def test_the_lower_side_across_the_facade_is_the_road() -> None:
    """The perpendicular reaches column 6 at d = 4 cells; diagonals reach column 7, which is nearer to the facade."""
    found = seeds_of(house())
    inner = found[(found[:, 1] > 4) & (found[:, 1] < 15)]
    assert set(inner[:, 0].tolist()) == {6}
    assert len(inner) == 10
    assert abs(found[:, 2]).max() < 10


def test_a_seed_has_the_median_height_of_its_cell() -> None:
    points = house()
    for column, row, height in seeds_of(points):
        cell = points[2][(points[0] // CM == column) & (points[1] // CM == row)]
        assert height == np.sort(cell)[(cell.size - 1) // 2]


def test_level_sides_have_no_road() -> None:
    """A wall in the open is a dense cell, but not a building."""
    assert len(seeds_of(cloud(grid(np.zeros((20, 20))), wall(10, 20, 8.0)))) == 0


def test_a_rough_place_gives_no_seed() -> None:
    points = house()
    low = points[0] // CM < 10
    points[2, low] += np.random.default_rng(5).integers(0, 80, low.sum()).astype(np.int32)
    assert len(seeds_of(points)) == 0
    loose = RULE._replace(variation=100.0)
    assert len(seeds_of(points, loose)) > 10


def test_a_sloped_place_is_flat() -> None:
    """Residuals of a plane count, not heights."""
    heights = np.zeros((20, 20)) + 0.3 * np.arange(20)
    heights[:, 10:] += 8.0
    assert len(seeds_of(cloud(grid(heights), wall(10, 20, 8.0)))) > 10


def test_a_blunder_in_the_cell_is_no_seed() -> None:
    """The blunder would be the lowest point of its cell, and spoils the plane around it."""
    points = house()
    low = np.flatnonzero((points[0] // CM == 6) & (points[1] // CM == 10))[0]
    points[2, low] = -900
    found = seeds_of(points)
    assert found[:, 2].min() > -20
    assert not ((found[:, 0] == 6) & (abs(found[:, 1] - 10) <= 1)).any()
