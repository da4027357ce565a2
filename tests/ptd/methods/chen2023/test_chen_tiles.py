"""`chen2023` over windows and tiles: unmarked labels equal the untiled ones, and so do the statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ptd.frame import Window
from ptd.methods.chen2023.method import Chen2023
from ptd.passes import Points
from tests.ptd.scenes import CM, SCENES, Cloud
from tests.ptd.tiling import classify_tiled
from tests.scenes.windows import SCALE, SIDE, cut, opened

SMALL = Chen2023(robust_cells=False, max_building_size_m=8.0, rounds=2)
STATE = {"tails": [-30, 60]}


def run(params: Chen2023, cloud: Cloud, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Labels and marks of the second pass."""
    return (
        params.passes[1].fit(Points(cloud), window, window, SCALE, STATE).label(Points(cloud))
    )


def random_case(seed: int) -> tuple[Chen2023, Cloud, Window]:
    """Small windows and cells; rough ground, holes, lattices, all kinds of parameters."""
    rng = np.random.default_rng(seed)
    n, step = int(rng.integers(1500, 6000)), int(rng.choice([1, 1, 100, 250]))
    cloud = (rng.integers(0, SIDE, (3, n)) // step * step).astype(np.int32)
    x, y = cloud[:2] / CM
    z = (
        rng.choice([0, 8]) * (x // 17 % 2)
        + 3 * np.sin(x / 9)
        + rng.choice([0.3, 1.5, 4.0]) * rng.random(n)
    )
    z[rng.random(n) < 0.05] += rng.uniform(-9, 9)
    cloud[2] = np.rint(z * CM)
    centre, radius = rng.integers(0, SIDE, (2, 1)), rng.choice([0, 0.2, 0.4]) * SIDE
    cloud = cloud[:, ((cloud[:2] - centre) ** 2).sum(axis=0) >= radius**2]
    exponential = bool(rng.random() < 0.3)
    params = Chen2023(
        robust_cells=False,
        max_building_size_m=float(rng.choice([2.0, 3.0, 4.5])),
        initial_window=2 if exponential else 1,
        exponential_windows=exponential,
        thin_cell_m=float(rng.choice([0.7, 1.0, 2.0])),
        terrain_angle_deg=float(rng.choice([30, 88])),
        iteration_angle_deg=float(rng.choice([6, 6, 25])),
        mean_layers=int(rng.choice([0, 2, 5])),
        low_radius_m=float(rng.choice([1.0, 2.5])),
        low_depth_m=2.0,
        low_group=int(rng.choice([0, 5])),
        long_side=float(rng.choice([0.0, 0.7, 1.5])),
        narrow_angle_deg=float(rng.choice([15, 30, 45])),
        cluster_seeds=int(rng.choice([0, 5, 50])),
        prominence_m=0.3,
        rounds=int(rng.choice([0, 1, 1, 2])),
        label_pass=bool(rng.random() < 0.7),
    )
    (west, south), (wide, high) = (
        rng.integers(0, SIDE, 2),
        rng.integers(SIDE // 4, SIDE // 2, 2),
    )
    return (
        params,
        cloud,
        Window(int(west - wide), int(south - high), int(west + wide), int(south + high)),
    )


def share_marked(seed: int) -> float:
    params, cloud, window = random_case(seed)
    truth, marks = run(params, cloud, Window.everything())
    assert not marks.any()
    window = opened(cloud, window)
    inside = cut(cloud, window)
    labels, marked = run(params, cloud[:, inside], window)
    wrong = ~marked & (labels != truth[inside])
    assert not wrong.any(), f"{wrong.sum()} of {wrong.size} unmarked labels differ in {window}"
    return float(marked.mean()) if marked.size else 0.0


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_any_window(seed: int) -> None:
    share_marked(seed)


CITY = Chen2023(robust_cells=False, max_building_size_m=16.0, rounds=2, low_radius_m=3.0)


@pytest.mark.parametrize("scene", ["hills_with_houses", "voids", "islands", "blunders"])
def test_tiles_agree_with_the_whole_and_marks_fall_with_the_halo(scene: str) -> None:
    cloud = SCENES[scene](np.random.default_rng(11))
    cloud[2, 5], cloud[2, 77] = 90_000, -80_000  # tails
    points = Points(cloud)
    truth, marks, state = classify_tiled(points, SCALE, CITY, None)
    assert not marks.any()
    shares = []
    for halo in (0.0, 40.0, 120.0):
        labels, marks, tiled = classify_tiled(points, SCALE, CITY, 70.0, halo)
        assert tiled == state
        assert np.array_equal(labels[~marks], truth[~marks])
        shares.append(marks.mean())
    assert shares[0] >= shares[1] >= shares[2]
    assert shares[2] < 0.02


@pytest.mark.parametrize("tile_m", [33.0, 50.0, 300.0])
def test_the_statistics_are_those_of_one_tile(tile_m: float) -> None:
    """This holds without a halo, and for candidates' cells that nest neither in tiles nor in the ring's cells."""
    cloud = SCENES["blunders"](np.random.default_rng(3))
    cloud[2, ::2300] -= 6_000
    params = replace(CITY, thin_cell_m=0.7, low_radius_m=1.0)
    _, _, whole = classify_tiled(Points(cloud), SCALE, params, None)
    _, _, tiled = classify_tiled(Points(cloud), SCALE, params, tile_m)
    assert tiled == whole
    assert whole["tails"][0] > -60
    assert len(whole["notes"]) == 1
