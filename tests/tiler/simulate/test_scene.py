"""The simulated scenes: true labels, honest geometry, reproducible."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.errors import ConfigError
from tiler.simulate import SCENES, AlsSensor, Terrain, scan, scene_points
from tiler.simulate.objects import Crown, Objects, Solid
from tiler.simulate.scenes import build_scene
from tiler.simulate.terrain import Bank, Embankment, Hill

CLEAN = AlsSensor(overlap_m=0.0, sigma_m=0.0, low_singles_km2=0, low_groups_km2=0, high_km2=0)
BOX = (0.0, 0.0, 60.0, 60.0)


def rng() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(9))


def test_terrain_is_the_sum_of_its_features():
    dam = Embankment(0, 50, 0.0, height=4, crest_width=6, slope_width=8)
    assert Terrain(10, (0.1, 0.2)).height_at(10.0, 5.0) == pytest.approx(12)
    assert dam.height_at(np.array([3.0, 3.0, 3.0]), np.array([52.9, 57.0, 61.1])) == pytest.approx([4, 2, 0])
    assert Hill(0, 0, 8, 20).height_at(np.array([20.0]), np.array([0.0]))[0] == pytest.approx(
        8 * np.exp(-0.5)
    )
    bank = Bank(30, drop=6, width=2, swing=0, period=100)
    assert bank.height_at(np.array([0.0, 30.0, 60.0]), np.zeros(3)) == pytest.approx([0, -3, -6], abs=1e-6)


@pytest.mark.parametrize("kind", sorted(SCENES))
def test_ground_points_lie_on_the_terrain(kind):
    xyz, labels = scene_points(kind, seed=4, side_m=120.0, sensor=CLEAN)
    ground = labels == 2
    truth = build_scene(kind, 4, 120.0).terrain.height_at(xyz[:, 0], xyz[:, 1])
    assert ground.sum() > 1000
    assert np.abs(xyz[ground, 2] - truth[ground]).max() < 0.002
    assert np.all(xyz[np.isin(labels, (5, 6)), 2] > truth[np.isin(labels, (5, 6))] - 0.01)
    assert set(np.unique(labels)) <= {1, 2, 5, 6}
    assert ((xyz[:, :2] >= 0) & (xyz[:, :2] < 120)).all()


def test_the_same_seed_gives_the_same_points():
    one, two, other = (scene_points("city", seed, 100.0)[0] for seed in (1, 1, 2))
    assert one.tobytes() == two.tobytes()
    assert one.shape != other.shape or not np.array_equal(one, other)


def test_noise_has_the_sigma_of_the_sensor_and_blunders_their_labels():
    sensor = AlsSensor(sigma_m=0.05, low_singles_km2=5_000, low_groups_km2=2_000, high_km2=5_000)
    xyz, labels = scene_points("plane", 1, 100.0, sensor)
    above = xyz[:, 2] - Terrain(100.0, (0.05, -0.03)).height_at(xyz[:, 0], xyz[:, 1])
    assert above[labels == 2].std() == pytest.approx(0.05, rel=0.05)
    assert above[labels == 7].max() < -1
    assert above[labels == 18].min() >= 20
    assert (labels == 7).sum() > 60 < (labels == 18).sum() + 30


def test_a_gabled_house_hides_the_ground_and_has_its_roof():
    house = Solid(30, 30, 35.0, length=20, width=10, base=95, top=110, pitch=0.8)
    returns = scan(Terrain(100.0), Objects(solids=(house,)), CLEAN, BOX, rng())
    roof = returns.xyz[returns.label == 6]
    turn = np.radians(35.0)
    across = np.abs((roof[:, 1] - 30) * np.cos(turn) - (roof[:, 0] - 30) * np.sin(turn))
    along = np.abs((roof[:, 0] - 30) * np.cos(turn) + (roof[:, 1] - 30) * np.sin(turn))
    assert across.max() < 5.001
    assert along.max() < 10.001
    on_roof = np.abs(roof[:, 2] - (110 - 0.8 * across)) < 0.001
    on_wall = (np.abs(across - 5) < 0.001) | (np.abs(along - 10) < 0.001)
    assert np.all(on_roof | on_wall)
    assert on_roof.mean() > 0.8
    assert len(roof) == pytest.approx(4 * 200, rel=0.1)
    ground = returns.xyz[returns.label == 2]
    u = (ground[:, 0] - 30) * np.cos(turn) + (ground[:, 1] - 30) * np.sin(turn)
    v = (ground[:, 1] - 30) * np.cos(turn) - (ground[:, 0] - 30) * np.sin(turn)
    assert not np.any((np.abs(u) < 10) & (np.abs(v) < 5))


def test_a_crown_gives_several_returns_and_lets_pulses_through():
    crown = Crown(30, 30, 112, radius=8, half_height=3)
    returns = scan(Terrain(100.0), Objects(crowns=(crown,)), CLEAN, BOX, rng())
    x, y, z = returns.xyz[returns.label == 5].T
    assert ((((x - 30) ** 2 + (y - 30) ** 2) / 64 + (z - 112) ** 2 / 9) <= 1.0001).all()
    assert returns.count.max() >= 3
    assert np.all(returns.number <= returns.count)
    under = (returns.label == 2) & (np.hypot(returns.xyz[:, 0] - 30, returns.xyz[:, 1] - 30) < 5)
    assert 10 < under.sum() < 4 * np.pi * 25
    assert np.all(returns.number[under] == returns.count[under])
    assert np.mean(returns.number == 1) == pytest.approx(4 * 3600 / len(returns.label), rel=0.02)


def test_boxes_side_by_side_have_the_density_once():
    scene = build_scene("hills", 2, 120.0)
    parts = [
        scan(scene.terrain, scene.objects, CLEAN, (x, 0.0, x + 40.0, 120.0), rng()) for x in (40.0, 80.0)
    ]
    assert [len(p.label) for p in parts] == pytest.approx([4 * 40 * 120] * 2, rel=0.03)


def test_strips_overlap_without_a_gap_on_high_ground():
    high = Terrain(100.0, (0.0, 0.0), (Hill(300, 30, 25, 500),))
    returns = scan(
        high,
        Objects(),
        AlsSensor(sigma_m=0.0, low_singles_km2=0, high_km2=0),
        (250.0, 0.0, 350.0, 60.0),
        rng(),
    )
    x = np.sort(returns.xyz[:, 0])
    assert np.diff(x).max() < 0.4  # the pattern's own step, jittered
    assert len(x) > 4.2 * 100 * 60


def test_an_unknown_scene_is_refused():
    with pytest.raises(ConfigError, match="unknown scene 'moon': choose one of city, plane"):
        scene_points("moon")
