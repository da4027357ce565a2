"""Inverse distances compared with a plain sum; ground points beside objects."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ptd.gridding.above_ground import near_objects
from ptd.gridding.nearest import NEIGHBOURS, inverse_distance
from ptd.tin import Pixels

PIXELS = Pixels(100, 1, -2, 20, 22, 18)


def cloud(n: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y, z = rng.integers((0, 0, 0), (1900, 1900, 500), (n, 3)).astype(np.int32).T
    x[:5], y[:5] = 150 + 100 * np.arange(5), 250  # on pixel centres
    return tuple(map(np.ascontiguousarray, (x, y, z)))  # type: ignore[return-value]


def test_heights_equal_the_plain_sum() -> None:
    for n in (6, 300):
        x, y, z = cloud(n, n)
        heights, distance = inverse_distance(x, y, z, PIXELS, 600.0)
        for row in range(PIXELS.rows):
            for column in range(PIXELS.columns):
                cx, cy = 100 * (PIXELS.left + column) + 50, 100 * (PIXELS.top - row) + 50
                d2 = (x.astype(float) - cx) ** 2 + (y - cy) ** 2
                near = np.lexsort((z, y, x, d2))[:NEIGHBOURS]
                near = near[d2[near] <= 600**2]
                if len(near) == 0:
                    assert np.isnan(heights[row, column])
                    continue
                with np.errstate(divide="ignore"):
                    weight = 1 / d2[near]
                truth = (
                    z[near[0]] if d2[near[0]] == 0 else (weight * z[near]).sum() / weight.sum()
                )
                assert abs(heights[row, column] - truth) < 1e-6
                reach = np.sqrt(d2[near[-1]]) if len(near) == NEIGHBOURS else 600
                assert distance[row, column] == reach


def test_order_has_no_effect() -> None:
    x, y, z = cloud(300, 2)
    order = np.random.default_rng(0).permutation(300)
    one, _ = inverse_distance(x, y, z, PIXELS, 600.0)
    two, _ = inverse_distance(
        *(np.ascontiguousarray(axis[order]) for axis in (x, y, z)), PIXELS, 600.0
    )
    assert one.tobytes() == two.tobytes()


def test_no_points_no_heights() -> None:
    nothing = np.zeros(0, np.int32)
    heights, _ = inverse_distance(nothing, nothing, nothing, PIXELS, 600.0)
    assert np.isnan(heights).all()


def test_ground_beside_objects_by_definition() -> None:
    rng = np.random.default_rng(7)
    ground, objects = (
        rng.integers((-900, -900, 0), (900, 900, 400), (n, 3)).T.astype(np.int32)
        for n in (500, 40)
    )
    for reach in (Fraction(90), Fraction(1000, 7), Fraction("0.3333333333333333") * 1000):
        found = near_objects(ground, objects, reach, 150, (-77, 12_345))
        d2 = ((ground[:2, :, None].astype(int) - objects[:2, None]) ** 2).sum(axis=0)
        truth = ((d2 <= reach**2) & (objects[2, None] - ground[2, :, None] >= 150)).any(axis=1)
        assert np.array_equal(found, truth)
        assert 0 < found.sum() < 500
    assert not near_objects(ground, objects[:, :0], Fraction(90), 1, (0, 0)).any()
