"""The ground's surface: planes, plants, banks, what lies beyond the cells, and that it sees no farther than it says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import maximum_filter

from ptd.frame import Scale
from ptd.matched import surface
from ptd.matched.bent_hull import TRUNCATE, smoothed
from ptd.matched.cells import EMPTY
from ptd.matched.surface import EXTENDED_M, NARROWEST, Surface, ground_surface, reach_cells
from tests.scenes.village import short_sighted_surface

MM = Scale()
SIGMA_M = 0.05


def of(
    z: np.ndarray,
    terrain: np.ndarray | bool = False,
    sigma_m: float = SIGMA_M,
    margin: int = 8,
    bare: bool = False,
) -> Surface:
    """The surface of heights in metres (NaN: no cell), without the margin of empty cells that is put around them."""
    padded = np.pad(z, margin, constant_values=np.nan)
    heights = np.where(np.isnan(padded), EMPTY, np.rint(1000 * np.nan_to_num(padded))).astype(
        np.int32
    )
    whole = np.pad(np.broadcast_to(terrain, z.shape), margin)
    found = ground_surface(heights, whole, sigma_m, MM, 0, 0, bare=np.full(whole.shape, bare))
    return Surface(
        *(v[margin : margin + z.shape[0], margin : margin + z.shape[1]] for v in found)
    )


def places(side: int) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    row, column = np.mgrid[:side, :side].astype(float)
    return row, column, np.random.default_rng(side)


@pytest.mark.parametrize("slope", [0.0, 0.1, -0.5])
@pytest.mark.parametrize("taken", [0.5, 1.0, 2.0])
def test_a_noisy_plane_is_found_in_its_middle(slope: float, taken: float) -> None:
    """Whatever the noise is first taken for, within a factor of two."""
    row, column, rng = places(110)
    plane = slope * row + 0.05 * column
    found = of(plane + SIGMA_M * rng.standard_normal(plane.shape), sigma_m=taken * SIGMA_M)
    inner = np.s_[12:-12, 12:-12]
    error = (found.height - plane)[inner]
    assert abs(error.mean()) < 0.01
    assert error.std() < 0.65 * SIGMA_M  # it follows part of the noise, as it follows furrows
    if taken == 1.0:
        assert found.sigma[inner].mean() == pytest.approx(SIGMA_M, rel=0.2)
    assert found.narrowing[inner].min() > 0.8


def test_blunders_do_not_move_it() -> None:
    row, _, rng = places(110)
    z = SIGMA_M * rng.standard_normal(row.shape)
    z[rng.random(row.shape) < 0.05] += 3.0
    z[[30, 30, 31, 70, 71], [30, 31, 31, 70, 71]] = -5.0  # clumps of three and of two
    error = of(z).height[12:-12, 12:-12]
    assert abs(error).max() < 0.2
    assert error.std() < SIGMA_M


def test_plants_just_above_the_ground_narrow_the_band() -> None:
    """Half of the field holds plants of 0.1 to 0.6 m on two of three cells."""
    _, column, rng = places(128)
    z = 0.03 * rng.standard_normal(column.shape)
    plants = (column > 64) & (rng.random(column.shape) < 0.7)
    z += np.where(plants, rng.uniform(0.1, 0.6, column.shape), 0.0)
    found = of(z, sigma_m=0.03)
    assert found.narrowing[20:-20, 8:30].min() > 0.95
    assert found.narrowing[20:-20, 98:-8].mean() < 0.5
    assert found.narrowing.min() >= NARROWEST
    assert abs(found.height[20:-20, 98:-8].mean()) < 0.1


def test_trees_are_passed_below() -> None:
    """Ground is seen in one cell of ten between crowns; on the stiff hull and in the end."""
    row, column, rng = places(128)
    ground = 0.1 * row
    z = ground + 0.05 * rng.standard_normal(row.shape)
    wood = (column > 40) & (column < 88) & (rng.random(row.shape) < 0.9)
    z += np.where(wood, rng.uniform(3.0, 9.0, row.shape), 0.0)
    error = (of(z).height - ground)[16:-16, 16:-16]
    assert abs(error).max() < 0.5
    assert np.sqrt((error**2).mean()) < 0.15


@pytest.mark.parametrize("is_terrain", [True, False])
def test_a_crest_is_followed_where_it_is_terrain_as_a_whole(is_terrain: bool) -> None:
    """A dam of 3 m, 6 m wide at its top, with sides of 1 in 1."""
    row, _, rng = places(128)
    dam = np.clip(6.0 - abs(row - 64.0), 0.0, 3.0)
    z = dam + 0.03 * rng.standard_normal(row.shape)
    found = of(z, terrain=is_terrain, sigma_m=0.03)
    top = found.height[62:67, 24:-24].mean()
    assert (abs(top - 3.0) < 0.3) == is_terrain


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_a_narrow_crest_is_followed_where_it_is_steep(slope: float) -> None:
    """2 m high, 4 m wide at its top, linked to the ground: where it is level, that is a row of lorries."""
    row, column, rng = places(128)
    ground = slope * column
    z = (
        ground
        + np.clip(4.0 - abs(row - 64.0), 0.0, 2.0)
        + 0.03 * rng.standard_normal(row.shape)
    )
    top = (of(z, terrain=True, sigma_m=0.03).height - ground)[63:66, 40:-40].mean()
    assert (top > 1.7) if slope else (top < 0.4)


@pytest.mark.parametrize("step_m", [2.0, 2.7])
def test_a_terrace_is_ground_up_to_its_edge_but_not_what_stands_at_it(step_m: float) -> None:
    """Hulls reach its top metres behind the edge; a hut on it rises at its walls."""
    row, column, rng = places(128)
    ground = np.where(row > 60, step_m, 0.0)
    hut = (row > 64) & (row < 69) & (column > 60) & (column < 65)
    z = ground + np.where(hut, 2.0, 0.0) + 0.03 * rng.standard_normal(row.shape)
    error = (of(z, sigma_m=0.03).height - ground)[16:-16, 16:-16]
    level, beside = abs(row - 60.5) > 1.0, maximum_filter(hut, 5)
    assert np.mean(abs(error[(level & ~beside)[16:-16, 16:-16]]) < 0.15) > 0.98
    assert error[hut[16:-16, 16:-16]].max() < 0.5


def test_ground_is_followed_up_to_what_was_taken_out() -> None:
    """A round ridge between two roofs: open ground is a share of the cells that are left."""
    _, column, rng = places(70)
    ridge = -0.05 * (column - 35.0) ** 2
    z = ridge + 0.03 * rng.standard_normal(ridge.shape)
    z[:, :30] = z[:, 41:] = np.nan
    error = (of(z, sigma_m=0.03).height - ridge)[10:-10, 30:41]
    assert abs(error).max() < 0.25


def test_the_bends_of_a_bank_are_smoothed_less(monkeypatch: pytest.MonkeyPatch) -> None:
    row, column, rng = places(64)
    bank = 0.5 * np.clip(column - 30.0, 0.0, 6.0)
    z = bank + 0.03 * rng.standard_normal(row.shape)

    def off() -> float:
        error = (of(z, sigma_m=0.03).height - bank)[12:-12]
        return float(error[:, 30].mean() - error[:, 36].mean())  # above its foot, below its top

    fine = off()
    monkeypatch.setattr(surface, "FINE_ROUNDS", 0)
    assert 0.0 < fine < 0.85 * off()


def test_it_goes_on_beyond_its_cells_and_ends() -> None:
    z = np.full((96, 96), np.nan)
    z[32:64, 32:64] = 4.0
    height, _, narrowing = of(z)
    from_cells = np.maximum(abs(np.arange(96) - 47.5) - 15.5, 0.0)
    far = np.maximum(from_cells[:, None], from_cells)
    least, end = TRUNCATE * min(EXTENDED_M), TRUNCATE * max(EXTENDED_M)
    assert np.allclose(height[far <= end - 1], 4.0, atol=0.06)  # hulls may be 4 cm off
    assert np.isnan(height[far > end]).all()
    assert np.array_equal(np.isnan(narrowing), far > least)  # below a roof nothing is ground


def test_gaussian_sums_have_weights_of_one_and_an_end() -> None:
    found = smoothed(np.ones((41, 41)), 3.0)
    assert found[20, 20] == pytest.approx(1.0)
    assert found[0, 0] < 0.5
    one = np.zeros((41, 41))
    one[20, 20] = 1.0
    sums = smoothed(one, 3.0)
    rows, columns = np.nonzero(sums)
    assert abs(rows - 20).max() == abs(columns - 20).max() == TRUNCATE * 3
    assert sums[20, 23] / sums[20, 20] == pytest.approx(np.exp(-0.5))


@pytest.fixture
def short_sighted(monkeypatch: pytest.MonkeyPatch) -> None:
    short_sighted_surface(monkeypatch)


@pytest.mark.usefixtures("short_sighted")
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_beyond_the_reach_has_a_part(seed: int) -> None:
    """What is cut off at any multiple of the blocks changes nothing so far from the cut, bit for bit."""
    rng = np.random.default_rng(seed)
    reach = reach_cells(1.0)
    side = 2 * reach + 64
    row, column = np.mgrid[:side, :side]
    z = 2.0 * np.sin(row / 9.0) + 0.1 * column + rng.normal(0.0, 0.2, row.shape)
    z += np.where(rng.random(row.shape) < 0.2, rng.uniform(0.0, 4.0, row.shape), 0.0)
    heights = np.where(rng.random(row.shape) < 0.1, EMPTY, np.rint(1000 * z)).astype(np.int32)
    heights[rng.integers(0, side - 30) :, : rng.integers(8, 40)] = EMPTY
    terrain, bare = column > side // 2, row > side // 3
    whole = ground_surface(heights, terrain, 0.1, MM, -16, 8, bare=bare)
    south, west = (int(8 * n) for n in rng.integers(1, 5, 2))
    part = np.s_[south:-9, west:-17]
    cut = ground_surface(
        heights[part], terrain[part], 0.1, MM, -16 + south, 8 + west, bare=bare[part]
    )
    rows, columns = cut.height.shape
    inner = np.s_[reach : rows - reach, reach : columns - reach]
    assert cut.height[inner].size > 100
    for name in Surface._fields:
        assert np.array_equal(
            getattr(cut, name)[inner], getattr(whole, name)[part][inner], equal_nan=True
        )


@pytest.mark.parametrize("bare", [True, False])
def test_a_sharp_ridge_comes_back_where_no_canopy_is(bare: bool) -> None:
    """Slopes of 1.1 that meet at a height of 40 m. A hull passes below the crest."""
    _, column, rng = places(120)
    ridge = np.maximum(40.0 - 1.1 * abs(column - 60.0), 0.0)
    found = of(ridge + SIGMA_M * rng.standard_normal(ridge.shape), bare=bare)
    below = (ridge - found.height)[20:-20]
    flanks = (abs(column - 60.0) > 1) & (abs(column - 60.0) < 15)
    assert (np.mean(below[flanks[20:-20]] > 1.0) < 0.01) == bare


def test_the_sides_of_a_hall_do_not_come_back() -> None:
    """Facades as matching blurs them: 2 m wide, 8 m high. The roof was taken out before."""
    row, column, rng = places(120)
    inside = np.minimum(25.0 - abs(row - 60.0), 25.0 - abs(column - 60.0))
    hall = np.where(inside > 2.5, np.nan, np.clip(4.0 * inside, 0.0, 8.0))
    found = of(hall + SIGMA_M * rng.standard_normal(hall.shape), bare=True)
    assert np.nanmax(found.height) < 1.0


def test_edges_of_cars_lift_it_less_than_low_plants(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cars are rounded: the cells around them are 0.3 m high. Where all weigh alike they lift the surface."""
    row, column, rng = places(64)
    car = (row % 20 < 4) & (column % 16 < 4)
    edge = maximum_filter(car, 3) & ~car
    z = 1.5 * car + 0.3 * edge + 0.02 * rng.standard_normal(row.shape)
    lifted = of(z).height[edge].mean()
    monkeypatch.setattr(surface, "BESIDE", 1.0)
    assert lifted < 0.85 * of(z).height[edge].mean()
