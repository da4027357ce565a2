"""The nearest points of pixel centres, compared with a plain search."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.gridding.nearest import NONE, nearest_points
from ptd.tin import Pixels

BLOCKS = {
    "plain": Pixels(100, 1, 3, 40, 20, 25),
    "odd": Pixels(1000, 7, 10, 30, 17, 11),
    "far": Pixels(250, 3, -20, 60, 21, 19, origin_x=-1234, origin_y=777),
    "one": Pixels(64, 1, 5, 5, 1, 1),
}


def obvious(
    xyz: np.ndarray, pixels: Pixels, k: int, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    squared = np.full((pixels.rows, pixels.columns, k), np.iinfo(np.int64).max)
    index = np.full(squared.shape, NONE)
    lattice = pixels.lattice
    for row in range(pixels.rows):
        for column in range(pixels.columns):
            cx = (lattice.x0 + column * lattice.step) // lattice.scale
            cy = (lattice.y0 - row * lattice.step) // lattice.scale
            d2 = (xyz[0] - cx) ** 2 + (xyz[1] - cy) ** 2
            order = np.lexsort((xyz[2], xyz[1], xyz[0], d2))
            order = order[d2[order] <= reach**2][:k]
            squared[row, column, : len(order)], index[row, column, : len(order)] = (
                d2[order],
                order,
            )
    return squared, index


def clouds(pixels: Pixels, n: int, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y, step, scale = pixels.lattice
    west, north = x // scale, y // scale
    size, reach = step // scale, 400
    xyz = np.stack(
        (
            rng.integers(west - reach, west + pixels.columns * size + reach, n),
            rng.integers(north - pixels.rows * size - reach, north + reach, n),
            rng.integers(0, 50, n),
        )
    )
    middle = np.abs(xyz[0] - xyz[0].mean()) < 0.3 * np.ptp(xyz[0])
    return {
        "even": xyz,
        "void": xyz[:, ~middle],
        "lattice": xyz // 30 * 30,
        "none": xyz[:, :0],
        "one": xyz[:, :1],
    }


@pytest.mark.parametrize("k", [1, 5])
@pytest.mark.parametrize("reach", [90.0, 700.0])
@pytest.mark.parametrize("block", BLOCKS)
def test_a_plain_search_finds_the_same(block: str, reach: float, k: int) -> None:
    pixels = BLOCKS[block]
    for name, xyz in clouds(pixels, 600, len(block)).items():
        x, y, z = np.ascontiguousarray(xyz.astype(np.int32))
        squared, points = nearest_points(x, y, z, pixels, k, reach)
        true_squared, true_points = obvious(xyz, pixels, k, reach)
        assert np.array_equal(squared, true_squared), name
        # Equal points are interchangeable.
        there = true_points != NONE
        assert np.array_equal(points != NONE, there)
        assert np.array_equal(xyz[:, points[there]], xyz[:, true_points[there]]), name


def test_order_has_no_effect() -> None:
    pixels = BLOCKS["odd"]
    xyz = clouds(pixels, 600, 5)["lattice"].astype(np.int32)
    shuffled = np.ascontiguousarray(xyz[:, np.random.default_rng(1).permutation(600)])
    one, two = (nearest_points(*cloud, pixels, 4, 500.0) for cloud in (xyz, shuffled))
    assert np.array_equal(one.squared, two.squared)
    there = one.points != NONE
    assert np.array_equal(xyz[:, one.points[there]], shuffled[:, two.points[there]])


@pytest.mark.parametrize(("k", "reach"), [(0, 5.0), (1, -1.0), (1, 2.0**26), (1, float("nan"))])
def test_invalid_searches_are_refused(k: int, reach: float) -> None:
    nothing = np.zeros(0, np.int32)
    with pytest.raises(ValueError, match="need k >= 1"):
        nearest_points(nothing, nothing, nothing, BLOCKS["plain"], k, reach)
