"""Axelsson's test by hand, and its measures against exact arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ptd.frame import Scale
from ptd.ground.certificates import CheckedMesh
from ptd.ground.criteria import FacetLimits, accepts, facet_measures, mirror_facet, within
from ptd.tin.mesh import Tin
from tests.ptd.tin.meshes import corners_of, outside, triangle_at

Point = tuple[int, int, int]


def tin_of(*points: Point) -> Tin:
    x, y, z = np.array(points, np.int64).T
    return Tin.build(x, y, z)


def in_counts(*values: int) -> tuple[np.int32, ...]:
    """Coordinates as the filter gives them to kernels, which compile them for no other integers."""
    return tuple(np.int32(value) for value in values)


def measure(
    tin: Tin, x: int, y: int, z: int, ratio: float = 1.0
) -> tuple[float, float, float, float]:
    return facet_measures(
        tin.vertex_array, tin.triangle_array, triangle_at(tin, x, y), *in_counts(x, y, z), ratio
    )


def limits(**values: float) -> FacetLimits:
    return FacetLimits.of(
        Scale(), **{"distance_m": 1.4, "angle_deg": 25.0, "terrain_deg": 88.0, **values}
    )


def judge(
    tin: Tin,
    x: int,
    y: int,
    z: int,
    uncertified_facets: set[int] = frozenset(),
    **values: float,
) -> tuple[bool, bool, bool]:  # type: ignore[assignment]
    """Passed, elsewhere, is uncertified."""
    uncertified = np.array([t in uncertified_facets for t in range(tin.n_triangles)], np.uint8)
    t = triangle_at(tin, x, y)
    return accepts(
        *CheckedMesh(*tin.mesh, uncertified), t, in_counts(x, y, z), limits(**values)
    )


# Equilateral, 10 m in plan to within a millimetre; the middle is 5774 mm from each corner.
EQUILATERAL = ((0, 0, 0), (10_000, 0, 0), (5_000, 8_660, 0))
MIDDLE = (5_000, 2_887)


def test_a_metre_above_the_middle_of_an_equilateral_facet() -> None:
    distance, nearest, cos2, edge = measure(tin_of(*EQUILATERAL), *MIDDLE, 1000)
    assert distance == 1000.0
    assert nearest == pytest.approx(math.hypot(5773.5, 1000), abs=0.6)
    assert cos2 == 1.0
    assert edge == 10_000.0
    assert math.degrees(math.asin(distance / nearest)) == pytest.approx(9.83, abs=0.01)


@pytest.mark.parametrize(("angle", "passed"), [(9.8, False), (9.9, True)])
@pytest.mark.parametrize("side", [1, -1])
def test_the_angle_decides(angle: float, passed: bool, side: int) -> None:
    assert judge(tin_of(*EQUILATERAL), *MIDDLE, side * 1000, angle_deg=angle) == (
        passed,
        False,
        False,
    )


@pytest.mark.parametrize(("distance", "passed"), [(0.999, False), (1.0, True)])
def test_the_distance_decides(distance: float, passed: bool) -> None:
    assert judge(tin_of(*EQUILATERAL), *MIDDLE, 1000, distance_m=distance)[0] == passed


def test_the_distance_is_that_to_the_plane() -> None:
    """On a slope of 45 degrees a metre up is 0.71 m away."""
    tin = tin_of((0, 0, 0), (10_000, 0, 10_000), (0, 10_000, 0))
    distance, _, cos2, _ = measure(tin, 2000, 2000, 3000)
    assert distance == pytest.approx(1000 / math.sqrt(2), rel=1e-12)
    assert cos2 == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("reduce", "passed"), [(9.9, True), (10.0, True), (11.0, False)])
def test_short_edges_reduce_the_angle(reduce: float, passed: bool) -> None:
    """10 degrees suffice on an edge of 10 m; in proportion to 11 m they are 9.1."""
    assert (
        judge(tin_of(*EQUILATERAL), *MIDDLE, 1000, angle_deg=10.0, reduce_m=reduce)[0] == passed
    )


@pytest.mark.parametrize(("stop", "passed"), [(10.0, True), (10.001, False)])
def test_short_edges_stop(stop: float, passed: bool) -> None:
    assert judge(tin_of(*EQUILATERAL), *MIDDLE, 0, stop_m=stop)[0] == passed


@pytest.mark.parametrize(("z", "passed"), [(0, True), (1, False), (-1, False)])
def test_on_a_vertex_only_the_vertex_passes(z: int, passed: bool) -> None:
    """Whichever of its triangles was found."""
    tin = tin_of((0, 0, 0), (9000, 0, 2000), (0, 9000, 3000), (-9000, 0, 100), (0, -9000, 0))
    found = set()
    for t in range(tin.n_triangles):
        if 0 in (
            tin.vertices[v, :2].any() for v in corners_of(tin, t) if v >= 0
        ) and not outside(tin, t):
            mesh = CheckedMesh(*tin.mesh, np.zeros(tin.n_triangles, np.uint8))
            found.add(accepts(*mesh, t, in_counts(0, 0, z), limits()))
    assert found == {(passed, False, False)}


def test_heights_may_have_another_unit() -> None:
    """The same facet with heights in centimetres."""
    fine = tin_of((0, 0, 0), (10_000, 0, 2_000), (5_000, 8_660, 500))
    coarse = tin_of((0, 0, 0), (10_000, 0, 200), (5_000, 8_660, 50))
    assert measure(coarse, *MIDDLE, 120, 10.0) == measure(fine, *MIDDLE, 1200)


def test_limits_in_feet_are_those_in_metres() -> None:
    feet = Scale(Fraction(3048, 10**7), Fraction(3048, 10**7))
    got = FacetLimits.of(
        feet, distance_m=0.3048, angle_deg=30.0, terrain_deg=60.0, reduce_m=3.048, stop_m=1.524
    )
    assert got.distance == pytest.approx(1000)
    assert got.reduce_edge == pytest.approx(10_000)
    assert got.stop_edge == pytest.approx(5_000)
    assert got.angle == pytest.approx(math.pi / 6)
    assert got.steep_cos2 == pytest.approx(0.25)
    assert got.z_ratio == 1.0


# A terrace: a step of 5 m between two flats; the facets of the step are steep.
PROFILE = ((0, 0), (5_000, 0), (6_000, 5_000), (12_000, 5_000))
TERRACE = tuple((x, y, z) for x, z in PROFILE for y in (0, 12_000))


def test_on_a_steep_facet_a_point_is_tested_where_its_mirror_image_lies() -> None:
    tin = tin_of(*TERRACE)
    x, y = 5_500, 2_000
    arrays = tin.vertex_array, tin.triangle_array
    assert measure(tin, x, y, 0)[2] < math.cos(math.radians(60)) ** 2
    other, mx, my = mirror_facet(*arrays, triangle_at(tin, x, y), *in_counts(x, y))
    top = next(
        v for v in ((6_000, 0), (6_000, 12_000)) if (2 * v[0] - x, 2 * v[1] - y) == (mx, my)
    )
    assert top in ((6_000, 0), (6_000, 12_000))
    assert mx == 6_500
    assert other == triangle_at(tin, mx, my)


def test_the_mirror_image_keeps_the_height() -> None:
    """At the upper edge a point as high as the terrace passes; unmirrored it is far from the steep facet."""
    lower = [(x, y - 12_000 * k, z) for x, y, z in TERRACE for k in range(3)]
    tin = tin_of(*dict.fromkeys(lower))
    x, y = 5_700, -2_000
    assert judge(tin, x, y, 5_000, terrain_deg=60.0) == (True, True, False)
    assert judge(tin, x, y, 5_000, terrain_deg=89.0)[1] is False
    assert judge(tin, x, y, 0, terrain_deg=60.0) == (False, True, False)


def test_of_equally_high_corners_the_lexicographically_smallest_mirrors() -> None:
    for points in ((0, 0, 9), (4, 0, 9), (0, 4, 0)), ((0, 4, 9), (4, 0, 9), (0, 0, 0)):
        tin = tin_of(*points)
        _, mx, my = mirror_facet(
            tin.vertex_array, tin.triangle_array, triangle_at(tin, 1, 1), *in_counts(1, 1)
        )
        top = min(p for p in points if p[2] == 9)
        assert (mx, my) == (2 * top[0] - 1, 2 * top[1] - 1)


def test_mirrored_out_of_the_hull_a_point_is_refused() -> None:
    tin = tin_of((0, 0, 0), (1_000, 0, 9_000), (0, 1_000, 0))
    assert judge(tin, 300, 300, 2_700, terrain_deg=60.0) == (False, True, False)


def test_mirrored_on_a_vertex_only_its_height_passes() -> None:
    tin = tin_of(
        (0, 0, 0), (1_000, 0, 5_000), (0, 1_000, 0), (1_700, -200, 5_300), (3_000, 3_000, 5_000)
    )
    assert judge(tin, 300, 200, 5_300, terrain_deg=60.0) == (True, True, False)
    assert judge(tin, 300, 200, 5_299, terrain_deg=60.0) == (False, True, False)


def test_an_uncertified_answer() -> None:
    """It rests on its triangle, on that behind the edge it lies on, and on that of its mirror image."""
    tin = tin_of(*TERRACE)
    flat = triangle_at(tin, 1_000, 3_000)
    assert judge(tin, 1_000, 3_000, 0) == (True, False, False)
    assert judge(tin, 1_000, 3_000, 0, {flat}) == (True, False, True)
    assert judge(tin, 1_000, 3_000, 0, set(range(tin.n_triangles)) - {flat}) == (
        True,
        False,
        False,
    )

    home, behind = (
        triangle_at(tin, 5_000, 6_000),
        {triangle_at(tin, 4_999, 6_000), triangle_at(tin, 5_001, 6_000)},
    )
    assert home in behind
    for t in range(tin.n_triangles):
        assert judge(tin, 5_000, 6_000, 0, {t})[1:] == (True, t in behind)

    steep, image = triangle_at(tin, 5_500, 7_000), triangle_at(tin, 6_500, 2 * 12_000 - 7_000)
    assert outside(tin, image)
    for t in range(tin.n_triangles):
        is_uncertified = judge(tin, 5_500, 7_000, 0, {t}, terrain_deg=60.0)[2]
        top = mirror_facet(
            tin.vertex_array, tin.triangle_array, steep, *in_counts(5_500, 7_000)
        )[0]
        assert is_uncertified == (t in (steep, top))


counts = st.integers(-20_000, 20_000)
points = st.tuples(counts, counts, counts)


@settings(max_examples=200, deadline=None)
@given(
    corners=st.tuples(points, points, points),
    point=points,
    shift=st.tuples(counts, counts, counts),
)
def test_measures_are_exact_to_a_few_bits_and_do_not_feel_a_shift(
    corners: tuple[Point, Point, Point], point: Point, shift: Point
) -> None:
    a, b, c = (np.array(p, object) for p in corners)
    area = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
    assume(area != 0)
    u, v = b - a, c - a
    normal = np.array([u[i - 2] * v[i - 1] - u[i - 1] * v[i - 2] for i in range(3)], object)
    normal = normal * (1 if area > 0 else -1)
    n2 = int((normal * normal).sum())
    p = np.array(point, object)
    tin = tin_of(*corners)
    t = next(t for t in range(4) if not outside(tin, t))
    got = facet_measures(tin.vertex_array, tin.triangle_array, t, *in_counts(*point), 1.0)
    height = int((normal * (p - a)).sum())
    size = float((abs(normal) * abs(p - a)).sum()) / math.sqrt(n2)
    distance = math.copysign(math.sqrt(Fraction(height * height, n2)), height)
    assert got[0] == pytest.approx(distance, abs=1e-12 * size + 1e-9)
    assert got[1] == pytest.approx(
        math.sqrt(min(int(((p - q) ** 2).sum()) for q in (a, b, c))), rel=1e-14
    )
    assert got[2] == pytest.approx(float(Fraction(int(normal[2]) ** 2, n2)), rel=1e-12)
    edges = [int(((q - r)[:2] ** 2).sum()) for q, r in ((a, b), (b, c), (c, a))]
    assert got[3] == pytest.approx(math.sqrt(max(edges)), rel=1e-15)

    moved = tin_of(*(tuple(np.add(q, shift)) for q in (corners[2], corners[0], corners[1])))
    t = next(t for t in range(4) if not outside(moved, t))
    at = tuple(int(v) for v in np.add(point, shift))
    assert (
        facet_measures(moved.vertex_array, moved.triangle_array, t, *in_counts(*at), 1.0) == got
    )


def test_within_its_limits() -> None:
    allowed = limits(distance_m=1.0, angle_deg=30.0, reduce_m=4.0)
    assert within(-1000.0, 2000.5, 4000.0, allowed)
    assert not within(1000.5, 9000.0, 4000.0, allowed)
    assert not within(1000.0, 1999.0, 4000.0, allowed)
    assert not within(1000.0, 2000.5, 3900.0, allowed)
