"""The last pass by hand, and low noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ptd.cells import Xyz
from ptd.frame import CellGrid, CellLattice, Scale
from ptd.ground.certificates import CheckedMesh
from ptd.ground.criteria import FacetLimits
from ptd.ground.labelling import Bands, LabelRule, _by_height, label_points
from ptd.ground.outliers import LowNoise
from ptd.places import Field, everywhere
from ptd.tin.mesh import Locator, Tin
from tests.ptd.tin.meshes import outside, triangle_at

LIMITS = FacetLimits.of(Scale(), distance_m=1.4, angle_deg=6.0, terrain_deg=88.0)
FLOOR = 300.0


def flat() -> Tin:
    """Level ground of 100 m, a vertex each 10 m, one of them a metre up."""
    x, y = np.meshgrid(np.arange(0, 100_001, 10_000), np.arange(0, 100_001, 10_000))
    z = np.where((x == 50_000) & (y == 50_000), 1000, 0)
    return Tin.build(x.ravel(), y.ravel(), z.ravel())


def label(
    tin: Tin, points: list[tuple[int, int, int]], all_uncertified: bool = False, **options: Any
) -> tuple[list[int], list[bool]]:
    xyz = Xyz(*np.ascontiguousarray(np.array(points, np.int32).reshape(-1, 3).T))
    uncertified = np.full(tin.n_triangles, all_uncertified, np.uint8)
    rule = LabelRule(LIMITS, 0.0 if options.get("vertices_only") else FLOOR, **options)
    labels, marked = label_points(tin, Locator.of(tin), xyz, uncertified, rule)
    return labels.tolist(), marked.tolist()


@pytest.mark.parametrize(
    ("point", "ground"),
    [
        ((15_000, 12_000, 200), True),  # below the floor
        ((15_000, 12_000, -300), True),
        # above it: 5.5 degrees to the nearest corner, 5.4 m away
        ((15_000, 12_000, 520), True),
        ((15_000, 12_000, 580), False),  # 6.1 degrees
        ((10_100, 10_100, 300), True),  # near a vertex at a steep angle: the floor
        ((10_100, 10_100, 301), False),
        ((10_000, 10_000, 300), True),  # above a vertex
        ((10_000, 10_000, -300), True),
        ((10_000, 10_000, 301), False),
        ((10_000, 10_000, -301), False),
        ((50_000, 50_000, 1000), True),
        ((50_000, 50_000, 0), False),
        ((-5, 50_000, 0), False),  # outside the hull
        ((0, 50_000, 0), True),  # on it
    ],
)
def test_by_hand(point: tuple[int, int, int], ground: bool) -> None:
    assert label(flat(), [point]) == ([2 if ground else 1], [False])


def test_without_a_last_pass_only_vertices_are_ground() -> None:
    points = [
        (10_000, 10_000, 0),
        (10_000, 10_000, 1),
        (15_000, 12_000, 0),
        (50_000, 50_000, 1000),
    ]
    assert label(flat(), points, vertices_only=True) == ([2, 1, 1, 2], [False] * 4)


def test_what_rests_on_an_uncertified_triangle_is_uncertified() -> None:
    points = [
        (10_000, 10_000, 0),
        (15_000, 12_000, 0),
        (15_000, 12_000, 9_000),
        (-5, 50_000, 0),
    ]
    assert label(flat(), points, all_uncertified=True) == ([2, 2, 1, 1], [True] * 4)


def test_on_an_edge_the_triangle_behind_it_counts() -> None:
    tin = flat()
    xyz = Xyz(*(np.array([v], np.int32) for v in (15_000, 20_000, 0)))
    home = triangle_at(tin, 15_000, 20_000)
    beside = {triangle_at(tin, 15_000, 20_001), triangle_at(tin, 15_000, 19_999)} - {home}
    for t in range(tin.n_triangles):
        uncertified = (np.arange(tin.n_triangles) == t).astype(np.uint8)
        _, marked = label_points(
            tin, Locator.of(tin), xyz, uncertified, LabelRule(LIMITS, FLOOR)
        )
        assert marked[0] == (t == home or t in beside)


def test_no_points_no_labels() -> None:
    assert label(flat(), []) == ([], [])


def test_low_noise_reaches_up_to_the_highest_outlier_of_its_cell() -> None:
    def columns(*points: tuple[int, int, int]) -> list[np.ndarray]:
        return list(np.array(points, np.int32).reshape(-1, 3).T)

    cells = CellLattice.of(1.0, Scale(origin=(-250, 7000)))
    low = LowNoise(*columns((300, 0, -100), (-800, 5000, 7), (1249, 999, -80)), cells)
    within = columns((250, 0, -80), (700, 500, -900), (-1750, 5999, 7))
    above_or_beside = columns(
        (1249, 999, -79), (-751, 5000, 8), (249, 0, -900), (300, -1, -900), (1250, 0, -900)
    )
    assert low.holds(*within).all()
    some = np.arange(within[0].size) % 2 == 0
    assert (low.holds(*within, among=some) == some).all()
    assert not low.holds(*above_or_beside).any()
    assert not LowNoise(*columns(), cells).holds(*within).any()


@pytest.mark.parametrize(
    ("height", "ground"), [(300, True), (301, False), (-300, True), (-301, False)]
)
def test_heights_only_neither_angle_nor_iteration_distance_counts(
    height: int, ground: bool
) -> None:
    """On a slope of 3 in 4 a height of 300 is 240 from the facet; 400 would be within the angle far from corners."""
    slope = Tin.build([0, 40_000, 0, 40_000], [0, 0, 40_000, 40_000], [0, 30_000, 0, 30_000])
    assert label(slope, [(20_000, 13_000, 15_000 + height)], heights_only=True)[0] == [
        2 if ground else 1
    ]
    assert label(slope, [(20_000, 13_000, 15_400)])[0] == [2]


def test_what_is_allowed_in_height_grows_with_the_slope() -> None:
    """On a slope of 3 in 4 the floor of 300 and 400 per slope make 600."""
    slope = Tin.build([0, 40_000, 0, 40_000], [0, 0, 40_000, 40_000], [0, 30_000, 0, 30_000])
    heights = [15_599, 15_601, 14_401, 14_399]
    points = [(20_000, 13_000, z) for z in heights]
    assert label(slope, points, heights_only=True, per_slope=400.0)[0] == [2, 1, 2, 1]
    on_a_vertex = [(0, 0, 300), (0, 0, 301)]  # it has no slope
    assert label(slope, on_a_vertex, heights_only=True, per_slope=400.0)[0] == [2, 1]


@pytest.mark.parametrize("seed", range(4))
def test_heights_are_judged_as_point_by_point(seed: int) -> None:
    """On a small lattice, where points lie on vertices, on edges, on the hull and beyond it."""
    random = np.random.default_rng(seed)
    tin = Tin.build(*random.integers(0, 12, (3, 60)))
    points = Xyz(*random.integers(-2, 14, (3, 2000)).astype(np.int32))
    uncertified = (random.random(tin.n_triangles) < 0.3).astype(np.uint8)
    uncertified[[outside(tin, t) for t in range(tin.n_triangles)]] = 1  # as it always is
    rule = LabelRule(LIMITS, 1.0, heights_only=True)
    floors = Field(
        random.uniform(0.5, 2.0, (4, 4)), CellGrid(7, 1, 0, 0, -1, -1), False, 0.5, 2.0
    )
    bands = Bands(floors, everywhere(0.5))
    labels, marked = label_points(tin, Locator.of(tin), points, uncertified, rule, bands)
    mesh = CheckedMesh(*tin.mesh, uncertified)

    for label, mark, x, y, z in zip(labels, marked, *points, strict=True):
        t = triangle_at(tin, int(x), int(y))
        on_a_vertex = (tin.vertices[:, :2] == (x, y)).all(axis=1).any()
        near, _, is_uncertified = _by_height(*mesh, t, (int(x), int(y), int(z)), rule, bands)
        assert label == (2 if near else 1)
        # on a vertex any of its triangles may have a say
        assert on_a_vertex or mark == is_uncertified
