"""Water is found where land rises all around what returns little; nothing else that returns little is water."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from tiler.grid.coverage import histograms, usual_returns
from tiler.grid.water_cells import (
    ENOUGH_RETURNS,
    CellCounts,
    Rim,
    WaterCells,
    rim_of,
    water_candidates,
    water_confidence,
)
from tiler.grid.water_extent import (
    close_bridge_gaps,
    extended_to_shore,
    remove_narrow_parts,
    smoothed,
    water_heights,
    without_islands,
)
from tiler.grid.water_planes import plane_cells

SIDE = 120  # cells of 2 m
ROW, COL = np.mgrid[0:SIDE, 0:SIDE].astype(np.float64)
LAKE = np.hypot(ROW - 50, COL - 60) < 22
RIVER = np.abs(ROW - 60 - 6 * np.sin(COL / 20)) < 8
STRIP = np.abs(COL - 60) < 6
BASIN = 10 + 0.15 * np.clip(np.hypot(ROW - 50, COL - 60) - 21, 0, 10)
VALLEY = 10 + 0.01 * COL + 0.2 * np.clip(np.abs(ROW - 60 - 6 * np.sin(COL / 20)) - 7.5, 0, 12)
FLAT = np.full((SIDE, SIDE), 10.0)
HILLS = 10 + 4 * np.sin(ROW / 15) + 3 * np.cos(COL / 11)
SLOPE = 10 + 0.2 * ROW


def cells(ground: np.ndarray, few: np.ndarray, left: float = 0.0, seed: int = 1) -> WaterCells:
    """Some 20 returns a cell, of which ``few`` cells keep a share; ground where there are returns, else as around."""
    rng = np.random.default_rng(seed)
    returns = rng.poisson(20 * np.where(few, left, 1.0)).astype(np.float64)
    uneven = ground + rng.normal(0, 0.04, ground.shape)
    every = np.ones(ground.shape, np.bool_)
    return WaterCells(returns, ~every, uneven, every, 2.0)


def usual(given: WaterCells) -> tuple[int, float] | None:
    """How many cells are merged, and the median of their returns, in whole squares of 16."""
    return usual_returns(
        [histograms(given.returns.astype(np.int64)[:112, :112])], ENOUGH_RETURNS
    )


def bodies(
    given: WaterCells, trusted: bool = True, pieces: int = 1
) -> list[tuple[np.ndarray, float]]:
    """Cells of each area of water, and how sure it is; the land around it is counted in strips."""
    times, median = usual(given) or (1, None)
    assert times == 1
    labels, number = ndimage.label(water_candidates(given, median if trusted else None))
    strip, result = np.arange(SIDE) * pieces // SIDE, []
    for n in range(1, number + 1):
        mine, others = labels == n, (labels > 0) & (labels != n)
        size = CellCounts(int(mine.sum()), int(given.given[mine].sum()))
        rim = Rim()
        for part in range(pieces):
            counted = np.repeat((strip == part)[:, None], SIDE, axis=1)
            rim = rim.plus(rim_of(given, mine, others, counted))
        sure = water_confidence(size, rim)
        if sure is not None:
            result.append((mine, sure))
    return result


def found(given: WaterCells, trusted: bool = True) -> np.ndarray:
    water = np.zeros(given.returns.shape, np.bool_)
    for body, _ in bodies(given, trusted):
        water |= body
    return water


@pytest.mark.parametrize(("ground", "wet"), [(BASIN, LAKE), (VALLEY, RIVER)])
@pytest.mark.parametrize("left", [0.0, 0.3])
def test_water_between_rising_banks_is_found(
    ground: np.ndarray, wet: np.ndarray, left: float
) -> None:
    water = found(cells(ground, wet, left))
    assert (water & wet).sum() > 0.85 * wet.sum()
    assert (water & ~wet).sum() <= 0.01 * wet.sum()


@pytest.mark.parametrize("left", [0.0, 0.3])
def test_the_land_around_may_be_compared_in_pieces(
    left: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = cells(VALLEY, RIVER, left)
    whole = [(body.tolist(), sure) for body, sure in bodies(given)]
    monkeypatch.setattr("tiler.grid.water_cells.CELLS_PER_BATCH", 7)
    monkeypatch.setattr("tiler.grid.coarse.STRIP_ROWS", 9)
    assert whole
    assert [(body.tolist(), sure) for body, sure in bodies(given, pieces=5)] == whole


@pytest.mark.parametrize(
    ("ground", "few", "left"),
    [
        (FLAT, LAKE, 0.0),  # a hole in level land
        (FLAT, LAKE, 0.3),  # wet asphalt, a dark lawn
        (FLAT, STRIP, 0.0),  # between two strips
        (HILLS, STRIP, 0.0),
        (SLOPE, LAKE, 0.0),
        (20 - BASIN, LAKE, 0.0),  # on a hill
        (BASIN, LAKE, 1.0),  # a sunken pitch: as many returns as anywhere
        (FLAT + 6 * (np.abs(COL - 80) < 6), np.abs(COL - 69) < 5, 0.0),  # the shadow of a wall
    ],
)
def test_what_returns_little_elsewhere_is_no_water(
    ground: np.ndarray, few: np.ndarray, left: float
) -> None:
    assert not found(cells(ground, few, left)).any()


def test_water_goes_on_where_the_ground_is_as_low_however_many_returns_it_has() -> None:
    given = cells(VALLEY, RIVER & ~STRIP, 0.3)
    smooth = given.with_ground(smoothed(given.ground))
    water = extended_to_shore(smooth, RIVER & ~STRIP, water_heights(smooth, RIVER & ~STRIP), 10)
    assert (water & RIVER & STRIP).sum() > 0.95 * (RIVER & STRIP).sum()
    assert (water & ~RIVER).sum() < 0.1 * RIVER.sum()  # a cell along its banks


def test_planes_are_level_areas_and_heights_of_single_cells_do_not_break_them() -> None:
    pits = np.random.default_rng(5).random(FLAT.shape) < 0.03
    ground = VALLEY - 2.0 * pits
    plane = plane_cells(smoothed(ground), np.ones_like(pits))
    inner = ndimage.binary_erosion(RIVER, iterations=2)
    assert (plane & inner).sum() > 0.8 * inner.sum()
    assert not plane_cells(SLOPE, np.ones_like(pits)).any()


def test_of_matched_clouds_only_the_class_tells() -> None:
    given = cells(BASIN, LAKE)
    assert not found(given, trusted=False).any()
    water = found(replace(given, given=LAKE), trusted=False)
    assert (water == LAKE).mean() > 0.99


def test_cells_are_larger_where_points_are_sparse() -> None:
    returns = np.random.default_rng(2).poisson(2.0, FLAT.shape) * 1.0
    times, median = usual(replace(cells(FLAT, LAKE), returns=returns)) or (0, 0.0)
    assert times == 2
    assert 7 < median < 9.5
    sparse = replace(cells(FLAT, LAKE), returns=returns).coarser()
    assert sparse.size_m == 4
    assert not water_candidates(sparse, median).any()
    again = sparse.finer(2)
    assert again.size_m == 2
    assert (again.returns[::2, 1::2] == sparse.returns).all()
    assert usual(replace(cells(FLAT, LAKE), returns=returns * 0)) is None


def test_the_usual_returns_are_the_median_of_cells_with_any() -> None:
    counts = np.zeros((16, 16), np.int64)
    counts[:4] = 9
    counts[4:6] = 13
    assert usual_returns([histograms(counts)], 8) == (1, pytest.approx(9, rel=0.03))
    assert usual_returns([histograms(counts), histograms(counts + 40)], 8) == (
        1,
        pytest.approx(40, rel=0.03),
    )


def test_small_islands_become_water_and_land_at_the_border_stays() -> None:
    water = np.ones((20, 20), np.bool_)
    water[5:7, 5:7] = water[12:16, 12:16] = water[0:1, 9:11] = False
    kept = without_islands(water, 5)
    assert kept[5:7, 5:7].all()
    assert not kept[12:16, 12:16].any()
    assert not kept[0, 9:11].any()


def test_water_goes_on_under_a_bridge_and_not_through_a_dam() -> None:
    broken = RIVER & ~(np.abs(COL - 60) < 2)
    dam = np.where(np.abs(COL - 60) < 2, 13.0, VALLEY)
    no_deck = np.zeros_like(RIVER)
    closed = [
        close_bridge_gaps(cells(ground, ~broken).ground, broken, 2.0, 128, no_deck)
        for ground in (VALLEY, dam)
    ]
    assert (closed[0] & RIVER).sum() > 0.99 * RIVER.sum()
    assert (closed[1] == broken).all()
    deck = np.abs(COL - 60) < 3
    below_deck = close_bridge_gaps(cells(dam, ~broken).ground, broken, 2.0, 128, deck)
    assert (below_deck & RIVER).sum() > 0.99 * RIVER.sum()
    assert not (below_deck & ~RIVER & (np.abs(ROW - 60) > 20)).any()


def test_narrow_arms_are_left_out() -> None:
    arm = (np.abs(ROW - 50) < 2) & (COL > 60)
    kept = remove_narrow_parts(LAKE | arm, 8.0, np.zeros_like(LAKE))
    assert (kept & LAKE).sum() > 0.97 * LAKE.sum()
    assert (kept & arm & ~LAKE).sum() < 0.25 * (arm & ~LAKE).sum()


def test_a_bar_in_the_river_is_no_bridge() -> None:
    bar = (np.abs(ROW - 60 - 6 * np.sin(COL / 20)) < 2.5) & (np.abs(COL - 60) < 20)
    ground = np.where(bar, VALLEY + 0.3, VALLEY)
    closed = close_bridge_gaps(ground, RIVER & ~bar, 2.0, 128, np.zeros_like(bar))
    assert not (closed & bar).any()


def test_a_window_that_cuts_a_long_bar_says_the_same_as_one_that_holds_it() -> None:
    """A bar of 3 x 200 cells in level water: longer than any window has to hold."""
    ground = np.zeros((60, 400))
    bar = np.zeros(ground.shape, np.bool_)
    bar[29:32, 100:300] = True
    ground[bar] = 0.3
    whole = close_bridge_gaps(ground, ~bar, 2.0, 128, np.zeros_like(bar))
    part = close_bridge_gaps(
        ground[:, :200], ~bar[:, :200], 2.0, 128, np.zeros_like(bar[:, :200])
    )
    inner = np.s_[:, 20:150]
    assert (whole[inner] == part[inner]).all()


def test_the_crest_of_a_dam_falls_to_the_water_beside_it():
    """The ground rises at both ends of the dam, and the water on its long sides returns nothing."""
    crest = (np.abs(COL - 60) < 3) & (np.abs(ROW - 60) < 10)
    water = (np.abs(COL - 60) >= 5) & (np.abs(COL - 60) < 40) & (np.abs(ROW - 60) < 10)
    ground = np.where(water, 10.0, 12.0 + 0.3 * np.clip(np.abs(ROW - 60) - 10, 0, 20))
    given, every = cells(ground, water), np.ones(crest.shape, np.bool_)
    alone = rim_of(given, crest, np.zeros_like(crest), every)
    beside = rim_of(given, crest, np.zeros_like(crest), every, water)
    assert water_confidence(CellCounts(), alone) is not None
    assert water_confidence(CellCounts(), beside) is None
