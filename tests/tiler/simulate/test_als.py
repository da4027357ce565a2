"""The laser scanner: true labels and geometry, returns in order, independent patches."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.simulate import AlsSensor, Site, Terrain, make_site, survey
from tiler.simulate.objects import Crown, Objects, PlantPatch, Solid, Wire
from tiler.simulate.points import SimulatedPoints, survey_patch
from tiler.simulate.sites import SITES
from tiler.simulate.terrain import Hill, Line, River

CLEAN = AlsSensor(overlap_m=0.0, sigma_m=0.0, low_singles_km2=0, low_groups_km2=0, high_km2=0)


def scan(
    objects: Objects, terrain: Terrain | None = None, sensor: AlsSensor = CLEAN
) -> SimulatedPoints:
    """Points of 60 x 60 m, all in one patch."""
    return survey_patch(
        Site(terrain or Terrain(100.0), 60.0, 9, landmarks=objects), sensor, 0, 0
    )


@pytest.mark.parametrize("kind", sorted(SITES))
def test_ground_points_lie_on_the_terrain_and_objects_above_it(kind):
    site = make_site(kind, 4, 100.0)
    points = survey_patch(site, CLEAN, 0, 0)
    above = points.xyz[:, 2] - site.terrain.height_at(points.xyz[:, 0], points.xyz[:, 1])
    ground = points.label == 2
    assert ground.sum() > 1000
    # x and y are rounded to a millimetre, which is up to 20 mm of height on the face of a wall.
    assert np.quantile(np.abs(above[ground]), 0.99) < 0.003
    assert np.abs(above[ground]).max() < 0.02
    # Water may have waves, and returns that seem to come from below it.
    assert above[~np.isin(points.label, (2, 7, 9))].min(initial=0.0) > -0.02
    assert set(np.unique(points.label)) <= {1, 2, 3, 4, 5, 6, 7, 9, 14, 15, 17}
    assert ((points.xyz[:, :2] >= 0) & (points.xyz[:, :2] < (100, site.north_m))).all()


def test_noise_has_the_sigma_of_the_sensor_and_blunders_their_labels():
    sensor = AlsSensor(
        sigma_m=0.05, low_singles_km2=5_000, low_groups_km2=2_000, high_km2=5_000
    )
    site = make_site("plane", 1, 100.0)
    points = survey_patch(site, sensor, 0, 0)
    above = points.xyz[:, 2] - site.terrain.height_at(points.xyz[:, 0], points.xyz[:, 1])
    assert above[points.label == 2].std() == pytest.approx(0.05, rel=0.07)
    assert above[points.label == 7].max() < -1
    assert above[points.label == 18].min() >= 20
    assert (points.label == 7).sum() > 60 < (points.label == 18).sum() + 30


def test_density_is_that_of_pulses_once_outside_overlaps_and_twice_within():
    points = survey(make_site("plane", 1, 340.0), AlsSensor(density=2.0, overlap_m=40.0))
    x = points.xyz[:, 0]
    assert np.sum(x < 250) / (250 * 340) == pytest.approx(2 * 0.99 * (1 + 20 / 250), rel=0.03)
    assert np.sum((x > 285) & (x < 315)) / (30 * 340) == pytest.approx(4 * 0.99, rel=0.03)


def test_a_gabled_house_hides_the_ground_and_has_its_roof():
    points = scan(
        Objects(solids=(Solid(30, 30, 35.0, length=20, width=10, base=95, top=110, pitch=0.8),))
    )
    roof = points.xyz[points.label == 6]
    along, across = (np.abs(d) for d in Line(30, 30, 35.0).along_across(roof[:, 0], roof[:, 1]))
    assert across.max() < 5.002
    assert along.max() < 10.002
    on_roof = np.abs(roof[:, 2] - (110 - 0.8 * across)) < 0.003
    on_wall = (np.abs(across - 5) < 0.002) | (np.abs(along - 10) < 0.002)
    assert np.all(on_roof | on_wall)
    assert on_roof.mean() > 0.8
    assert len(roof) == pytest.approx(4 * 200, rel=0.1)
    ground = points.xyz[points.label == 2]
    along, across = Line(30, 30, 35.0).along_across(ground[:, 0], ground[:, 1])
    assert not np.any((np.abs(along) < 9.99) & (np.abs(across) < 4.99))


def test_a_tilted_deck_lets_the_ground_be_seen_beside_it_only():
    deck = Solid(30, 30, 0.0, 40, 8, base=104, top=105, label=17, tilt=0.05)
    points = scan(Objects(solids=(deck,)))
    x, _, z = points.xyz[points.label == 17].T
    assert np.sum(np.abs(z - (105 + 0.05 * (x - 30))) < 0.002) > 0.9 * len(z) > 1000


def test_a_crown_gives_several_returns_in_order_and_lets_pulses_through():
    points = scan(Objects(crowns=(Crown(30, 30, 112, radius=8, half_height=3),)))
    x, y, z = points.xyz[points.label == 5].T
    assert ((((x - 30) ** 2 + (y - 30) ** 2) / 64 + (z - 112) ** 2 / 9) <= 1.001).all()
    assert points.count.max() >= 3
    under = (points.label == 2) & (np.hypot(points.xyz[:, 0] - 30, points.xyz[:, 1] - 30) < 5)
    assert 10 < under.sum() < 4 * np.pi * 25
    assert np.all(points.number[under] == points.count[under])
    assert np.mean(points.number == 1) == pytest.approx(0.99 * 4 * 3600 / len(points), rel=0.02)


def test_returns_of_a_pulse_follow_one_another_downward():
    points = survey_patch(make_site("forest", 4, 300.0), CLEAN, 1, 1)
    later = points.number[1:] > 1
    assert later.sum() > 1000
    assert np.all(points.number[1:][later] == points.number[:-1][later] + 1)
    assert np.all(points.count[1:][later] == points.count[:-1][later])
    assert np.all(points.xyz[1:, 2][later] < points.xyz[:-1, 2][later])
    assert np.all(points.number[np.r_[True, ~later]] == 1)
    assert np.all(points.number <= points.count)


def test_low_plants_hide_a_share_of_the_ground():
    points = scan(
        Objects(patches=(PlantPatch(30, 30, 0.0, 40, 20, height=0.6, cover=0.7, square=True),))
    )
    inside = (np.abs(points.xyz[:, 0] - 30) < 20) & (np.abs(points.xyz[:, 1] - 30) < 10)
    plants = points.label == 3
    assert np.mean(plants[inside]) == pytest.approx(0.7, abs=0.04)
    assert points.xyz[plants, 2].min() > 100.079
    assert points.xyz[plants, 2].max() < 100.601


def test_plants_are_labelled_by_their_height_above_ground():
    points = scan(
        Objects(patches=(PlantPatch(30, 30, 0.0, 50, 50, height=4.0, cover=0.9, square=True),))
    )
    above = points.xyz[:, 2] - 100.0
    for label, low, high in ((3, 0.0, 1.0), (4, 1.0, 3.0), (5, 3.0, 4.1)):
        chosen = above[points.label == label]
        assert len(chosen) > 100
        assert low - 0.001 <= chosen.min() <= chosen.max() <= high + 0.001


def test_a_wire_sags_and_lets_pulses_go_on():
    points = scan(Objects(wires=(Wire((5.0, 30.0, 120.0), (55.0, 30.0, 120.0), sag=4.0),)))
    wire = points.label == 14
    x, y, z = points.xyz[wire].T
    assert len(x) > 25
    assert z == pytest.approx(120 - 4 * (1 - ((x - 30) / 25) ** 2), abs=0.02)
    assert np.abs(y - 30).max() < 0.21
    assert np.all(points.number[wire] == 1)
    assert np.mean(points.count[wire] == 2) > 0.95


def test_water_returns_hardly_anything():
    stream = River(Line(30, 0, 90.0), width=20, depth=3, bank_width=5)
    points = scan(Objects(), Terrain(100.0, (0.0, 0.0), (stream,)))
    water = points.label == 9
    assert 0.01 < water.sum() / (4 * 20 * 60) < 0.06
    assert np.abs(points.xyz[water, 0] - 30).max() < 10.001
    assert points.xyz[water, 2] == pytest.approx(97.0)


def test_strips_overlap_without_a_gap_on_high_ground():
    high = Terrain(100.0, (0.0, 0.0), (Hill(300, 200, 25, 500),))
    points = survey(Site(high, 400.0, 1), AlsSensor(sigma_m=0.0, low_singles_km2=0, high_km2=0))
    x = np.sort(points.xyz[np.abs(points.xyz[:, 1] - 200) < 30, 0])
    assert np.diff(x[(x > 250) & (x < 350)]).max() < 0.4  # the pattern's own step, jittered
