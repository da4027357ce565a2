"""Low noise below a dense layer is found; what the ground does below others is not."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.cells import Xyz
from ptd.frame import Scale
from ptd.ground import low_noise as module
from ptd.ground.low_noise import REACH_M, low_noise

SIDE_M = 40.0
FOOT = Fraction(12, 39_370)


def ground(density_m2: float = 8.0, slope: float = 0.0, seed: int = 1) -> np.ndarray:
    """Ground of 40 m x 40 m with 2 cm of noise, in metres: float64 [n, 3]."""
    rng = np.random.default_rng(seed)
    x, y = SIDE_M * rng.random((2, round(density_m2 * SIDE_M**2)))
    return np.stack([x, y, slope * x + rng.normal(0, 0.02, x.size)], axis=1)


def found(xyz: np.ndarray, scale: Scale | None = None) -> np.ndarray:
    scale = scale or Scale()
    unit = float(scale.metres_xy)
    return low_noise(Xyz(*np.ascontiguousarray(np.rint(xyz.T / unit).astype(np.int32))), scale)


@pytest.mark.parametrize("scale", [Scale(), Scale(FOOT / 100, FOOT / 100, (-17, 3))])
@pytest.mark.parametrize(("density_m2", "slope"), [(4.0, 0.0), (8.0, 0.3), (60.0, 0.0)])
def test_single_points_of_every_depth_are_noise(
    density_m2: float, slope: float, scale: Scale
) -> None:
    xyz = ground(density_m2, slope)
    low = np.array([[x, y, slope * x - x / 6.0] for x in (6, 15, 24, 33) for y in (8, 20, 32)])
    both = np.concatenate([xyz, low + 0.05])
    noise = found(both, scale)
    assert not noise[: len(xyz)].any()
    assert noise[len(xyz) :].all()


@pytest.mark.parametrize("depth_m", [1.0, 4.0])
def test_clumps_and_mirrored_planes_are_noise(depth_m: float) -> None:
    rng = np.random.default_rng(3)
    clump = np.append(rng.uniform([8, 8], [10, 10], (12, 2)), np.full((12, 1), -depth_m), 1)
    plane = rng.uniform([18, 2], [30, 38], (round(0.3 * 8 * 12 * 36), 2))
    plane = np.append(plane, rng.normal(-depth_m, 0.03, (len(plane), 1)), 1)
    xyz = ground()
    noise = found(np.concatenate([xyz, clump, plane]))
    assert noise[: len(xyz)].sum() == 0
    assert noise[len(xyz) :][:12].mean() >= 0.9
    assert noise[len(xyz) + 12 :].mean() >= 0.95


@pytest.mark.parametrize("depth_m", [1.5, 5.0])
def test_clumps_denser_than_the_ground_are_noise(depth_m: float) -> None:
    """The points above the lowest one of a clump are no layer, or the lowest; the ground above is."""
    rng = np.random.default_rng(6)
    clump = rng.uniform([20, 20, -depth_m], [21, 21, 0.6 - depth_m], (30, 3))
    xyz = ground()
    noise = found(np.concatenate([xyz, clump]))
    assert not noise[: len(xyz)].any()
    assert noise[len(xyz) :].mean() >= 0.9


def clump(centre: tuple[float, float, float], points: int, seed: int = 8) -> np.ndarray:
    """A few points within about a metre: float64 [n, 3]."""
    return np.random.default_rng(seed).normal(centre, (0.4, 0.4, 0.08), (points, 3))


def test_small_clumps_beside_others_are_noise() -> None:
    """Each level is thin, but the wide level of a point also holds the other clumps."""
    xyz = ground()
    low = [clump((20, y, -3.3), 3) for y in (18.0, 20.5, 23.0)]
    noise = found(np.concatenate([xyz, *low]))
    assert not noise[: len(xyz)].any()
    assert noise[len(xyz) :].all()


def test_clumps_among_plants_are_noise() -> None:
    """A third of the points is ground, too few for a layer in a disc."""
    xyz = ground(9.0)
    plants = np.random.default_rng(9).random(len(xyz)) < 0.65
    xyz[plants, 2] += np.random.default_rng(10).uniform(0.5, 3.0, int(plants.sum()))
    noise = found(np.concatenate([xyz, clump((20, 20, -2.5), 6)]))
    assert not noise[: len(xyz)].any()
    assert noise[len(xyz) :].all()


def test_little_ground_below_sloping_crowns_is_no_noise() -> None:
    """A layer in a wider disc slopes, so hardly any ground is as high along it as a point."""

    def grid(step_m: float, slope: float = 0.0) -> np.ndarray:
        x, y = np.mgrid[1.0:SIDE_M:step_m, 1.0:SIDE_M:step_m].reshape(2, -1)
        return np.stack([x, y, slope * x], axis=1)

    layer, crowns, seen = grid(0.66, 0.8), ground(6.0, slope=0.8), grid(2.3)
    crowns[:, 2] += np.random.default_rng(12).uniform(1, 9, len(crowns))
    noise = found(np.concatenate([layer + [0, 0, 8], crowns + [0, 0, 8], seen]))
    assert noise[-len(seen) :].mean() < 0.03


def test_levels_of_the_sparsest_places_reach_no_farther_cell_than_stated() -> None:
    assert module._level_radius_m(module.MIN_DENSITY_M2) <= module.LEVEL_CELLS * module.CELL_M


def dug(xyz: np.ndarray) -> np.ndarray:
    """A ditch of 1.2 m width, a sunken lane, and a shaft of 3 m width and 6 m depth."""
    x, y, z = xyz.T
    z = z - 1.0 * (abs(x - 8) < 0.6) - 3.0 * (abs(x - 20) < 3)
    return np.stack([x, y, z - 6.0 * (np.hypot(x - 32, y - 20) < 1.5)], axis=1)


def roofed(xyz: np.ndarray, share: float, height_m: float, wide: np.ndarray) -> np.ndarray:
    """A roof that a share of the pulses does not pass."""
    out = xyz.copy()
    out[wide & (np.random.default_rng(4).random(len(xyz)) < share), 2] += height_m
    return out


@pytest.mark.parametrize("density_m2", [4.0, 12.0])
def test_ditches_lanes_and_shafts_are_no_noise(density_m2: float) -> None:
    assert not found(dug(ground(density_m2))).any()


def test_ground_below_glass_bridges_and_eaves_is_no_noise() -> None:
    xyz = ground()
    middle = abs(xyz[:, 0] - 20) < 9
    glass = roofed(xyz, 0.45, 4.0, middle & (abs(xyz[:, 1] - 20) < 14))
    assert found(glass).mean() < 0.001
    # A fifth of the pulses passes these slats, but the ground goes on beside them.
    slats = roofed(xyz, 0.8, 3.0, abs(xyz[:, 0] - 20) < 3)
    assert not found(slats).any()
    bridge = roofed(xyz, 1.0, 6.0, middle)
    seen = ground(3.0, seed=2)
    beside = (abs(seen[:, 0] - 20) < 9) & (abs(seen[:, 0] - 20) > 8)
    assert not found(np.concatenate([bridge, seen[beside]])).any()


def test_ground_below_a_forest_is_no_noise() -> None:
    xyz = ground(10.0, slope=0.1)
    rng = np.random.default_rng(5)
    crowns = rng.random(len(xyz)) < 0.85
    xyz[crowns, 2] += rng.uniform(4, 18, int(crowns.sum()))
    assert not found(xyz).any()


def test_nothing_is_found_in_sparse_clouds_or_without_points() -> None:
    sparse = np.concatenate([ground(0.8), [[20.0, 20.0, -3.0]]])
    assert not found(sparse).any()
    assert found(np.zeros((0, 3))).size == 0


def raw(seed: int) -> np.ndarray:
    """Ground with low singles, clumps, a plane and plants."""
    rng = np.random.default_rng(seed)
    singles = np.column_stack([SIDE_M * rng.random((60, 2)), rng.uniform(-6, -0.3, 60)])
    centres = rng.uniform(2, 38, (5, 2)).repeat(20, axis=0)
    clumps = np.column_stack([centres + rng.uniform(-1, 1, (100, 2)), np.full(100, -3.0)])
    plane = np.column_stack([rng.uniform([0, 10], [40, 20], (900, 2)), np.full(900, -4.0)])
    plants = ground(2.0, seed=seed) + [0, 0, 1.0]
    return np.concatenate([ground(seed=seed), singles, clumps, plane, plants])


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 99), st.floats(0.0, 39.0), st.floats(0.0, 39.0))
def test_neither_order_nor_what_lies_beyond_the_reach_matters(
    seed: int, west: float, south: float
) -> None:
    xyz = raw(seed)
    whole = found(xyz)
    order = np.random.default_rng(seed).permutation(len(xyz))
    assert np.array_equal(found(xyz[order]), whole[order])
    low, high = np.array([west, south]), np.array([west + 5.0, south + 5.0])
    place = xyz[:, :2]
    seen = ((place >= low - REACH_M) & (place <= high + REACH_M)).all(axis=1)
    core = ((place >= low) & (place <= high)).all(axis=1)
    assert np.array_equal(found(xyz[seen])[core[seen]], whole[core])


def test_distant_points_are_searched_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    xyz = raw(7)
    whole = found(xyz)
    monkeypatch.setattr(module, "BLOCK_CELLS", 10)
    assert np.array_equal(found(xyz), whole)
    far = np.concatenate([xyz, xyz + [50_000.0, 0.0, 0.0]])
    assert np.array_equal(found(far), np.tile(whole, 2))
