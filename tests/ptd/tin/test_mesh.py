"""The triangulation is the exact, unique Delaunay triangulation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.tin import MAX_EXTENT, Tin
from tests.ptd.tin import reference
from tests.ptd.tin.meshes import corners_of, insert_point, real_triangles
from tests.ptd.tin.strategies import Points, columns, point_sets

relaxed = settings(deadline=None, max_examples=60)


def facets_of(tin: Tin) -> list[reference.Facet]:
    return [
        tuple((int(x), int(y)) for x, y, _ in tin.vertices[facet])
        for facet in real_triangles(tin)
    ]


def lowest(points: Points) -> dict[reference.Point, int]:
    out: dict[reference.Point, int] = {}
    for x, y, z in points:
        out[x, y] = min(z, out.get((x, y), z))
    return out


def check_consistent(tin: Tin) -> None:
    """Check adjacency, orientation, incident triangles and Euler's formula."""
    n, m = tin.n_vertices, tin.n_triangles
    rows = tin.triangle_array[: 8 * m].reshape(m, 8)
    incident = tin.vertex_array[: 4 * n].reshape(n, 4)[:, 3]
    if m == 0:
        assert (incident == -1).all()
        return
    assert m == 2 * n - 2
    for t in range(m):
        for j in range(3):
            twin = int(rows[t, j])
            assert rows[twin >> 3, twin & 3] == 8 * t + j
            ends = {int(rows[t, 4 + (j + 1) % 3]), int(rows[t, 4 + (j + 2) % 3])}
            k = twin & 3
            assert {
                int(rows[twin >> 3, 4 + (k + 1) % 3]),
                int(rows[twin >> 3, 4 + (k + 2) % 3]),
            } == ends
        corners = [int(v) for v in rows[t, 4:7]]
        assert len(set(corners)) == 3
        assert min(corners) >= -1
        if min(corners) >= 0:
            a, b, c = ((int(tin.vertices[v, 0]), int(tin.vertices[v, 1])) for v in corners)
            assert reference.area(a, b, c) > 0
    for v in range(n):
        assert v in rows[incident[v], 4:7]
    n_hull = int((rows[:, 4:7] == -1).sum())
    assert len(real_triangles(tin)) == 2 * n - 2 - n_hull


@given(point_sets)
@relaxed
def test_build_is_the_delaunay_triangulation_by_definition(points: Points) -> None:
    tin = Tin.build(*columns(points))
    assert facets_of(tin) == reference.delaunay([(x, y) for x, y, _ in points])
    assert {(int(x), int(y)): int(z) for x, y, z in tin.vertices} == lowest(points)
    check_consistent(tin)


@given(point_sets, st.randoms(use_true_random=False))
@relaxed
def test_any_order_of_insertion_gives_the_same_facets(points: Points, random) -> None:
    expected = facets_of(Tin.build(*columns(points)))
    shuffled = list(points)
    random.shuffle(shuffled)
    split = random.randint(0, len(points))
    tin = Tin.build(*columns(shuffled[:split]), max_vertices=max(len(points), 1))
    if tin.n_triangles == 0:
        split, tin = len(points), Tin.build(*columns(shuffled))
    for x, y, z in shuffled[split:]:
        insert_point(tin, x, y, z)
    assert facets_of(tin) == expected
    assert {(int(x), int(y)): int(z) for x, y, z in tin.vertices} == lowest(points)
    check_consistent(tin)


@given(point_sets, st.integers(-(2**30), 2**30), st.integers(-(2**30), 2**30))
@relaxed
def test_a_translation_translates_the_facets(points: Points, dx: int, dy: int) -> None:
    x, y, z = columns(points)
    expected = [
        tuple((px + dx, py + dy) for px, py in facet) for facet in facets_of(Tin.build(x, y, z))
    ]
    assert facets_of(Tin.build(x + np.int32(dx), y + np.int32(dy), z)) == expected


@given(point_sets)
@relaxed
def test_facets_cover_the_convex_hull(points: Points) -> None:
    tin = Tin.build(*columns(points))
    covered = sum(reference.area(*facet) for facet in facets_of(tin))
    assert covered == reference.hull_area([(x, y) for x, y, _ in points])


@pytest.mark.parametrize("kind", ["random", "grid", "circle", "line", "scan", "parabola"])
def test_larger_sets_are_independent_of_the_order_and_locally_delaunay(kind: str) -> None:
    rng = np.random.default_rng(5)
    n = 3000
    k = np.arange(n)
    x, y = {
        "random": lambda: rng.integers(0, 50_000, (2, n)),
        "grid": lambda: (1000 * (k % 60), 1000 * (k // 60)),
        "circle": lambda: np.rint(3e7 * np.array([np.cos(k), np.sin(k)])).astype(np.int64),
        "line": lambda: (np.where(k == 77, 5, 3 * k), np.where(k == 77, 900, 2 * k)),
        "scan": lambda: (300 * (k % 500) + rng.integers(-3, 4, n), 20_000 * (k // 500) + k % 7),
        "parabola": lambda: (k - n // 2, (k - n // 2) ** 2),
    }[kind]()
    z = rng.integers(0, 9, n)
    tin = Tin.build(x, y, z)
    order = np.append(77, rng.permutation(np.delete(k, 77)))
    some = order[:10]
    other = Tin.build(x[some], y[some], z[some], max_vertices=n)
    for i in order[10:]:
        insert_point(other, int(x[i]), int(y[i]), int(z[i]))
    np.testing.assert_array_equal(
        tin.vertices[real_triangles(tin)], other.vertices[real_triangles(other)]
    )
    check_consistent(tin)
    # If every edge is locally Delaunay, the triangulation is Delaunay.
    m = tin.n_triangles
    rows = tin.triangle_array[: 8 * m].reshape(m, 8)
    position = [(int(a), int(b)) for a, b, _ in tin.vertices]
    for t in range(m):
        if rows[t, 4:7].min() < 0:
            continue
        corners = [position[v] for v in rows[t, 4:7]]
        for j in range(3):
            apex = int(tin.triangle_array[rows[t, j] + 4])
            assert apex < 0 or not reference.in_circle(*corners, position[apex])


def test_a_large_cavity_outgrows_the_scratch() -> None:
    angle = np.arange(2000) * (2 * np.pi / 2000)
    x, y = np.rint(3e7 * np.cos(angle)).astype(int), np.rint(3e7 * np.sin(angle)).astype(int)
    tin = Tin.build(x, y, np.zeros(2000, int), max_vertices=2001)
    insert_point(tin, 0, 0, 5)
    centre = tin.n_vertices - 1
    assert (real_triangles(tin) == centre).any(axis=1).sum() > 1000
    check_consistent(tin)


def test_the_lowest_point_at_one_place_stays() -> None:
    tin = Tin.build([3, 13, 3, 3], [4, 4, 14, 4], [5, 0, 0, 7], max_vertices=4)
    assert insert_point(tin, 3, 4, 6) == 0
    assert insert_point(tin, 13, 4, -1) == insert_point(tin, 13, 4, 9)
    assert sorted(tin.vertices.tolist()) == [[3, 4, 5], [3, 14, 0], [13, 4, -1]]


def test_stamps_mark_what_changed() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 200, 10), np.arange(0, 200, 10)))
    tin = Tin.build(x, y, np.zeros(400, int), max_vertices=402, stamp=1)
    before = {tuple(map(tuple, f)) for f in tin.vertices[real_triangles(tin)].tolist()}

    def stamps() -> dict[tuple[tuple[int, int, int], ...], int]:
        out = {}
        for t in range(tin.n_triangles):
            corners = corners_of(tin, t)
            if min(corners) >= 0:
                points = [tuple(tin.vertices[v].tolist()) for v in corners]
                k = points.index(min(points))
                out[tuple(points[k:] + points[:k])] = int(tin.triangle_array[8 * t + 3])
        return out

    assert set(stamps().values()) == {1}
    insert_point(tin, 55, 52, 7, stamp=2)
    assert {f for f, s in stamps().items() if s == 2} == set(stamps()) - before
    before = set(stamps())
    insert_point(tin, 100, 100, -3, stamp=3)
    changed = {f for f, s in stamps().items() if s == 3}
    assert changed == set(stamps()) - before
    assert all((100, 100, -3) in f for f in changed)


def test_vertices_are_read_only() -> None:
    tin = Tin.build([0, 5, 0], [0, 0, 5], [1, 2, 3])
    with pytest.raises(ValueError, match="read-only"):
        tin.vertices[0, 0] = 1


@pytest.mark.parametrize(
    ("columns_", "message"),
    [
        (([0, 1], [0], [0, 0]), "x, y, z have 2, 1, 2 values"),
        (([0.0, 1.0], [0, 1], [0, 0]), "x is float64, must be integer"),
        (([[0, 1]], [0, 1], [0, 0]), "x has 2 dimensions"),
        (([0, 1], [0, 2**31], [0, 0]), "y reaches from 0 to 2147483648"),
        (([0, MAX_EXTENT], [0, 0], [0, 0]), "x extends from 0 to 67108864"),
        (([0, 0], [-1, MAX_EXTENT - 1], [0, 0]), "y extends from -1"),
    ],
)
def test_build_refuses(columns_: tuple[object, object, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Tin.build(*columns_)


def test_room_is_checked() -> None:
    with pytest.raises(ValueError, match="max_vertices is 0"):
        Tin(0)


def test_heights_far_from_the_vertices_would_not_be_exact() -> None:
    tin = Tin.build([0, 5, 0], [0, 0, 5], [1, 2, 3])
    assert tin.heights([0, MAX_EXTENT - 1], [0, 0]).tolist()[0] == 1
    with pytest.raises(ValueError, match="y extends from -67108864 to 5"):
        tin.heights([0], [-MAX_EXTENT])


def test_a_tin_without_triangles_has_no_heights() -> None:
    tin = Tin.build([0, 1, 2], [0, 1, 2], [0, 0, 0])
    assert real_triangles(tin).shape == (0, 3)
    assert np.isnan(tin.heights([0], [0])).all()
