"""Noise among seeds, in TINs small enough to check: tips of over-long facets and small raised clusters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.methods.chen2023.seed_clusters import ClusterLimits, _flood, _sides, noisy_seeds
from ptd.tin.mesh import Tin
from tests.ptd.tin.meshes import corners_of, real_triangles

OFF = ClusterLimits(long_side=0.0, narrow_cos=1.0, small=0, prominence=0.0, z_ratio=1.0)
CLUSTERS = ClusterLimits(0.0, math.cos(math.radians(15)), 10, 1000.0, 1.0)
Position = tuple[int, int]


def noise_of(
    points: list[tuple[int, int, int]],
    limits: ClusterLimits,
    virtual: set[Position] | None = None,
) -> set[Position]:
    """Positions of the noise."""
    x, y, z = np.ascontiguousarray(np.array(points, np.int32).T)
    tin = Tin.build(x, y, z)
    real = np.array([(int(a), int(b)) not in (virtual or set()) for a, b, _ in tin.vertices])
    noise, uncertified = noisy_seeds(tin, real, limits, np.zeros(tin.n_triangles, np.uint8))
    assert not uncertified.any()
    return {(int(a), int(b)) for a, b, _ in tin.vertices[noise]}


def test_the_highest_corner_of_an_over_long_facet_is_noise() -> None:
    """The side in space from (0, 0, 0) to (30, 40, 120) is 130 long, and 50 in plan."""
    points = [(0, 0, 0), (30, 40, 120), (60, 0, 5)]
    assert noise_of(points, OFF._replace(long_side=129.9)) == {(30, 40)}
    assert noise_of(points, OFF._replace(long_side=130.0)) == set()
    assert noise_of(points, OFF) == set()


def test_heights_count_in_horizontal_units() -> None:
    points = [(0, 0, 0), (30, 40, 60), (60, 0, 2)]
    assert noise_of(points, OFF._replace(long_side=129.9, z_ratio=2.0)) == {(30, 40)}
    assert noise_of(points, OFF._replace(long_side=129.9)) == set()


def test_the_smallest_position_of_equally_high_corners_counts() -> None:
    assert noise_of([(0, 0, 7), (0, 90, 7), (50, 0, 7)], OFF._replace(long_side=60.0)) == {
        (0, 0)
    }


def test_each_long_facet_is_judged_in_the_same_tin() -> None:
    """Each of two spikes is the highest corner of its facet, and no facet is judged after a removal."""
    points = [(x * 10, y * 10, 0) for x in range(7) for y in range(7)]
    points = [(x, y, 500 if (x, y) in {(20, 20), (40, 40)} else z) for x, y, z in points]
    assert noise_of(points, OFF._replace(long_side=100.0)) == {(20, 20), (40, 40)}


def test_a_virtual_corner_is_not_noise() -> None:
    points = [(0, 0, 0), (30, 40, 120), (60, 0, 5)]
    assert noise_of(points, OFF._replace(long_side=100.0), {(30, 40)}) == set()


def block(height: int, side: int = 3, step: int = 1000) -> list[tuple[int, int, int]]:
    """A field of 15 x 15 points a metre apart with a block of side x side points; uneven, like real clouds."""
    rng = np.random.default_rng(3)
    found = []
    for column, row in np.ndindex(15, 15):
        up = height if 6 <= column < 6 + side and 6 <= row < 6 + side else 0
        dx, dy = rng.integers(-30, 30, 2)
        found.append((step * column + int(dx), step * row + int(dy), up))
    return found


def up(points: list[tuple[int, int, int]]) -> set[Position]:
    return {(x, y) for x, y, z in points if z}


def test_narrow_facets_split_off_a_small_cluster_that_stands_out() -> None:
    """Facets up to the cluster (6 m high, points 1 m apart) have angles of 10 degrees, or 13 over its corners."""
    points = block(6000)
    assert noise_of(points, CLUSTERS) == up(points)


def test_facets_that_are_not_narrow_join() -> None:
    """Facets up to 2.5 m have angles of 21 and 31 degrees; those of the field have 45."""
    points = block(2500)
    assert noise_of(points, CLUSTERS) == set()
    assert noise_of(points, CLUSTERS._replace(narrow_cos=math.cos(math.radians(35)))) >= up(
        points
    )


def test_a_cluster_of_more_seeds_stays() -> None:
    points = block(6000, side=4)
    assert noise_of(points, CLUSTERS) == set()
    assert noise_of(points, CLUSTERS._replace(small=16)) == up(points)
    assert noise_of(points, CLUSTERS._replace(small=15)) == set()


def test_a_cluster_that_lies_lower_or_hardly_higher_stays() -> None:
    assert noise_of(block(-6000), CLUSTERS) == set()
    assert noise_of(block(6000), CLUSTERS._replace(prominence=5999.0)) == up(block(6000))
    assert noise_of(block(6000), CLUSTERS._replace(prominence=6000.0)) == set()


def test_virtual_seeds_neither_join_nor_are_compared_with() -> None:
    """A block surrounded by virtual seeds has no neighbours to compare with."""
    points = block(6000)
    assert noise_of(points, CLUSTERS, {(x, y) for x, y, z in points if not z}) == set()
    assert noise_of(points, CLUSTERS, up(points)) == set()


def test_a_seed_with_narrow_facets_alone_is_a_cluster_of_one() -> None:
    points = block(9000, side=1)
    assert noise_of(points, CLUSTERS) == up(points)
    assert noise_of(points, CLUSTERS._replace(small=0)) == set()


def test_fewer_than_three_seeds_have_no_facets() -> None:
    assert noise_of([(0, 0, 0), (100, 0, 9000)], CLUSTERS) == set()


def test_sides_are_sorted_and_do_not_depend_on_the_order_of_corners() -> None:
    vertices = np.array([[0, 0, 0, 0], [3, 0, 4, 0], [0, 12, 0, 0]], np.int32)
    for corners in ([0, 1, 2], [2, 0, 1], [1, 0, 2]):
        assert _sides(vertices, np.array(corners, np.int32), 1.0) == (
            25.0,
            144.0,
            9.0 + 144.0 + 16.0,
        )


def test_joined_vertices_have_one_number() -> None:
    facets = np.array([[0, 1, 2], [2, 3, 4], [5, 6, 7], [4, 5, 8]], np.int32)
    joins = np.array([True, True, True, False])
    assert _flood(facets, joins, 9).tolist() == [0, 0, 0, 0, 0, 5, 5, 5, 8]


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_uncertified_seeds_cover_all_effects_of_uncertified_facets(seed: int) -> None:
    """In a cloud cut at a line, certain results equal those of the whole if the changed facets are uncertified."""
    rng = np.random.default_rng(seed)
    n = 250
    xy = rng.choice(60 * 60, n, replace=False)
    x, y = (100 * (xy % 60)).astype(np.int32), (100 * (xy // 60)).astype(np.int32)
    z = np.where(rng.random(n) < 0.2, rng.integers(0, 3000, n), rng.integers(0, 100, n)).astype(
        np.int32
    )
    limits = ClusterLimits(1500.0, math.cos(math.radians(25)), 6, 150.0, 1.0)
    whole = Tin.build(x, y, z)
    near = x < 4500
    window = Tin.build(x[near], y[near], z[near])
    facets = {frozenset(map(tuple, f)) for f in whole.vertices[real_triangles(whole)].tolist()}
    uncertified = np.zeros(window.n_triangles, np.uint8)
    for t in range(window.n_triangles):
        corners = list(corners_of(window, t))
        uncertified[t] = (
            -1 in corners
            or frozenset(map(tuple, window.vertices[corners].tolist())) not in facets
        )
    real = np.ones(window.n_vertices, bool)
    noise, uncertified_seeds = noisy_seeds(window, real, limits, uncertified)
    truth, _ = noisy_seeds(
        whole, np.ones(n, bool), limits, np.zeros(whole.n_triangles, np.uint8)
    )
    true_noise = set(map(tuple, whole.vertices[truth, :2].tolist()))
    for (a, b, _z), found, is_uncertified in zip(
        window.vertices.tolist(), noise, uncertified_seeds, strict=True
    ):
        assert is_uncertified or found == ((a, b) in true_noise)


@pytest.mark.parametrize("uncertified", [0, 1])
def test_with_all_facets_uncertified_nothing_is_certain(uncertified: int) -> None:
    x, y, z = np.ascontiguousarray(np.array(block(6000), np.int32).T)
    tin = Tin.build(x, y, z)
    triangles = np.full(tin.n_triangles, uncertified, np.uint8)
    _, uncertified_seeds = noisy_seeds(tin, np.ones(tin.n_vertices, bool), CLUSTERS, triangles)
    assert uncertified_seeds.all() == bool(uncertified)
    assert uncertified_seeds.any() == bool(uncertified)
