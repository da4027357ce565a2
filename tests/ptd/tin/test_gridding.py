"""Pixels have one owner each and the right height, and marks never miss a pixel that unknown data could change."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import LinearNDInterpolator

from ptd.tin import KnownWindow, Pixels, Tin, pixel_owners, rasterise
from tests.ptd.tin import reference
from tests.ptd.tin.meshes import corners_of, insert_point, outside, real_triangles
from tests.ptd.tin.strategies import Points, columns

points_near = st.lists(
    st.tuples(st.integers(0, 24), st.integers(0, 24), st.integers(-90, 90)),
    min_size=3,
    max_size=14,
)
cells = st.sampled_from([(1, 1), (2, 1), (4, 1), (3, 2), (5, 3), (7, 128)])


def block(p: int, q: int, low: int, high: int) -> Pixels:
    """Pixels that cover local low .. high on both axes."""
    left, right = math.floor(Fraction(low * q, p)), math.ceil(Fraction(high * q, p))
    return Pixels(p, q, left, right - 1, right - left, right - left)


def centres(pixels: Pixels) -> tuple[list[Fraction], list[Fraction]]:
    """Local x by column and y by row."""
    half = Fraction(pixels.p, 2 * pixels.q)
    return (
        [(2 * (pixels.left + c) + 1) * half - pixels.origin_x for c in range(pixels.columns)],
        [(2 * (pixels.top - r) + 1) * half - pixels.origin_y for r in range(pixels.rows)],
    )


def passing(facet: reference.Facet, max_edge2: float, max_radius2: float) -> bool:
    a, b, c = facet
    sides = [(u[0] - v[0]) ** 2 + (u[1] - v[1]) ** 2 for u, v in ((a, b), (b, c), (c, a))]
    if max(sides) > max_edge2:
        return False
    return Fraction(math.prod(sides), 4 * reference.area(*facet) ** 2) <= max_radius2


def sides_of(facet: reference.Facet, p: tuple[Any, Any]) -> list[Any]:
    """Side of the edge opposite each corner on which a position lies."""
    a, b, c = facet
    return [reference.area(*edge, p) for edge in ((b, c), (c, a), (a, b))]


@given(
    points_near,
    cells,
    st.sampled_from([(math.inf, math.inf), (12, math.inf), (15, 7.5), (9, 9)]),
)
@settings(deadline=None, max_examples=25)
def test_heights_by_definition(
    points: Points, cell: tuple[int, int], limits: tuple[float, float]
) -> None:
    tin = Tin.build(*columns(points))
    pixels = block(*cell, -2, 27) if cell[1] < 100 else Pixels(*cell, 18 * 10, 18 * 14, 90, 90)
    max_edge, max_radius = limits
    heights, marks = rasterise(tin, pixels, max_edge=max_edge, max_radius=max_radius)
    assert not marks.any()
    z = {(int(x), int(y)): int(h) for x, y, h in tin.vertices}
    facets = [
        tuple((int(x), int(y)) for x, y, _ in tin.vertices[facet])
        for facet in real_triangles(tin)
    ]
    facets = [f for f in facets if passing(f, max_edge**2, max_radius**2)]
    xs, ys = centres(pixels)
    for row, y in enumerate(ys):
        for column, x in enumerate(xs):
            owners = [f for f in facets if min(sides_of(f, (x, y))) >= 0]
            got = heights[row, column]
            assert math.isnan(got) == (not owners)
            if owners:
                # Facets that share a border have the same height there.
                assert abs(Fraction(float(got)) - reference.plane(owners[0], z, x, y)) < 1e-6


@given(points_near, cells)
@settings(deadline=None, max_examples=15)
def test_owner_of_a_pixel_on_an_edge_is_the_side_with_the_smaller_apex(
    points: Points, cell: tuple[int, int]
) -> None:
    tin = Tin.build(*columns(points))
    pixels = block(*cell, 0, 24) if cell[1] < 100 else Pixels(*cell, 18 * 10, 18 * 14, 60, 60)
    owners, _ = pixel_owners(tin, pixels)
    xs, ys = centres(pixels)
    # Integers, in halves of the q-th part of a count, are faster than fractions.
    part = 2 * pixels.q
    xs, ys = ([int(part * v) for v in axis] for axis in (xs, ys))
    position = [(part * int(x), part * int(y)) for x, y, _ in tin.vertices]
    for row, y in enumerate(ys):
        for column, x in enumerate(xs):
            candidates = []
            for t in range(tin.n_triangles):
                if outside(tin, t):
                    continue
                f = tuple(position[v] for v in corners_of(tin, t))
                sides = sides_of(f, (x, y))
                if min(sides) >= 0:
                    n_on = sides.count(0)
                    candidates.append((f[sides.index(0)] if n_on == 1 else (0, 0), t, n_on))
            if not candidates:
                assert owners[row, column] == -1
            elif candidates[0][2] == 2:
                assert position[-2 - owners[row, column]] == (x, y)
            else:
                assert owners[row, column] == min(candidates)[1]


def random_tin(n: int, extent: int, seed: int = 0) -> Tin:
    rng = np.random.default_rng(seed)
    return Tin.build(*rng.integers(0, extent, (2, n)), rng.integers(0, 5000, n))


def test_linear_equals_scipy() -> None:
    tin = random_tin(3000, 30_000)
    pixels = Pixels(1000, 3, 0, 89, 90, 90)
    xs, ys = centres(pixels)
    xy = np.meshgrid(np.array(xs, float), np.array(ys, float))
    table = tin.vertices.astype(float)
    expected = LinearNDInterpolator(table[:, :2], table[:, 2])(*xy)
    heights, _ = rasterise(tin, pixels)
    np.testing.assert_allclose(heights, expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("interpolator", ["linear", "natural"])
def test_planes_are_exact(interpolator: str) -> None:
    rng = np.random.default_rng(1)
    x, y = rng.integers(0, 30_000, (2, 2000))
    tin = Tin.build(x, y, 3 * x - 2 * y + 7)
    pixels = Pixels(125, 1, 0, 239, 240, 240)
    xs, ys = (np.array(v, float) for v in centres(pixels))
    heights, _ = rasterise(tin, pixels, interpolator=interpolator)
    plane = 3 * xs[None, :] - 2 * ys[:, None] + 7
    filled = ~np.isnan(heights)
    assert filled.mean() > 0.95
    np.testing.assert_array_equal(heights[filled], plane[filled])


@pytest.mark.parametrize("interpolator", ["linear", "natural"])
def test_bits_do_not_depend_on_order_frame_or_block(interpolator: str) -> None:
    rng = np.random.default_rng(2)
    x, y = rng.integers(0, 20_000, (2, 900))
    x[:300], y[:300] = x[:300] // 1000 * 1000, y[:300] // 1000 * 1000
    z = rng.integers(-4000, 4000, 900)
    limits = {"max_edge": 1100, "max_radius": 600.0, "interpolator": interpolator}
    pixels = Pixels(1000, 3, 2, 58, 55, 55)
    heights, _ = rasterise(Tin.build(x, y, z), pixels, **limits)
    assert 0.2 < np.isnan(heights).mean() < 0.8
    order = rng.permutation(900)
    shuffled = Tin.build(x[order[:9]], y[order[:9]], z[order[:9]], max_vertices=900)
    for i in order[9:]:
        insert_point(shuffled, int(x[i]), int(y[i]), int(z[i]))
    np.testing.assert_array_equal(rasterise(shuffled, pixels, **limits).heights, heights)
    moved = Pixels(1000, 3, 2, 58, 55, 55, 123_456, -77)
    other = Tin.build(x - 123_456, y + 77, z + 10_000_019)
    np.testing.assert_array_equal(
        rasterise(other, moved, **limits).heights - 10_000_019, heights
    )
    part = rasterise(other, Pixels(1000, 3, 12, 48, 20, 30, 123_456, -77), **limits)
    np.testing.assert_array_equal(part.heights - 10_000_019, heights[10:40, 10:30])


def test_pixels_far_from_a_hole_in_the_window_are_certain_only_within_reach() -> None:
    tin = Tin.build([0, 10, 0], [0, 0, 10], [0, 0, 0])
    pixels = Pixels(10, 1, -10, 9, 20, 20)
    window = KnownWindow(-100, -100, 100, 100)
    assert rasterise(tin, pixels, window=window).marks.sum() >= 399
    near = rasterise(tin, pixels, window=window, max_radius=20.0).marks
    assert near[0].all()
    assert not near[5:15, 5:15].any()


@pytest.mark.parametrize(
    "points", [[], [(0, 0, 1)], [(0, 0, 1), (5, 5, 2)], [(k, k, k) for k in (0, 4, 8)]]
)
@pytest.mark.parametrize("interpolator", ["linear", "natural"])
def test_no_facet_no_height(points: Points, interpolator: str) -> None:
    tin, pixels = Tin.build(*columns(points)), Pixels(1, 1, 0, 9, 10, 10)
    heights, marks = rasterise(tin, pixels, interpolator=interpolator)
    assert np.isnan(heights).all()
    assert not marks.any()


def test_rows_go_from_north_to_south() -> None:
    tin = Tin.build([0, 100, 0, 100], [0, 0, 100, 100], [0, 0, 100, 100])
    heights, _ = rasterise(tin, Pixels(10, 1, 0, 9, 10, 10))
    np.testing.assert_array_equal(heights[:, 3], np.arange(95, 0, -10))


def test_natural_neighbours_by_counting_cells() -> None:
    """Sibson's weights are areas of Voronoi cells: count fine samples that change hands."""
    rng = np.random.default_rng(4)
    x, y = rng.integers(0, 1000, (2, 40))
    z = rng.integers(0, 1000, 40)
    tin = Tin.build(x, y, z)
    pixels = Pixels(100, 1, 3, 6, 4, 4)
    xs, ys = (np.array(v, float) for v in centres(pixels))
    heights, _ = rasterise(tin, pixels, interpolator="natural")
    fine = np.arange(-1000, 2000, 2.5) + 1.25
    gx, gy = np.meshgrid(fine, fine)
    table = tin.vertices.astype(float)
    nearest = np.full(gx.shape, np.inf)
    owner = np.zeros(gx.shape, int)
    for v, (vx, vy, _) in enumerate(table):
        d = (gx - vx) ** 2 + (gy - vy) ** 2
        owner = np.where(d < nearest, v, owner)
        nearest = np.minimum(d, nearest)
    for row in range(4):
        for column in range(4):
            taken = (gx - xs[column]) ** 2 + (gy - ys[row]) ** 2 < nearest
            assert heights[row, column] == pytest.approx(table[owner[taken], 2].mean(), abs=12)


def test_natural_neighbours_of_a_sliver_that_is_a_line_in_float64() -> None:
    """A vertex lies 50 km away, one count beside a diagonal; the plane of the facet must hold."""
    far = 50_000_000
    x, y = np.array([0, 2, 0, far], np.int32), np.array([0, 2, 10, far - 1], np.int32)
    tin = Tin.build(x, y, np.full(4, 10, np.int32))
    heights, _ = rasterise(tin, Pixels(1, 1, 0, 0, 2, 2), interpolator="natural")
    assert heights[np.isfinite(heights)].tolist() == [10.0] * int(np.isfinite(heights).sum())
    assert np.isfinite(heights).any()


def test_natural_neighbours_on_a_regular_grid_are_symmetric() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 100, 10), np.arange(0, 100, 10)))
    z = np.where((x == 40) & (y == 40), 400, 0)
    heights, _ = rasterise(
        Tin.build(x, y, z), Pixels(10, 1, 2, 6, 5, 5), interpolator="natural"
    )
    np.testing.assert_allclose(heights, heights.T[::-1, ::-1], atol=1e-5)
    assert heights[2, 2] == pytest.approx(100, abs=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"p": 0}, "cell size is 0 / 1"),
        ({"q": 512}, "1 <= q <= 511"),
        ({"p": 2**26}, "must be below"),
        ({"columns": -1}, "none may be negative"),
        ({"left": 2**33}, "counts from the TIN's local 0"),
    ],
)
def test_pixels_refuse(change: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Pixels(**({"p": 1, "q": 1, "left": 0, "top": 0, "columns": 1, "rows": 1} | change))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"max_edge": -1}, "max_edge is -1"),
        ({"max_radius": math.nan}, "max_radius is nan"),
        ({"interpolator": "cubic"}, "interpolator is 'cubic'"),
    ],
)
def test_rasterise_refuses(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rasterise(random_tin(9, 99), Pixels(1, 1, 0, 0, 1, 1), **change)
    with pytest.raises(ValueError, match="is empty"):
        KnownWindow(0, 0, 0, 5)


def test_heights_at_positions() -> None:
    tin = random_tin(500, 3000)
    assert (
        tin.heights(tin.vertices[:, 0], tin.vertices[:, 1]).tolist()
        == tin.vertices[:, 2].tolist()
    )
    table = tin.vertices.astype(float)
    x, y = np.random.default_rng(6).integers(-50, 3050, (2, 400))
    expected = LinearNDInterpolator(table[:, :2], table[:, 2])(x, y)
    np.testing.assert_allclose(tin.heights(x, y), expected, atol=1e-5, rtol=0)
    assert np.isnan(Tin(1).heights([1], [2])).all()
