"""Ridge facets and points of hills by hand; seeds lie at the lowest points of cells of 20 m."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ptd.frame import OPEN, CellLattice, Scale, Window
from ptd.ground.certificates import UncertifiedRegion
from ptd.methods.ridge2016.ridges import AROUND, RidgeRule, Stacks, ridge_facet, ridge_points
from ptd.tin.mesh import Tin
from tests.ptd.tin.meshes import corners_of, triangle_at

M = 1000
SCALE = Scale()
RULE = RidgeRule.of(SCALE, side_m=30.0, angle_deg=25.0, radius_m=2.0)
LEFT, RIGHT = (-30, -10, 10), (50, 70, 90)
"""Columns of seeds on the slopes; the ridge at x = 30 lies in a gap of 40 m."""


def seeds(
    height: Callable[[float], float], columns: tuple[int, ...] = LEFT + RIGHT
) -> np.ndarray:
    """Rows of seeds every 20 m, shifted so that no four lie on a circle: int32 [3, n]."""
    points = [
        (x, y + (7 if x > 30 else 0), height(x)) for x in columns for y in range(-60, 80, 20)
    ]
    return np.rint(np.array(points).T * M).astype(np.int32)


def roof(slope: float) -> Callable[[float], float]:
    return lambda x: 100.0 - slope * abs(x - 30)


def at(
    tin: Tin, x: float, y: float, rule: RidgeRule = RULE, data: np.ndarray | None = None
) -> bool:
    """Whether the facet at a place lies on a ridge."""
    data = np.ones(tin.n_vertices, np.bool_) if data is None else data
    t = triangle_at(tin, round(x * M), round(y * M))
    return ridge_facet(
        tin.vertex_array, tin.triangle_array, t, data, rule, np.empty(AROUND, np.int32)
    )


def test_facets_across_the_ridge_of_a_roof_are_found_and_no_others() -> None:
    """With 45 degrees on both sides, facets across the ridge are level, and those beside fall by 45 > 25 degrees."""
    tin = Tin.build(*seeds(roof(1.0)))
    for y in (-20, -5, 3, 11, 18):
        assert at(tin, 30, y)
        assert not at(tin, 0, y)
        assert not at(tin, 60, y)


@pytest.mark.parametrize(("degrees", "found"), [(24.9, False), (25.1, True)])
def test_the_angle_decides(degrees: float, found: bool) -> None:
    tin = Tin.build(*seeds(roof(np.tan(np.radians(degrees)))))
    assert at(tin, 30, 3) == found


@pytest.mark.parametrize(("side_m", "found"), [(39.9, True), (40.0, False)])
def test_a_side_has_to_be_longer_in_x_or_in_y(side_m: float, found: bool) -> None:
    """(a): the facets of the gap are 40 m wide, and 42 m or more along their sides."""
    tin = Tin.build(*seeds(roof(1.0)))
    assert at(tin, 30, 3, RULE._replace(side=side_m * M)) == found
    turned = seeds(roof(1.0))[[1, 0, 2]]
    assert at(Tin.build(*turned), 3, 30, RULE._replace(side=side_m * M)) == found


def test_a_valley_is_not_a_ridge() -> None:
    """(ii): the centres beside lie above the judged facet's plane."""
    assert not at(Tin.build(*seeds(lambda x: abs(x - 30))), 30, 3)


@pytest.mark.parametrize(
    "height", [lambda x: 100.0 + min(x - 10, 0), lambda x: 2.0 * x], ids=["plateau", "slope"]
)
def test_the_edge_of_a_plateau_and_a_continuous_slope_are_not_ridges(
    height: Callable[[float], float],
) -> None:
    """(iii): all facets that fall away are connected and lie on one side."""
    tin = Tin.build(*seeds(height))
    assert not any(at(tin, 30, y) for y in (-20, -5, 3, 11, 18))


def test_facets_with_a_virtual_corner_neither_are_nor_make_ridges() -> None:
    tin = Tin.build(*seeds(roof(1.0)))
    x = tin.vertices[:, 0]
    assert not at(tin, 30, 3, data=x < 60 * M) or not at(tin, 30, 3, data=x > 0)
    assert not at(tin, 30, 3, data=(x > 0) & (x < 60 * M))
    assert not at(tin, 30, 3, data=x != 10 * M)


def candidates(centre: tuple[float, float]) -> np.ndarray:
    """Points around the centre of gravity, metres: the third is the lowest within 2 m, the fourth just beyond."""
    offsets = [
        (0.3, 0.1, 131.0),
        (-1.5, 0.2, 130.5),
        (0.0, 1.9, 130.2),
        (0.0, -2.1, 120.0),
        (1.0, 1.0, 130.2),
    ]
    return np.array([(centre[0] + dx, centre[1] + dy, z) for dx, dy, z in offsets])


def place(
    known: Window, data: np.ndarray | None = None
) -> tuple[list[tuple[int, ...]], np.ndarray, UncertifiedRegion]:
    """Ridge points of the roof near the centre of the facet at (30, 3), this centre, and the uncertified region."""
    tin = Tin.build(*seeds(roof(1.0)))
    facet = tin.vertices[list(corners_of(tin, triangle_at(tin, 30 * M, 3 * M)))].astype(
        np.int64
    )
    centre = facet[:, :2].sum(axis=0) / 3 / M
    points = np.rint(candidates((centre[0], centre[1])) * M).astype(np.int32)
    stacks = Stacks(*np.ascontiguousarray(points.T), CellLattice.of(1.0, SCALE))
    region = UncertifiedRegion(known, known, (-80 * M, -100 * M, 140 * M, 120 * M), SCALE)
    data = np.ones(tin.n_vertices, np.bool_) if data is None else data
    found = ridge_points(tin, data, stacks, RULE, region)
    picked = [(int(stacks.x[i]), int(stacks.y[i]), int(stacks.z[i])) for i in found]
    return picked, points, region


def test_the_ridge_point_is_the_lowest_within_2_m_of_the_centre() -> None:
    """Of the two points at 130.2 m the western one counts."""
    picked, points, _ = place(Window.everything())
    assert picked == [tuple(points[2].tolist())]


def test_without_ridge_facets_no_points() -> None:
    picked, _, region = place(Window.everything(), np.zeros(42, np.bool_))
    assert picked == []
    assert not region.mask.any()


def test_candidates_of_an_uncertified_facet_are_uncertified() -> None:
    """The window ends close to the roof: places near its border are uncertified, the middle is certain."""
    picked, points, region = place(Window(-35 * M, -65 * M, 95 * M, 68 * M))
    assert picked == [tuple(points[2].tolist())]
    x, y = (
        np.array([30 * M, 30 * M, 30 * M], np.int32),
        np.array([3 * M, -55 * M, 62 * M], np.int32),
    )
    assert region.covers(x, y).tolist() == [False, True, True]


def test_the_pick_near_the_side_of_the_window_is_uncertified() -> None:
    """All facets are certain, but a lower point may lie within 2 m beyond the side."""
    _, points, _ = place(Window.everything())
    x, y = points[2:3, 0].copy(), points[2:3, 1].copy()
    east = int(points[0, 0]) + M
    for side, expected in ((OPEN - 1, False), (east, True)):
        _, _, region = place(Window(-OPEN, -OPEN, side, OPEN))
        assert region.covers(x, y).tolist() == [expected]
