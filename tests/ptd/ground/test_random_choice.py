"""Picks see nothing but the points."""

from __future__ import annotations

import numpy as np

from ptd.frame import CellLattice, Scale
from ptd.ground.distance_angle import point_hashes, random_per_cell

SCALE = Scale(origin=(-12_345_678, 98_765_432))
CELLS = CellLattice.of(4.0, SCALE)


def cloud(n: int = 20_000) -> np.ndarray:
    return np.random.default_rng(4).integers(0, 80_000, (3, n)).astype(np.int32)


def cells_of(points: np.ndarray) -> np.ndarray:
    return np.array([[CELLS.column(int(x)), CELLS.row(int(y))] for x, y in points[:2].T])


def test_one_point_of_each_occupied_cell() -> None:
    points = cloud()
    picked = random_per_cell(*points, CELLS, 0)
    assert np.array_equal(
        np.unique(cells_of(points[:, picked]), axis=0), np.unique(cells_of(points), axis=0)
    )
    assert len(np.unique(cells_of(points[:, picked]), axis=0)) == picked.size


def test_other_salts_give_other_picks_and_all_points_have_a_chance() -> None:
    points = cloud()
    picks = [set(random_per_cell(*points, CELLS, salt).tolist()) for salt in range(4)]
    assert all(len(a & b) < 0.1 * len(a) for a in picks for b in picks if a is not b)
    first, last = np.arange(10, dtype=np.int32), np.zeros(10, np.int32)
    chosen = [int(random_per_cell(first, last, last, CELLS, salt)[0]) for salt in range(400)]
    assert min(np.bincount(chosen, minlength=10)) > 15  # 40 expected


def test_points_of_one_place_have_different_lots() -> None:
    z = np.arange(100_000, dtype=np.int32)
    same = np.full(z.size, 5, np.int32)
    assert np.unique(point_hashes(same, same, z, CELLS, 0)).size == z.size


def test_no_points() -> None:
    none = np.zeros(0, np.int32)
    assert random_per_cell(none, none, none, CELLS, 0).size == 0
