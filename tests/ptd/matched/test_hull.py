"""Hulls: a slow search over all paraboloids, planes, hills, boxes, clumps of blunders, and windows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ptd.frame import Scale
from ptd.matched.cells import EMPTY
from ptd.matched.hull import LOWEST, TILT_BLOCKS, Envelope, lower_envelope, tilts

MM = Scale()
BLOCK, CUT_CELLS = 8, 3
"""Of cells of 1 m."""
STRIDE_M = 0.04
"""What may be missed between the centres of paraboloids."""


def terrain(rows: int, columns: int, empty: float, seed: int, slope: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:rows, :columns]
    z = 1000 * slope * (row - 0.5 * column) + rng.integers(-1500, 1500, (rows, columns))
    z = np.where(rng.random((rows, columns)) < empty, EMPTY, z)
    return z.astype(np.int32)


def slow_hull(heights: np.ndarray, rule: Envelope, row: int, column: int) -> np.ndarray:
    """Every paraboloid with every cell."""
    falls, s = rule.falls(MM), rule.stride
    north, east = tilts(heights, TILT_BLOCKS, BLOCK)
    hull = np.full(heights.shape, LOWEST, np.int64)
    for r in range(-row % s, heights.shape[0], s):
        for c in range(-column % s, heights.shape[1], s):
            if (heights[r : r + s, c : c + s] == EMPTY).all():
                continue
            south, north_end = (
                max(r - rule.radius, 0),
                min(r + rule.radius + 1, heights.shape[0]),
            )
            west, east_end = max(c - rule.radius, 0), min(c + rule.radius + 1, heights.shape[1])
            part = np.s_[south:north_end, west:east_end]
            dr, dc = np.mgrid[south - r : north_end - r, west - c : east_end - c]
            shape = -falls[abs(dr)] - falls[abs(dc)]
            shape += north[r // BLOCK, c // BLOCK] * dr + east[r // BLOCK, c // BLOCK] * dc
            tops = np.sort((heights[part] - shape)[heights[part] != EMPTY])
            if tops.size > CUT_CELLS:
                hull[part] = np.maximum(hull[part], tops[CUT_CELLS] + shape)
    return hull


@pytest.mark.parametrize(
    ("rule", "empty", "slope"),
    [
        (Envelope(0.05, 1.0), 0.3, 0.0),
        (Envelope(0.2, 6.0), 0.8, 0.6),
        (Envelope(0.008, 0.4), 0.5, 0.2),
        (Envelope(0.02, 4.0), 0.99, 0.0),
    ],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_slow_search_over_all_paraboloids_finds_the_same(
    rule: Envelope, empty: float, slope: float, seed: int
) -> None:
    heights = terrain(37, 50, empty, seed, slope)
    row, column = 8 * seed, -16
    assert np.array_equal(
        lower_envelope(heights, rule, MM, row, column), slow_hull(heights, rule, row, column)
    )


def counts(metres: np.ndarray) -> np.ndarray:
    return np.rint(1000 * metres).astype(np.int32)


def raster(side: int) -> tuple[np.ndarray, np.ndarray]:
    row, column = np.mgrid[:side, :side]
    return row - side // 2, column - side // 2


@pytest.mark.parametrize("slope", [0.0, 0.2, -0.7, 1.5])
@pytest.mark.parametrize("rule", [Envelope(0.01, 11.5), Envelope(0.08, 6.0)])
def test_a_plane_is_its_own_hull(slope: float, rule: Envelope) -> None:
    row, column = raster(160)
    z = slope * row + 0.3 * column
    north, east = tilts(counts(z), TILT_BLOCKS, BLOCK)
    assert np.allclose(north[7:-7, 7:-7], 1000 * slope, atol=1)
    assert np.allclose(east[7:-7, 7:-7], 300, atol=1)
    error = lower_envelope(counts(z), rule, MM, 0, 0)[56:-56, 56:-56] / 1000 - z[56:-56, 56:-56]
    # Above by the four neighbours of what a paraboloid cuts through, and by slopes in whole
    # counts.
    assert -STRIDE_M - 1e-3 < error.min() <= error.max() < rule.curvature / 2 + 0.02


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, -0.25, -1.0, -3.0])
def test_hills_that_bend_less_and_bowls_are_followed(share: float) -> None:
    """Tilts are those of blocks, so up to 4 cells away the terrain's slope differs from them by 4 c for a curvature c.

    In a bowl the paraboloid of curvature k then touches 4 c / (k + c) cells off, 8 c^2 / (k +
    c) below the cell, along rows and columns.
    """
    rule = Envelope(0.04, 11.5)
    row, column = raster(160)
    bend = -share * rule.curvature
    z = bend / 2 * (row**2 + column**2)
    error = lower_envelope(counts(z), rule, MM, 0, 0)[56:-56, 56:-56] / 1000 - z[56:-56, 56:-56]
    off = 2 * 8 * bend**2 / (rule.curvature + bend) if bend > 0 else 0.0
    assert -0.14 - off < error.min() <= error.max() < 0.15


def test_hills_that_bend_more_are_cut() -> None:
    row, column = raster(160)
    z = np.maximum(-0.06 / 2 * (row**2 + column**2), -10.0)
    hull = lower_envelope(counts(z), Envelope(0.02, 11.5), MM, 0, 0)
    assert hull[80, 80] < -2000


@pytest.mark.parametrize("side", [9, 15, 19, 23, 31])
def test_boxes_narrower_than_a_limit_are_passed_below(side: int) -> None:
    """On a box of height h the paraboloid stands if it has fallen by h where the ground begins."""
    rule, height = Envelope(0.04, 11.5), 2.0
    row, column = raster(120)
    z = height * (np.maximum(abs(row), abs(column)) <= side // 2)
    hull = lower_envelope(counts(z), rule, MM, 0, 0)
    expected = min(rule.curvature / 2 * (side // 2 + 1) ** 2, height)
    assert hull[60, 60] / 1000 == pytest.approx(expected, abs=0.15)
    assert (hull[60, 60] < 1850) == (side < 2 * math.sqrt(2 * height / rule.curvature) - 1)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_a_few_blunders_do_not_hold_it_down(n: int) -> None:
    z = np.zeros((120, 120))
    z[[60, 60, 61][:n], [60, 61, 60][:n]] = -5.0
    hull = lower_envelope(counts(z), Envelope(0.04, 11.5), MM, 0, 0)
    assert hull[30:-30, 30:-30].min() > -100


def test_more_low_cells_are_ground() -> None:
    z = np.zeros((120, 120))
    z[[60, 60, 61, 61, 59], [60, 61, 60, 61, 60]] = -5.0
    hull = lower_envelope(counts(z), Envelope(0.04, 11.5), MM, 0, 0)
    assert hull[60, 60] < -4300


def test_too_few_cells_have_none() -> None:
    z = np.full((16, 16), EMPTY, np.int32)
    z[8, 8 : 8 + CUT_CELLS] = 0
    assert (lower_envelope(z, Envelope(0.04, 2.0), MM, 0, 0) == LOWEST).all()


@pytest.mark.parametrize("rule", [Envelope(0.05, 1.0), Envelope(0.008, 0.4)])
def test_nothing_beyond_the_reach_has_a_part(rule: Envelope) -> None:
    heights = terrain(240, 232, 0.4, 5, 0.3)
    whole, r = lower_envelope(heights, rule, MM, -24, 16), rule.reach
    south, west = 40, 24
    cut = lower_envelope(heights[south:-31, west:], rule, MM, -24 + south, 16 + west)
    assert np.array_equal(
        cut[r : cut.shape[0] - r, r:], whole[south + r : 240 - 31 - r, west + r :]
    )
    assert (cut != whole[south:-31, west:]).any()
