"""Large objects as wholes: halls, terraces, widths, what stands on or leans on what was found, and slopes."""

from __future__ import annotations

import numpy as np
import pytest

from ptd.frame import Scale
from ptd.ground.morphology import connected_surfaces
from ptd.matched.bent_hull import STIFF
from ptd.matched.cells import EMPTY
from ptd.matched.hull import ROOFS_TILT_BLOCKS, lower_envelope, tilts
from ptd.matched.objects import DIAGONAL, MAX_WIDTH_M, judged

MM = Scale()
SIGMA_M = 0.05


def of(z: np.ndarray, removed: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Objects and terrain among the cells with a height (metres; NaN: none) that are not removed."""
    removed = np.zeros(z.shape, bool) if removed is None else removed
    heights = np.where(np.isnan(z), EMPTY, np.rint(1000 * np.nan_to_num(z))).astype(np.int32)
    hull = lower_envelope(heights, STIFF, MM, 0, 0)
    left = np.where(removed, EMPTY, heights).astype(np.int32)
    objects, terrain = judged(heights, hull, removed, SIGMA_M, MM)
    assert not (objects & (left == EMPTY)).any()
    assert not (objects & terrain).any()
    return objects, terrain


def box(side: int, *bounds: int) -> np.ndarray:
    south, north, west, east = bounds
    found = np.zeros((side, side), bool)
    found[south:north, west:east] = True
    return found


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_a_hall_goes_and_the_ground_around_it_is_terrain(slope: float) -> None:
    hall = box(140, 40, 80, 50, 100)
    row = np.mgrid[:140, :140][0]
    objects, terrain = of(slope * row + 8.0 * hall)
    assert np.array_equal(objects, hall)
    assert np.array_equal(terrain, ~hall)


def test_a_court_within_a_hall_stays() -> None:
    hall, court = box(140, 40, 100, 40, 100), box(140, 60, 80, 60, 80)
    objects, _ = of(8.0 * (hall & ~court))
    assert np.array_equal(objects, hall & ~court)


def test_a_terrace_that_falls_on_one_side_stays() -> None:
    terrace = box(140, 50, 90, 50, 90)
    z = np.where(np.mgrid[:140, :140][0] < 50, 0.0, 8.0)
    objects, _ = of(np.where(terrace, 4.0, z))
    assert not objects[terrace].any()


@pytest.mark.parametrize("edge", [30, 75, 120])
def test_what_a_step_parts_from_the_rest_of_a_small_survey_is_ground_on_both_sides(
    edge: int,
) -> None:
    row, _ = np.mgrid[:150, :150]
    objects, _ = of(2.0 * (row >= edge))
    assert not objects.any()


@pytest.mark.parametrize(("side", "is_terrain"), [(80, True), (60, False)])
def test_the_ground_of_a_small_survey_is_terrain_ditch_or_not(
    side: int, is_terrain: bool
) -> None:
    """Half of it lies on the stiff hull, and it does not fall: a crest beside a ditch is no plants."""
    column = np.arange(side)
    z = np.broadcast_to(-2.0 * np.clip(5 - abs(column - 15), 0, 3) / 3, (side, side))
    assert of(z)[1].all() == is_terrain


@pytest.mark.parametrize("full_of_gaps", [False, True])
def test_a_ridge_is_terrain_but_not_the_top_of_a_wood(full_of_gaps: bool) -> None:
    """As wide, as high above the hull, and both fall at less than TERRAIN_FALLS of their rim."""
    top = box(170, 60, 90, 30, 150)
    row, column = np.mgrid[:170, :170]
    z = np.where(top, 10.0, np.where((row < 60) & (column < 110), 0.0, 14.0))
    if full_of_gaps:
        z[62:88:3, 32:148:3] = 11.0
    assert of(z)[1][61, 33] == (not full_of_gaps)


@pytest.mark.parametrize(
    ("wide", "is_object"), [(int(MAX_WIDTH_M), True), (int(MAX_WIDTH_M) + 1, False)]
)
def test_what_is_wider_than_a_limit_is_terrain(wide: int, is_object: bool) -> None:
    side = 260
    plateau = box(side, 100, 150, 30, 30 + wide)
    objects, terrain = of(8.0 * plateau)
    assert (objects[plateau] == is_object).all()
    assert (terrain[plateau] != is_object).all()
    assert not objects[~plateau].any()


@pytest.mark.parametrize(("side_m", "is_object"), [(6, False), (8, True)])
def test_small_objects_are_left_to_less_stiff_hulls(side_m: int, is_object: bool) -> None:
    house = box(100, 40, 40 + side_m, 40, 40 + side_m)
    objects, _ = of(5.0 * house)
    assert (objects[house] == is_object).all()


def test_equipment_on_a_roof_goes_with_it() -> None:
    hall, equipment = box(120, 40, 80, 40, 80), box(120, 55, 60, 55, 60)
    z = 8.0 * hall + 2.0 * equipment
    first, _ = of(z)
    assert np.array_equal(first, hall & ~equipment)
    again, _ = of(z, first)
    assert np.array_equal(again, equipment)
    alone, _ = of(2.0 * equipment)
    assert not alone.any()


@pytest.mark.parametrize(("side_m", "is_object"), [(3, True), (5, False)])
def test_a_yard_between_houses_stays_but_not_what_sticks_out_of_a_wall(
    side_m: int, is_object: bool
) -> None:
    block, yard = box(120, 40, 80, 40, 80), box(120, 60, 60 + side_m, 60, 60 + side_m)
    again, _ = of(12.0 * block - 9.0 * yard, block & ~yard)
    assert (again[yard] == is_object).all()


def test_a_platform_that_leans_on_a_hall_goes_after_it() -> None:
    hall, platform = box(140, 40, 80, 40, 80), box(140, 45, 75, 80, 95)
    z = 9.0 * hall + 4.0 * platform
    first, _ = of(z)
    again, _ = of(z, first & hall)
    assert np.array_equal(first | again, hall | platform)
    assert np.array_equal(of(z, hall)[0], platform)


@pytest.mark.parametrize("slope", [0.3, 1.0, 1.8])
def test_a_slope_is_one_surface(slope: float) -> None:
    row, column = np.mgrid[:140, :140]
    heights = np.rint(1000 * (slope * row + 0.1 * column)).astype(np.int32)
    sloped = tilts(heights, ROOFS_TILT_BLOCKS, 8)
    surface, _ = connected_surfaces(heights, 500.0, DIAGONAL * 500.0, tilts=sloped, block=8)
    inner = surface[24:-24, 24:-24]
    assert (inner == inner[0, 0]).all()


def test_noise_widens_the_step() -> None:
    rng = np.random.default_rng(2)
    z = 0.3 * rng.standard_normal((120, 120))
    heights = np.rint(1000 * z).astype(np.int32)
    hull = lower_envelope(heights, STIFF, MM, 0, 0)
    nothing = np.zeros(z.shape, bool)
    _, terrain = judged(heights, hull, nothing, 0.3, MM)
    assert terrain.mean() > 0.99
