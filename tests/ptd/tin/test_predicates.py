"""Predicates compared with exact integers, at the limits of their domain and next to zero."""

from __future__ import annotations

from hypothesis import example, given, settings
from hypothesis import strategies as st

from ptd.tin.triangles import cross_at, in_circle, lexicographic_less
from tests.ptd.tin import reference

far = 2**26 - 1
coordinate = st.one_of(
    st.integers(-far // 2, far // 2),
    st.integers(-3, 3),
    st.sampled_from([-(far // 2), far // 2]),
)
point = st.tuples(coordinate, coordinate)


@given(point, point, point, point)
@example((0, 0), (far, 0), (far, far), (0, far))
@example((0, 0), (far, 0), (far, far), (1, far))
@example((0, 0), (far, 1), (far, far), (0, far))
@example((0, 0), (far - 1, 0), (far, far - 1), (0, far - 1))
@settings(deadline=None, max_examples=200)
def test_in_circle(
    a: reference.Point, b: reference.Point, c: reference.Point, p: reference.Point
) -> None:
    if len({a, b, c, p}) < 4 or reference.area(a, b, c) == 0:
        return
    if reference.area(a, b, c) < 0:
        b, c = c, b
    relative = [d for q in (a, b, c) for d in (q[0] - p[0], q[1] - p[1])]
    assert in_circle(*relative) == reference.in_circle(a, b, c, p)


@given(
    st.integers(1, 4000), st.integers(0, 4000), st.integers(0, 16), st.permutations(range(4))
)
@settings(deadline=None, max_examples=150)
def test_in_circle_of_rectangles_and_near_misses(
    u: int, v: int, power: int, order: list[int]
) -> None:
    u, v = u << power >> 4, v << power >> 4
    corners = [(0, 0), (u, v), (u - v, v + u), (-v, u)]
    if len(set(corners)) < 4 or max(abs(d) for corner in corners for d in corner) > far // 2:
        return
    for dx in (-1, 0, 1):
        moved = [corners[i] for i in order]
        moved[3] = (moved[3][0] + dx, moved[3][1])
        a, b, c, p = moved
        if reference.area(a, b, c) < 0:
            b, c = c, b
        if p in (a, b, c) or reference.area(a, b, c) == 0:
            continue
        relative = [d for q in (a, b, c) for d in (q[0] - p[0], q[1] - p[1])]
        assert in_circle(*relative) == reference.in_circle(a, b, c, p)


@given(point, point, point)
@settings(deadline=None)
def test_orientation_and_order(
    a: reference.Point, b: reference.Point, p: reference.Point
) -> None:
    assert cross_at(*p, *a, *b) == reference.area(a, b, p)
    assert lexicographic_less(*a, *b) == (a < b)
