from fractions import Fraction

import numpy as np
import pytest

from ptd.tin import Tin
from tiler.core.breaklines import Breaklines, two_heights
from tiler.core.lattice import Bounds, Lattice

PIXEL, SHORTEST = Fraction(1000), Fraction(20)
WINDOW = Bounds(-5_000, -5_000, 60_000, 60_000)


def line(*places):
    return np.array(places, np.int64)


WALL = (
    line((0, 5000, 10_000), (50_000, 15_000, 12_000)),
    line((0, 5060, 13_000), (50_000, 15_060, 15_000)),
)
BEND = line(*((x, 30_000 + (x // 500) % 7 * 150, 12_000) for x in range(0, 50_001, 500)))
SHARP = line((20_000, 40_000, 9_000), (30_000, 41_000, 9_000), (20_000, 40_800, 9_000))
LINES = [*WALL, BEND, SHARP]


@pytest.fixture(scope="module")
def lines():
    return Breaklines.of(LINES, PIXEL, SHORTEST, WINDOW)


@pytest.fixture(scope="module")
def ground():
    xy = np.random.default_rng(2).integers(-3_000, 53_000, (2, 5_000))
    return np.vstack((xy, 8_000 + xy[0] // 20)).astype(np.int32)


def distance(points, pieces):
    """Distance of each point from the nearest piece, computed slowly."""
    a, way = pieces[:, :2], pieces[:, 3:5] - pieces[:, :2]
    part = np.clip(((points[:, None] - a) * way).sum(axis=2) / (way**2).sum(axis=1), 0, 1)
    return np.hypot(*np.moveaxis(points[:, None] - a - part[:, :, None] * way, 2, 0)).min(
        axis=1
    )


def test_every_piece_is_an_edge_of_the_tin(lines, ground):
    tin = Tin.build(*lines.applied(ground, WINDOW, WINDOW, (0, 0)))
    number = {tuple(place): v for v, place in enumerate(tin.vertices[:, :2].tolist())}
    corners = tin.triangle_array[: 8 * tin.n_triangles].reshape(-1, 8)[:, 4:7]
    edges = {
        frozenset(e) for t in corners.tolist() for e in zip(t, (t[1], t[2], t[0]), strict=True)
    }
    assert len(lines.pieces) > 500
    for x0, y0, _, x1, y1, _ in lines.pieces.tolist():
        assert frozenset((number[x0, y0], number[x1, y1])) in edges


def test_the_order_and_direction_of_lines_change_nothing(lines):
    again = Breaklines.of(
        [LINES[i][::-1] for i in (3, 1, 0, 2)] + [BEND], PIXEL, SHORTEST, WINDOW
    )
    assert again.key == lines.key


def test_only_ground_within_half_a_pixel_is_left_out(lines, ground):
    found = lines.applied(ground, WINDOW, WINDOW, (0, 0))
    kept = {tuple(p) for p in found.T.tolist()}
    near = distance(ground[:2].T.astype(float), lines.pieces.astype(float)) < 500
    assert 0 < near.sum() < ground.shape[1]
    assert [tuple(p) in kept for p in ground.T.tolist()] == (~near).tolist()
    assert found.shape[1] == (~near).sum() + len(lines.vertices)


def test_a_window_has_the_same_edges_as_the_whole(lines, ground):
    origin = (7_000, -2_000)
    whole = {tuple(p) for p in lines.applied(ground, WINDOW, WINDOW, (0, 0)).T.tolist()}
    window = Bounds(10_000, 2_000, 27_000, 33_000)
    inside = (
        (ground[0] >= window.x0)
        & (ground[0] < window.x1)
        & (ground[1] >= window.y0)
        & (ground[1] < window.y1)
    )
    local = ground[:, inside] - np.array([[*origin, 0]], np.int32).T
    found = lines.applied(local, window, WINDOW, origin) + np.array([[*origin, 0]], np.int32).T
    expected = {
        p for p in whole if window.x0 <= p[0] < window.x1 and window.y0 <= p[1] < window.y1
    }
    assert {tuple(p) for p in found.T.tolist()} == expected


def test_pieces_lie_on_their_lines_and_are_no_longer_than_a_pixel(lines):
    length = np.hypot(*(lines.pieces[:, 3:5] - lines.pieces[:, :2]).T)
    assert length.max() <= 1000

    on = distance(
        lines.pieces[:, :2].astype(float),
        np.concatenate([np.hstack((a[:-1], a[1:])) for a in LINES]).astype(float),
    )
    assert on.max() <= 0.75
    foot = lines.vertices[(lines.vertices[:, 1] < 20_000) & (lines.vertices[:, 2] < 12_500)]
    assert foot[:, 2] == pytest.approx(10_000 + foot[:, 0] / 25, abs=1)


def test_a_changed_line_changes_only_the_digests_of_its_cells(lines):
    lattice = Lattice(Fraction(16_000))
    other = Breaklines.of([*WALL, BEND, SHARP + (0, 0, 50)], PIXEL, SHORTEST, WINDOW)
    before, after = lines.digests(lattice), other.digests(lattice)
    changed = {
        cell for cell in before.keys() | after.keys() if before.get(cell) != after.get(cell)
    }
    assert changed == {cell for cell in before if cell.iy == 2 and cell.ix == 1}


def test_lines_far_away_are_not_divided_and_change_nothing():
    far = line((-(10**9), 10_000, 0), (10**9, 12_000, 9_000))  # 2,000 km
    data = Bounds(0, 0, 30_000, 30_000)
    found = Breaklines.of([far, *LINES], PIXEL, SHORTEST, data)
    assert len(found.pieces) < 1_000
    wide = Breaklines.of([far, *LINES], PIXEL, SHORTEST, WINDOW)
    inside = {
        tuple(p) for p in wide.pieces.tolist() if all(0 <= p[i] < 30_000 for i in (0, 1, 3, 4))
    }
    assert inside == {
        tuple(p) for p in found.pieces.tolist() if all(0 <= p[i] < 30_000 for i in (0, 1, 3, 4))
    }


def test_round_trip(lines):
    again = Breaklines.from_json(lines.to_json())
    assert again.key == lines.key


def test_places_with_two_heights():
    across = line((10_000, 0, 5_000), (10_000, 20_000, 5_000))
    level = line((0, 7_000, 5_005), (20_000, 7_000, 5_005), (20_000, 9_000, 5_005))
    other = line((0, 12_000, 5_000), (20_000, 12_000, 5_040))
    assert two_heights([across, level]).tolist() == []
    assert two_heights([across, level, other]).tolist() == [[10_000, 12_000, 5_020, 5_000]]
    assert two_heights([level, level + (0, 0, 300)])[:, :2].tolist() != []
    assert two_heights([]).shape == (0, 4)


def test_a_vertical_line_has_no_pieces():
    none = Breaklines.of([line((0, 0, 0), (0, 0, 5))], PIXEL, SHORTEST, WINDOW)
    xyz = np.array([[1, 2], [3, 4], [5, 6]], np.int32)
    assert none.applied(xyz, WINDOW, WINDOW, (0, 0)) is xyz
    assert none.digests(Lattice(PIXEL)) == {}
    assert Breaklines.from_json(none.to_json()).pieces.shape == (0, 6)
