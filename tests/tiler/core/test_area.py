"""Areas are compared with exact fractions, place by place."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiler.core.area import MAX_EDGE, Area, AreaIndex, Places, in_runs, segmentized
from tiler.core.lattice import Bounds, Cell, Lattice
from tiler.core.raster import Block, RasterSpec

STAR = np.array([[0, 0], [1000, 100], [700, 900], [300, 400], [100, 950]], np.int64)
HOLE = np.array([[300, 150], [500, 150], [400, 300], [300, 150]], np.int64)
BESIDE = np.array([[1000, 100], [1400, 100], [1400, 900], [700, 900]], np.int64)


def crossings(ring: np.ndarray, x: int, y: int) -> int:
    """Edges that a ray to the east crosses, by definition."""
    found = 0
    for (ax, ay), (bx, by) in zip(
        ring.tolist(), np.roll(ring, -1, axis=0).tolist(), strict=True
    ):
        if (ay <= y) != (by <= y):
            found += x < ax + Fraction((bx - ax) * (y - ay), by - ay)
    return found


def by_definition(area: Area, x: np.ndarray, y: np.ndarray) -> list[bool]:
    return [
        any(sum(crossings(ring, i, j) for ring in rings) % 2 == 1 for rings in area.polygons)
        for i, j in zip(x.tolist(), y.tolist(), strict=True)
    ]


@pytest.mark.parametrize("shift", [0, 32_500_000_123, -5_000_000_007])
def test_inside_is_an_odd_number_of_crossings(shift: int) -> None:
    area = Area(((STAR + shift, HOLE + shift), (BESIDE + shift,)))
    x, y = np.random.default_rng(1).integers(-100, 1500, (2, 1500)) + shift
    corners = np.concatenate([STAR, HOLE, BESIDE]) + shift
    x, y = np.append(x, corners[:, 0]), np.append(y, corners[:, 1])
    assert area.inside(x, y).tolist() == by_definition(area, x, y)
    assert area.inside(x[:0], y[:0]).size == 0


@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=8),
    st.booleans(),
)
def test_any_ring_is_exact_to_the_count(ring: list[tuple[int, int]], backwards: bool) -> None:
    places = np.array(ring[:: -1 if backwards else 1], np.int64)
    y, x = (grid.ravel() for grid in np.mgrid[-10:11, -10:11])
    area = Area(((places,),))
    assert area.inside(x, y).tolist() == by_definition(area, x, y)


@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=8),
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=8),
    st.lists(st.integers(-11, 11), max_size=9),
    st.lists(st.integers(-11, 11), max_size=9),
    st.sampled_from([0, 32_500_000_123, -5_000_000_007]),
    st.booleans(),
)
def test_a_grid_has_the_same_places_inside(
    ring: list[tuple[int, int]],
    other: list[tuple[int, int]],
    columns: list[int],
    rows: list[int],
    shift: int,
    apart: bool,
) -> None:
    rings = np.array(ring, np.int64) + shift, np.array(other, np.int64) + shift
    area = Area(((rings[0],), (rings[1],)) if apart else (rings,))
    x, y = np.array(sorted(columns), np.int64) + shift, np.array(rows, np.int64) + shift
    wide, high = (grid.ravel() for grid in np.meshgrid(x, y))
    assert area.inside_grid(x, y).ravel().tolist() == by_definition(area, wide, high)


def test_a_grid_takes_many_crossings_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = np.random.default_rng(5).integers(0, 1000, (300, 2))
    area, x, y = Area(((corners,),)), np.arange(0, 1000, 7), np.arange(1000, 0, -9)
    usual = area.inside_grid(x, y)
    monkeypatch.setattr("tiler.core.area.CROSSINGS_AT_ONCE", 7)
    assert np.array_equal(usual, area.inside_grid(x, y))
    wide, high = (grid.ravel() for grid in np.meshgrid(x, y))
    assert np.array_equal(usual.ravel(), area.inside(wide, high))


def test_neighbours_share_no_place_and_leave_none() -> None:
    y, x = (grid.ravel() for grid in np.mgrid[0:1000:7, 0:1450:7])
    corners = np.concatenate([STAR, BESIDE])
    x, y = np.append(x, corners[:, 0]), np.append(y, corners[:, 1])
    one, other = Area(((STAR,),)).inside(x, y), Area(((BESIDE,),)).inside(x, y)
    assert not (one & other).any()
    edge = np.array([[1000, 100], [700, 900]])
    on = np.stack([edge[0] + (edge[1] - edge[0]) * k // 100 for k in range(1, 100)], axis=1)
    both = Area(((STAR,),)).inside(*on).astype(int) + Area(((BESIDE,),)).inside(*on)
    assert (both == 1).all()


def test_a_rectangle_is_its_bounds() -> None:
    bounds = Bounds(-3, 5, 4, 9)
    y, x = (grid.ravel() for grid in np.mgrid[3:12, -6:8])
    expected = (x >= -3) & (x < 4) & (y >= 5) & (y < 9)
    area = Area.rectangle(bounds)
    assert (area.inside(x, y) == expected).all()
    assert area.bounds == bounds
    far = Area.rectangle(Bounds(-(10**15), -(10**15), 10**15, 10**15))
    assert far.inside(x, y).all()
    assert far.covers(bounds)


def test_an_area_comes_back_from_json() -> None:
    area = Area(((STAR, HOLE), (BESIDE,)))
    again = Area.from_json(area.to_json())
    assert again.to_json() == area.to_json()
    assert again.bounds == area.bounds == Bounds(0, 0, 1400, 950)


@pytest.mark.parametrize(
    ("size", "margin"), [(37, 0), (37, 60), (Fraction(1000, 3), 5), (400, 1)]
)
def test_cells_are_those_that_come_near(size: Fraction | int, margin: int) -> None:
    lattice, area = Lattice(Fraction(size)), Area(((STAR, HOLE), (BESIDE + 900,)))
    window = Bounds(-500, -400, 3000, 2500)
    runs = area.cells(lattice, window, margin)
    assert runs is not None
    assert runs == sorted(runs)
    cells = list(lattice.cells(window))
    near = [area.touches(lattice.bounds(cell).pad(margin)) for cell in cells]
    ix, iy = np.array([[c.ix, c.iy] for c in cells]).T
    assert in_runs(runs, ix, iy).tolist() == near
    assert sum(end - first for _, first, end in runs) == sum(near)
    x, y = np.random.default_rng(2).integers(-100, 1500, (2, 500))
    inside = area.inside(x, y)
    assert in_runs(runs, lattice.index(x), lattice.index(y))[inside].all()


def test_a_window_inside_needs_no_cells() -> None:
    area = Area(((STAR, HOLE),))
    assert area.cells(Lattice(Fraction(10)), Bounds(600, 400, 650, 450), 5) is None
    assert area.cells(Lattice(Fraction(10)), Bounds(9000, 0, 9100, 50), 5) == []
    assert not in_runs([], np.array([1]), np.array([2])).any()
    assert area.covers(Bounds(600, 400, 650, 450))
    assert not area.covers(Bounds(350, 140, 450, 200))
    assert not area.touches(Bounds(380, 200, 420, 220))  # in the hole


def test_long_edges_are_divided() -> None:
    ring = np.array([[0, 0], [5 * MAX_EDGE, 7], [0, 3 * MAX_EDGE]], np.int64)
    parts = segmentized(ring)
    steps = np.abs(np.roll(parts, -1, axis=0) - parts)
    assert steps.max() <= MAX_EDGE
    assert {tuple(p) for p in ring.tolist()} <= {tuple(p) for p in parts.tolist()}
    assert segmentized(STAR).tolist() == STAR.tolist()


def test_pixels_are_inside_by_their_centres() -> None:
    area = Area(((STAR,), (BESIDE,)))
    spec = RasterSpec(Lattice(Fraction(100, 3)), -2, 31, 34, 45)
    block = Block(3, 1, 29, 40)
    rows, cols = np.mgrid[3:32, 1:41]
    x = [[(2 * (c - 2) + 1) * 100 // 6 for c in row] for row in cols.tolist()]
    y = [[(2 * (30 - r) + 1) * 100 // 6 for r in row] for row in rows.tolist()]
    expected = by_definition(area, np.array(x).ravel(), np.array(y).ravel())
    assert spec.inside(block, area).ravel().tolist() == expected
    assert spec.inside(block, None).all()
    assert not spec.inside(block, Area(((STAR + 10_000,),))).any()
    assert spec.inside(block, Area.rectangle(Bounds(-9999, -9999, 9999, 9999))).all()


def test_an_outline_of_thousands_of_kilometres_is_found_in_bounded_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Cells that are not near may be found as well, but no near cell may be missing."""
    lattice, window = Lattice(Fraction(10)), Bounds(-5000, -5000, 5000, 5000)
    area = Area(((np.array([[-4000, -3900], [4100, -3000], [200, 4300]], np.int64),),))
    exact = area.cells(lattice, window, 7)
    monkeypatch.setattr("tiler.core.area.MAX_BOXES", 100)
    rough = area.cells(lattice, window, 7)
    assert exact is not None
    assert rough is not None
    y, x = (axis.ravel() for axis in np.mgrid[-500:500, -500:500])
    assert not (in_runs(exact, x, y) & ~in_runs(rough, x, y)).any()
    assert in_runs(rough, x, y).sum() < 2 * in_runs(exact, x, y).sum()


def many_areas(number: int) -> list[Area]:
    """Stars, rectangles and pairs of them, on whole hundreds so that edges meet places and cells."""
    rng = np.random.default_rng(5)
    found = []
    for kind, (x, y) in enumerate(rng.integers(-30, 30, (number, 2)) * 100):
        ring = STAR * (1 + kind % 3) // 2 + (x, y)
        corner = Bounds(int(x), int(y), int(x) + 300, int(y) + 200)
        shapes = (
            ((ring,),),
            Area.rectangle(corner).polygons,
            ((ring, HOLE + (x, y)), (BESIDE + (x, y),)),
        )
        found.append(Area(shapes[kind % 3]))
    return found


def test_a_few_places_give_the_same_result_as_many(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = np.random.default_rng(1).integers(-60, 60, (2, 300)) * 50
    areas = many_areas(60)
    few = [area.inside(x, y) for area in areas]
    monkeypatch.setattr("tiler.core.area.FEW_SIDES", 0)
    for area, inside in zip(areas, few, strict=True):
        assert np.array_equal(area.inside(x, y), inside)


def test_places_find_those_inside_each_area() -> None:
    x, y = np.random.default_rng(1).integers(-60, 60, (2, 2000)) * 50
    places = Places(x, y)
    for area in many_areas(60):
        assert np.array_equal(places.inside(area), np.flatnonzero(area.inside(x, y)))


def test_an_index_finds_the_areas_that_touch() -> None:
    areas, lattice = many_areas(90), Lattice(Fraction(700))
    index, cells = (
        AreaIndex(areas),
        [Cell(ix, iy) for ix in range(-5, 6) for iy in range(-5, 6)],
    )
    expected = {}
    for cell in cells:
        bounds = lattice.bounds(cell)
        near = [i for i, a in enumerate(areas) if a.bounds.overlaps(bounds)]
        touching = [i for i in near if areas[i].touches(bounds)]
        assert (index.overlapping(bounds), index.touching(bounds)) == (near, touching)
        if touching:
            expected[cell] = touching
    assert index.by_cell(lattice, cells) == expected
    assert AreaIndex([]).by_cell(lattice, cells) == {}
    assert index.by_cell(lattice, []) == {}


@pytest.mark.parametrize("few", [0, 4096])
def test_pixels_inside_are_those_whose_centres_are(
    few: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tiler.core.raster.FEW_PIXELS", few)
    spec = RasterSpec(Lattice(Fraction(130)), -30, 30, 60, 55)
    block = Block(4, 8, 40, 32)
    x, y = spec.centres(block)
    for area in many_areas(60):
        expected = area.inside(x.ravel(), y.ravel()).reshape(x.shape)
        assert np.array_equal(spec.inside(block, area), expected)
