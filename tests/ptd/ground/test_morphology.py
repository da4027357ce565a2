"""Openings with disks against scipy, and what empty cells and the raster's extent must not change."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from ptd.frame import CellLattice, Scale
from ptd.ground.morphology import EMPTY, OVERHANG, CellRaster, disk_minimum, steepest_drops

RADII = (0, 1, 1.5, 2, 3, 5, 7, 9.4, 18)


def disk(radius: float) -> np.ndarray:
    d = np.arange(-int(radius), int(radius) + 1)
    return d[:, None] ** 2 + d**2 <= radius * radius


def opened_by_scipy(heights: np.ndarray, radius: float) -> np.ndarray:
    """In floats, with infinity for what is missing: far beyond the border as well."""
    pad = int(radius) + OVERHANG
    wide = np.pad(heights.astype(float), pad, constant_values=EMPTY)
    filled, under = wide != EMPTY, {"footprint": disk(radius), "mode": "constant"}
    lowest = ndimage.minimum_filter(np.where(filled, wide, np.inf), cval=np.inf, **under)
    centres = ndimage.binary_dilation(filled, disk(OVERHANG))
    opened = ndimage.maximum_filter(np.where(centres, lowest, -np.inf), cval=-np.inf, **under)
    inner = np.where(filled, opened, EMPTY)[pad:-pad, pad:-pad]
    return inner.astype(np.int32)


def rough(rows: int, columns: int, empty: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    heights = rng.integers(-5000, 5000, (rows, columns)).astype(np.int32)
    heights[rng.random((rows, columns)) < empty] = EMPTY
    return heights


def open_with_disk(heights: np.ndarray, radius: float) -> np.ndarray:
    return steepest_drops(heights, [radius], 0.0)[1]


@pytest.mark.parametrize("radius", RADII)
def test_minimum_is_that_of_scipy(radius: float) -> None:
    heights = rough(40, 61, 0.3)
    expected = ndimage.minimum_filter(
        heights, footprint=disk(radius), mode="constant", cval=EMPTY
    )
    np.testing.assert_array_equal(disk_minimum(heights, radius), expected)


@pytest.mark.parametrize("empty", [0.0, 0.4, 0.98])
@pytest.mark.parametrize("radius", RADII[1:])
def test_opening_is_that_of_scipy(radius: float, empty: float) -> None:
    heights = rough(40, 61, empty)
    np.testing.assert_array_equal(
        open_with_disk(heights, radius), opened_by_scipy(heights, radius)
    )


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (3, 4)])
def test_disks_larger_than_the_raster(shape: tuple[int, int]) -> None:
    heights = rough(*shape, 0.2, seed=3)
    np.testing.assert_array_equal(open_with_disk(heights, 18), opened_by_scipy(heights, 18))


def test_an_array_of_any_layout() -> None:
    heights = rough(30, 20, 0.2)
    np.testing.assert_array_equal(open_with_disk(heights.T, 4), open_with_disk(heights, 4).T)
    ratio, opened = steepest_drops(heights.T, (1, 2), 0.0)
    expected = steepest_drops(heights, (1, 2), 0.0)
    np.testing.assert_array_equal(ratio, expected[0].T)
    np.testing.assert_array_equal(opened, expected[1].T)


def test_an_opening_lowers_only_and_once() -> None:
    heights = rough(50, 50, 0.3)
    opened = open_with_disk(heights, 4)
    assert ((opened == EMPTY) == (heights == EMPTY)).all()
    assert (opened <= heights).all()
    np.testing.assert_array_equal(open_with_disk(opened, 4), opened)


def test_terrain_stays_and_a_house_goes_whatever_is_missing_around_it() -> None:
    heights = np.full((60, 60), 100, np.int32)
    heights[20:30, 20:30] = 600
    heights[::2, 1::3] = EMPTY
    heights[35:45, 10:50] = EMPTY
    opened = open_with_disk(heights, 8)
    assert (opened[heights != EMPTY] == 100).all()


def test_a_house_cut_by_the_border_goes() -> None:
    heights = np.full((60, 60), 100, np.int32)
    heights[:8, 20:30] = 600
    assert (open_with_disk(heights, 9) == 100).all()


def test_neither_empty_rows_nor_data_beyond_reach_change_anything() -> None:
    whole = rough(90, 100, 0.3)
    radii = (1.0, 2.0, 3.0)
    steepest, opened = steepest_drops(whole, radii, 10.0)
    ratio, lowered = steepest_drops(np.pad(whole, 5, constant_values=EMPTY), radii, 10.0)
    np.testing.assert_array_equal(lowered[5:-5, 5:-5], opened)
    np.testing.assert_array_equal(ratio[5:-5, 5:-5], steepest)
    reach = 2 * int(radii[-1])
    part = np.s_[20 : 70 + reach, 30 - reach : 60]
    ratio, lowered = steepest_drops(whole[part], radii, 10.0)
    inner = np.s_[reach:-reach, reach:-reach]
    np.testing.assert_array_equal(lowered[inner], opened[part][inner])
    np.testing.assert_array_equal(ratio[inner], steepest[part][inner])


def test_steepest_drop_is_the_threshold_that_some_opening_exceeds() -> None:
    heights = rough(40, 40, 0.2)
    radii, allowance = (1.0, 2.0, 4.0), 50.0
    steepest, last = steepest_drops(heights, radii, allowance)
    for slope in (0.0, 300.0, 1000.0):
        dropped = np.zeros(heights.shape, bool)
        before = heights
        for radius in radii:
            after = opened_by_scipy(heights, radius)
            dropped |= before.astype(float) - after > allowance + slope * radius
            before = after
        filled = heights != EMPTY
        np.testing.assert_array_equal((steepest > slope)[filled], dropped[filled])
        np.testing.assert_array_equal(last, before)


def points(n: int = 2000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    x, y = rng.integers(0, 40_000, (2, n)).astype(np.int32)
    return x, y, rng.integers(0, 9000, n).astype(np.int32)


def test_lowest_chosen_point_of_each_cell() -> None:
    x, y, z = points()
    which = z > 1000
    heights = CellRaster(x, y, CellLattice.of(1.0, Scale())).lowest(z, which)
    expected = np.full((40, 40), EMPTY, np.int32)
    np.minimum.at(expected, (y[which] // 1000, x[which] // 1000), z[which])
    np.testing.assert_array_equal(heights, expected)


def test_cells_are_those_of_the_lattice_wherever_local_coordinates_start() -> None:
    x, y, z = points()
    shift_x, shift_y = 12_345, -6_789
    every = np.ones(z.size, bool)
    here = CellRaster(x, y, CellLattice.of(1.0, Scale()))
    there = CellRaster(
        x - shift_x, y - shift_y, CellLattice.of(1.0, Scale(origin=(shift_x, shift_y)))
    )
    np.testing.assert_array_equal(here.lowest(z, every), there.lowest(z, every))
    np.testing.assert_array_equal(here.keys, there.keys)
    # A point far off moves the raster's corner: the others still drop as they did.
    more = CellRaster(
        np.append(x, -31_000), np.append(y, -27_500), CellLattice.of(1.0, Scale())
    )
    heights = more.lowest(np.append(z, 0), np.ones(z.size + 1, bool))
    alone = steepest_drops(here.lowest(z, every), (1, 2, 3), 0.0)[0].ravel()[here.keys]
    joined = steepest_drops(heights, (1, 2, 3), 0.0)[0].ravel()[more.keys[:-1]]
    np.testing.assert_array_equal(alone, joined)
