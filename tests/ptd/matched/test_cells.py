"""Heights of cells: the rule by hand and against an obvious reference, slopes, centres and order."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptd.frame import CellLattice, Scale, Window
from ptd.matched.cells import (
    ALIGN,
    EMPTY,
    MARGIN,
    STEEPEST_AT_GAPS,
    _lowest_mode,
    cell_heights,
    raster_of,
)

MM = Scale()
EVERYTHING = Window.everything()
SIGMA_M = 0.05
"""The window that is moved up is four times as high: 200 counts."""


def of_one_cell(z: list[int]) -> np.ndarray:
    places = np.linspace(100, 900, len(z)).astype(np.int32)
    return cell_heights(
        np.stack([places, places, np.array(z, np.int32)]), EVERYTHING, MM, SIGMA_M
    )


@pytest.mark.parametrize(
    ("z", "expected"),
    [
        ([1000, 1010, 1050, 1100, 1200, 1201, 5000], 1050),  # the sixth is beyond the window
        ([1000, 1010, 1050, 1101], 1030),  # between both in the middle
        ([-3000, 1000, 1010, 1050, 1101], 1030),  # a single blunder
        ([-3000, -2950, 1000, 1010, 1050], -2975),  # two that agree
        ([-3000, -2700, 1000, 1010, 1050], 1010),  # two that do not
        ([-3000, -2950, *range(1000, 1019)], 1009),  # of 21 points a surface needs three
    ],
)
def test_median_of_the_lowest_mode(z: list[int], expected: int) -> None:
    assert of_one_cell(z).tolist() == [[500], [500], [expected]]
    assert of_one_cell(z[::-1]).tolist() == [[500], [500], [expected]]


@pytest.mark.parametrize("z", [[1000], [1000, 1201], [-3000, 0, 5000]])
def test_no_two_points_that_agree_are_no_surface(z: list[int]) -> None:
    assert of_one_cell(z).shape == (3, 0)


def slow_mode(values: list[int], width: int, share: float, least: int) -> tuple[int, int]:
    need = max(math.ceil(share * len(values)), least)
    for lowest in sorted(values):
        within = sorted(v for v in values if lowest <= v <= lowest + width)
        if len(within) >= need:
            return math.floor(np.median(within)), len(within)
    return 0, 0


@given(
    values=st.lists(st.integers(-400, 400), min_size=1, max_size=25),
    width=st.integers(0, 200),
    share=st.sampled_from([0.1, 0.25, 0.5]),
)
def test_lowest_mode_is_that_of_a_slow_search(
    values: list[int], width: int, share: float
) -> None:
    found = _lowest_mode(np.sort(np.array(values, np.int64)), width, share, 2)
    assert found == slow_mode(values, width, share, 2)


def plane(
    slope_x: float, slope_y: float, noise_m: float, side: float = 30.0
) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(7)
    x, y = side * rng.random((2, round(30 * side**2)))
    z = 40.0 + slope_x * x + slope_y * y + noise_m * rng.standard_normal(x.size)
    found = cell_heights(
        np.rint(1000 * np.stack([x, y, z])).astype(np.int32), EVERYTHING, MM, noise_m
    )
    cx, cy, cz = found / 1000
    inner = (np.minimum(cx, cy) > 1) & (np.maximum(cx, cy) < side - 1)
    return inner, cz - (40.0 + slope_x * cx + slope_y * cy)


@pytest.mark.parametrize(
    ("slope", "bias", "scatter"),
    [
        ((0.0, 0.0), 0.005, 0.015),
        ((0.4, 0.0), 0.01, 0.04),
        ((0.5, -0.5), 0.01, 0.04),
        ((-1.2, 0.7), 0.04, 0.1),
    ],
)
def test_cells_of_a_plane_are_not_biased(
    slope: tuple[float, float], bias: float, scatter: float
) -> None:
    """Lowest points would lie 2 sigma and half the slope too low: 0.08 m and up to 0.95 m."""
    inner, error = plane(*slope, noise_m=0.04)
    assert inner.sum() == 28 * 28
    assert abs(error[inner].mean()) < bias
    assert error[inner].std() < scatter


@pytest.mark.parametrize(
    ("slope", "bias"), [((0.5, 0.3), 0.03), ((-0.6, 0.0), 0.03), ((1.0, 0.0), 0.3)]
)
def test_cells_at_the_edge_of_a_slope_take_it_from_the_one_neighbour(
    slope: tuple[float, float], bias: float
) -> None:
    """Up to 0.7: beyond, what is beside a gap may be a wall, and the lower part of the cell is its height."""
    inner, error = plane(*slope, noise_m=0.04)
    assert abs(error[~inner].mean()) < bias
    assert (error[~inner].mean() < -0.2) == (max(map(abs, slope)) > STEEPEST_AT_GAPS)


@pytest.mark.parametrize("origin", [(0, 0), (-12_345, 678)])
def test_cells_lie_at_centres_by_rows_whatever_the_order(origin: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    scale = Scale(Fraction(1, 1000), Fraction(1, 1000), origin)
    xyz = rng.integers(0, (9000, 7000, 300), (2000, 3)).T.astype(np.int32)
    found = cell_heights(xyz, EVERYTHING, scale, SIGMA_M)
    x, y = found[0].astype(np.int64) + origin[0], found[1].astype(np.int64) + origin[1]
    assert set(x % 1000) == set(y % 1000) == {500}
    assert np.array_equal(np.lexsort((x, y)), np.arange(x.size))
    shuffled = cell_heights(xyz[:, rng.permutation(2000)], EVERYTHING, scale, SIGMA_M)
    assert np.array_equal(found, shuffled)


def test_bounds_see_two_cells_and_no_farther() -> None:
    rng = np.random.default_rng(4)
    xyz = rng.integers(0, (12_000, 12_000, 900), (3000, 3)).T.astype(np.int32)
    bounds, seen = Window(3500, 4200, 8499, 8000), Window(1500, 2200, 10_499, 10_000)
    whole = cell_heights(xyz, EVERYTHING, MM, SIGMA_M)
    part = cell_heights(xyz[:, seen.contains(xyz[0], xyz[1])], bounds, MM, SIGMA_M)
    assert part.shape[1] == 5 * 4  # the western border holds its centre, the eastern does not
    assert np.array_equal(part, whole[:, bounds.contains(whole[0], whole[1])])


def test_rasters_hold_their_cells_amid_a_margin_and_are_aligned() -> None:
    x, y = np.array([-2500, 500, 10_500], np.int32), np.array([500, 4500, -7500], np.int32)
    raster = raster_of(np.stack([x, y, np.array([5, 6, 7], np.int32)]), CellLattice.of(1.0, MM))
    assert raster.column % ALIGN == raster.row % ALIGN == 0
    rows, columns = np.nonzero(raster.heights != EMPTY)
    found = {
        (c + raster.column, r + raster.row): int(raster.heights[r, c])
        for r, c in zip(rows, columns, strict=True)
    }
    assert found == {(-3, 0): 5, (0, 4): 6, (10, -8): 7}
    assert raster.heights.reshape(-1)[raster.keys].tolist() == [5, 6, 7]
    edges = (
        rows.min(),
        columns.min(),
        *(np.array(raster.heights.shape) - 1 - (rows.max(), columns.max())),
    )
    assert min(edges) >= MARGIN - 1
