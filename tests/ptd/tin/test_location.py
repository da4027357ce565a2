"""Every position has one owner, whatever the hint."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.tin import Tin
from ptd.tin.triangles import coincident_vertex, locate
from tests.ptd.tin import reference
from tests.ptd.tin.meshes import corners_of, outside, real_triangles
from tests.ptd.tin.strategies import Points, columns, point_sets


def owner_by_definition(tin: Tin, x: int, y: int) -> list[list[tuple[int, int]]]:
    """The facets that may own (x, y): one, several around a vertex, none outside the hull."""
    p = (x, y)
    inside = []
    for facet in real_triangles(tin):
        a, b, c = ((int(tin.vertices[v, 0]), int(tin.vertices[v, 1])) for v in facet)
        sides = [reference.area(b, c, p), reference.area(c, a, p), reference.area(a, b, p)]
        if min(sides) >= 0:
            apex = (a, b, c)[sides.index(0)] if sides.count(0) == 1 else None
            inside.append((apex, sorted([a, b, c])))
    if len(inside) == 2 and inside[0][0] is not None and inside[1][0] is not None:
        return [min(inside)[1]]
    return [facet for _, facet in inside]


@given(point_sets, st.data())
@settings(deadline=None, max_examples=60)
def test_locate(points: Points, data: st.DataObject) -> None:
    tin = Tin.build(*columns(points))
    if tin.n_triangles == 0:
        return
    some = [(int(x), int(y)) for x, y, _ in tin.vertices]
    near = [((a[0] + b[0]) // 2, (a[1] + b[1]) // 2) for a in some[:4] for b in some]
    x, y = data.draw(st.sampled_from(some + near))
    x += data.draw(st.integers(-1, 1))
    hint = data.draw(st.integers(0, tin.n_triangles - 1))
    t = locate(tin.vertex_array, tin.triangle_array, x, y, hint)
    owners = owner_by_definition(tin, x, y)
    v = coincident_vertex(tin.vertex_array, tin.triangle_array, x, y, t)
    assert (v >= 0) == ((x, y) in some)
    if v >= 0:
        assert some[v] == (x, y)
    if not owners:
        assert outside(tin, t)
        a, b = (some[u] for u in hull_edge(tin, t))
        assert reference.area(a, b, (x, y)) > 0
        return
    assert not outside(tin, t)
    found = sorted(some[u] for u in corners_of(tin, t))
    assert found in owners
    assert v >= 0 or len(owners) == 1


def hull_edge(tin: Tin, ghost: int) -> tuple[int, int]:
    corners = corners_of(tin, ghost)
    k = corners.index(-1)
    return corners[(k + 1) % 3], corners[(k + 2) % 3]
