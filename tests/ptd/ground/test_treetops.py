"""Crowns on slopes, on surfaces drawn by formula, and the planes beside a slow twin."""

from __future__ import annotations

import numpy as np

from ptd.cells import Xyz
from ptd.frame import CellLattice, Scale
from ptd.ground import treetops
from ptd.ground.morphology import EMPTY
from ptd.ground.treetops import on_treetops

SCALE = Scale(origin=(123_457, -98_765))
CELLS = CellLattice.of(1.0, SCALE)


def slope(side: int, rise: float, seed: int = 1) -> Xyz:
    """One point in the middle of each cell of 1 m of a slope to the east, with noise of 5 cm."""
    x, y = (c.ravel() + 0.5 for c in np.meshgrid(*2 * [np.arange(side)]))
    z = rise * x + np.random.default_rng(seed).normal(0, 0.05, x.size)
    local = Xyz(*(np.round(1000 * c).astype(np.int32) for c in (x, y, z)))
    return Xyz(local.x - 457, local.y + 765, local.z)


def wood(rise: float, seed: int = 1) -> tuple[Xyz, np.ndarray, np.ndarray]:
    """A slope of 80 m on which one cell in eight is ground, and a crown of 8 m height in the middle."""
    points = slope(80, rise, seed)
    x, y = points.x / 1000, points.y / 1000
    crown = (abs(x - 40) < 3) & (abs(y - 40) < 3)
    ground = (np.random.default_rng(seed).random(x.size) < 0.125) & ~crown
    ground &= (abs(x - 40) > 5) | (abs(y - 40) > 5)
    z = points.z + 8000 * crown - (rise * 500 * (x - 40) * crown).astype(np.int32)
    return Xyz(points.x, points.y, z.astype(np.int32)), ground | crown, crown


def found(points: Xyz, ground: np.ndarray) -> np.ndarray:
    return on_treetops(points, ground, np.zeros(ground.size, bool), CELLS, 1.0, SCALE)


def test_a_crown_in_a_wood_on_a_slope_is_found() -> None:
    points, ground, crown = wood(0.8)
    assert np.array_equal(found(points, ground), crown)


def test_a_rock_amid_ground_stays() -> None:
    points, ground, _ = wood(0.8)
    assert not found(points, np.ones_like(ground)).any()


def test_level_ground_is_left_to_the_search_for_roofs() -> None:
    points, ground, _ = wood(0.1)
    assert not found(points, ground).any()


def test_points_without_ground_are_never_found() -> None:
    points, ground, _ = wood(0.8)
    assert not found(points, np.zeros_like(ground)).any()


def test_planes_are_those_of_least_squares() -> None:
    random = np.random.default_rng(3)
    heights = random.integers(-5000, 5000, (23, 31)).astype(np.int32)
    heights += (400 * np.arange(31) - 250 * np.arange(23)[:, None]).astype(np.int32)
    heights[random.random(heights.shape) < 0.6] = EMPTY
    planes = treetops._planes(heights, 4)
    rows, columns = np.nonzero(heights != EMPTY)
    fitted = 0
    for row, column in zip(rows, columns, strict=True):
        near = (abs(rows - row) <= 4) & (abs(columns - column) <= 4)
        if near.sum() < treetops.TREND_CELLS:
            continue
        fitted += 1
        a = np.stack([columns[near] - column, rows[near] - row, np.ones(near.sum())], axis=1)
        z = heights[rows[near], columns[near]]
        east, north, height = np.linalg.lstsq(a, z.astype(float), rcond=None)[0]
        got = [p[row, column] for p in (planes.east, planes.north, planes.height)]
        assert np.allclose(got, [east, north, height], atol=1e-6)
    assert fitted > 100
    assert np.isnan(planes.height[heights == EMPTY]).all()


def test_nothing_beyond_the_reach_has_a_part() -> None:
    points, ground, crown = wood(0.8)
    reach = treetops.reach_m() + 4
    side = 2 * int(reach) + 20
    big = slope(side, 0.8, seed=7)
    shift = (side - 80) // 2
    far_x, far_y = big.x / 1000 - shift, big.y / 1000 - shift
    outside = (abs(far_x - 40) > 40) | (abs(far_y - 40) > 40)

    def joined(rough: int) -> tuple[Xyz, np.ndarray]:
        random = np.random.default_rng(9)
        z = big.z - int(800 * shift)
        beyond = (abs(far_x - 40) > reach + 3) | (abs(far_y - 40) > reach + 3)
        z = z + rough * beyond * random.integers(-20_000, 20_000, z.size)
        more = outside & (random.random(z.size) < 0.3)
        parts = [
            np.concatenate([a, b[more] - 1000 * s])
            for a, b, s in (
                (points.x, big.x, shift),
                (points.y, big.y, shift),
                (points.z, z, 0),
            )
        ]
        order = np.lexsort(
            CELLS.cell_indices(parts[0].astype(np.int32), parts[1].astype(np.int32))
        )
        is_ground = np.append(ground, np.ones(int(more.sum()), bool))
        return Xyz(*(p[order].astype(np.int32) for p in parts)), is_ground[order]

    results = []
    for rough in (0, 1):
        cloud, is_ground = joined(rough)
        middle = (abs(cloud.x / 1000 - 40) < 8) & (abs(cloud.y / 1000 - 40) < 8)
        results.append(found(cloud, is_ground)[middle])
    assert results[0].sum() == crown.sum()
    assert np.array_equal(*results)
