from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import shapely
from scipy import ndimage

from tiler.export.contour_lines import (
    Joiner,
    contour_block,
    default_interval,
    is_short,
    smoothed,
    smoothing_reach,
    stays,
)


def lines_of(heights, size, interval=Fraction(1), sigma=0.0, max_held=10**6):
    """All lines of a raster that is seen in blocks of ``size`` pixels."""
    joiner, found, reach = Joiner(max_held), [], smoothing_reach(sigma)
    height, width = heights.shape
    for row in range(0, height, size):
        for col in range(0, width, size):
            top, left = max(row - reach, 0), max(col - reach, 0)
            window = heights[top : row + size + 1 + reach, left : col + size + 1 + reach]
            core = smoothed(window, sigma)[row - top :, col - left :][: size + 1, : size + 1]
            for piece in contour_block(core, interval, row, col):
                found += joiner.add(piece)
        found += joiner.end_row(row + size)
    return found, joiner.cut


@pytest.fixture(scope="module")
def hills():
    heights = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=(90, 130)), 5) * 60
    heights[20:35, 50:70] = np.nan
    heights[60:75, 20:45] = 1.0  # a lake at the height of a level
    return heights


@pytest.mark.parametrize("sigma", [0.0, 1.5])
def test_blocks_do_not_show(hills, sigma):
    whole, _ = lines_of(hills, 1000, sigma=sigma)
    expected = sorted((level, places.tobytes()) for level, places in whole)
    assert len(expected) > 50
    for size in (64, 17):
        found, _ = lines_of(hills, size, sigma=sigma)
        assert sorted((level, places.tobytes()) for level, places in found) == expected


def test_lines_neither_cross_nor_touch(hills):
    lines = [shapely.LineString(places) for _, places in lines_of(hills, 64)[0]]
    assert all(shapely.is_simple(lines))
    one, other = shapely.STRtree(lines).query(lines, predicate="intersects")
    assert (one == other).all()


def between(heights, places):
    """Heights between pixels; far off where a pixel without height has any weight."""
    return ndimage.map_coordinates(
        np.where(np.isnan(heights), 1e9, heights), places[:, ::-1].T, order=1
    )


def test_vertices_have_the_height_of_their_line(hills):
    for level, places in lines_of(hills, 64)[0]:
        assert between(hills, places) == pytest.approx(level, abs=1e-5)


def test_lines_end_at_the_border_or_beside_pixels_without_height(hills):
    last = (hills.shape[1] - 1, hills.shape[0] - 1)
    beside = ndimage.binary_dilation(np.isnan(hills), np.ones((3, 3)))
    for _, places in lines_of(hills, 64)[0]:
        if (places[0] != places[-1]).any():
            for x, y in places[[0, -1]]:
                assert x in (0, last[0]) or y in (0, last[1]) or beside[round(y), round(x)]


def test_a_level_lake_is_gone_around(hills):
    lake = shapely.box(20.5, 60.5, 43.5, 73.5)
    lines = [shapely.LineString(places) for _, places in lines_of(hills, 64)[0]]
    assert not any(line.intersects(lake) for line in lines)
    assert any(line.is_closed and shapely.Polygon(line).contains(lake) for line in lines)


def test_a_cone_has_circles():
    y, x = np.mgrid[0:81, 0:81]
    heights = 30 - np.hypot(x - 40, y - 40)
    lines, _ = lines_of(heights, 32, Fraction(5))
    inner = {level: places for level, places in lines if -2 < level < 6}
    assert sorted(inner) == [-1, 0, 1, 2, 3, 4, 5]
    for level, places in inner.items():
        assert np.hypot(*(places - 40).T) == pytest.approx(30 - 5 * level, abs=0.05)
        assert (places[0] == places[-1]).all()


def test_long_lines_are_cut_where_too_many_vertices_wait(hills):
    whole, _ = lines_of(hills, 17)
    cut, times = lines_of(hills, 17, max_held=100)
    assert times > 0
    for level in {level for level, _ in whole}:
        merged, expected = (
            shapely.MultiLineString([places for at, places in found if at == level])
            for found in (cut, whole)
        )
        assert merged.length == pytest.approx(expected.length)
        assert shapely.line_merge(merged).equals(shapely.line_merge(expected))


@pytest.mark.parametrize(
    ("relief", "interval"),
    [
        (0, "0.25"),
        (12, "0.25"),
        (13, "0.5"),
        (30, "1"),
        (50, "1"),
        (51, "2"),
        (230, "5"),
        (900, "20"),
        (8800, "200"),
    ],
)
def test_default_interval(relief, interval):
    assert default_interval(relief, Fraction(1, 4)) == Fraction(interval)


def test_default_interval_is_no_finer_than_the_heights_are_accurate():
    for noise in np.geomspace(0.01, 3, 40):
        interval = default_interval(1.0, Fraction(1, 4), noise)
        assert interval >= max(4 * noise, 0.25)
        assert interval <= max(10 * noise, 0.25)
    assert default_interval(3.0, Fraction(1)) == 1  # feet


def rings(heights: np.ndarray) -> list[tuple[int, np.ndarray]]:
    return [line for line in lines_of(heights, 64)[0] if is_short(line[1])]


@pytest.mark.parametrize(
    ("rise", "drawn"), [(0.2, False), (0.45, False), (0.55, True), (-0.55, True), (-0.3, False)]
)
def test_a_bump_is_drawn_from_half_an_interval_on(rise: float, drawn: bool) -> None:
    heights = np.full((20, 20), 10.0 - 0.01 * np.sign(rise))
    heights[8, 9] = 10.0 + rise
    (line,) = rings(heights)
    assert stays(line[1], heights, 10.0, 1.0) == drawn


def test_of_rings_in_one_another_the_outer_ones_are_left_out() -> None:
    heights = np.full((20, 20), 9.9)
    heights[8, 9] = 12.7
    found = [
        level for level, places in rings(heights) if stays(places, heights, float(level), 1.0)
    ]
    assert found == [12]


def test_a_long_ring_and_an_open_line_are_not_short() -> None:
    rows, cols = np.indices((40, 40))
    hill = 10.5 - np.hypot(rows - 20, cols - 20) / 4
    lengths = [np.hypot(*np.diff(places, axis=0).T).sum() for _, places in rings(hill)]
    assert all(length < 10 for length in lengths)
    slope = cols / 3.0
    assert [line for line in lines_of(slope, 64, Fraction(1))[0] if is_short(line[1])] == []
