"""Image matching: a skin with nothing below it, its noise, facades, blunders and colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tiler.simulate import DimSensor, Site, Terrain, survey
from tiler.simulate.matched_surface import (
    PIXEL_M,
    ROCK,
    SHADE,
    ground_materials,
    render_surface,
    shadows,
)
from tiler.simulate.objects import Crown, Objects, PlantPatch, Solid
from tiler.simulate.points import SimulatedPoints

SMOOTH = DimSensor(density=30.0, sigma_m=0.0, blunders=0.0, high_blunders=0.0)
HOUSE = Solid(25, 25, 0.0, length=20, width=12, base=99, top=108)


def match(
    objects: Objects,
    sensor: DimSensor = SMOOTH,
    terrain: Terrain | None = None,
    green: float = 0.6,
) -> SimulatedPoints:
    """Points of 50 x 50 m."""
    return survey(
        Site(terrain or Terrain(100.0), 50.0, 5, landmarks=objects, green=green), sensor
    )


def gli(rgb: np.ndarray) -> np.ndarray:
    red, green, blue = rgb.astype(float).T
    return (2 * green - red - blue) / (2 * green + red + blue)


def test_bare_ground_has_the_density_and_the_sigma_with_a_part_in_common():
    sensor = replace(SMOOTH, sigma_m=0.066, correlated=0.4, correlation_m=2.0)
    points = match(Objects(), sensor, Terrain(100.0, (0.1, -0.05)))
    off = points.xyz[:, 2] - (100 + 0.1 * points.xyz[:, 0] - 0.05 * points.xyz[:, 1])
    assert np.all(points.label == 2)
    assert len(points) / 2500 == pytest.approx(0.98 * 30, rel=0.02)
    assert off.std() == pytest.approx(0.066, rel=0.08)
    # Means over cells of 0.5 m keep the shared part of the noise and average the independent
    # part away.
    cell = np.floor(points.xyz[:, 0] / 0.5) * 100 + np.floor(points.xyz[:, 1] / 0.5)
    cells, members = np.unique(cell, return_inverse=True)
    means = np.bincount(members, off) / np.bincount(members)
    alone = 0.6 / (len(off) / len(cells))
    assert means.std() == pytest.approx(0.066 * np.sqrt(0.36 + alone), rel=0.15)


def test_noise_grows_in_shadow_and_without_texture_and_its_tails_are_those_of_students_t():
    site = Site(Terrain(100.0), 50.0, 5, landmarks=Objects(solids=(HOUSE,)), green=0.0)
    sensor = replace(SMOOTH, sigma_m=0.1, correlated=0.0, shadow=3.0, facade=0.0)
    x, y, z = survey(site, sensor).xyz.T
    shaded, sunny = (np.abs(x - 26) < 6) & (y > 31.8) & (y < 33), y < 14
    assert z[shaded].std() == pytest.approx(0.3, rel=0.15)
    assert z[sunny].std() == pytest.approx(0.1, rel=0.03)
    bare = Site(Terrain(100.0), 50.0, 5)
    x, y, z = survey(bare, replace(sensor, textureless=2.0, textureless_share=0.25)).xyz.T
    assert (
        0.0125 < z.var() < 0.0225
    )  # about a quarter of a hundred random patches has four times the variance
    z = survey(bare, replace(sensor, tails=6.0)).xyz[:, 2] - 100
    assert z.std() == pytest.approx(0.1, rel=0.03)
    assert np.mean(z**4) / z.var() ** 2 > 4.0  # 3 if normal, 6 in the limit


def test_a_mesh_is_regular_and_may_have_no_colours():
    points = match(Objects(), replace(SMOOTH, density=4.0, jitter=0.2, coloured=False))
    off = points.xyz[:, :2] / 0.5 % 1.0
    assert off.min() >= 0.4 - 0.002
    assert off.max() <= 0.6 + 0.002
    assert points.rgb is None


def test_plants_that_are_too_low_are_ground_but_not_what_a_crown_lifts():
    low = PlantPatch(15, 25, 0.0, 20, 40, height=0.3, cover=0.9, square=True)
    crown = Crown(35, 25, 106, radius=6, half_height=5)
    points = match(
        Objects(patches=(low,), crowns=(crown,)), replace(SMOOTH, edge_m=0.6, plants_m=0.3)
    )
    x, y, z = points.xyz.T
    assert np.all(points.label[x < 24] == 2)
    assert z[points.label == 2].max() < 100.5
    assert np.all(points.label[np.hypot(x - 35, y - 25) < 5] == 5)


def test_nothing_lies_below_a_crown():
    points = match(Objects(crowns=(Crown(25, 25, 106, radius=6, half_height=5),)))
    middle = np.hypot(points.xyz[:, 0] - 25, points.xyz[:, 1] - 25) < 5
    assert np.all(points.label[middle] == 5)
    assert points.xyz[middle, 2].min() > 105
    assert points.xyz[:, 2].max() < 111.01
    assert np.all(points.number == 1)
    assert np.all(points.count == 1)


def test_edges_of_a_roof_are_smoothed_and_what_they_lift_is_no_ground():
    points = match(Objects(solids=(HOUSE,)), replace(SMOOTH, facade=0.0))
    x, y, z = points.xyz.T
    outside = np.hypot(np.maximum(np.abs(x - 25) - 10, 0), np.maximum(np.abs(y - 25) - 6, 0))
    assert np.abs(z[outside > 1.7] - 100).max() < 0.01
    inside = (np.abs(x - 25) < 8.3) & (np.abs(y - 25) < 4.3)
    assert np.abs(z[inside] - 108).max() < 0.01
    between = (z > 101) & (z < 107)
    assert between.sum() > 100
    assert np.all(points.label[between] == 6)
    ground = points.label == 2
    assert z[ground].max() < 100.5
    assert np.quantile(z[ground], 0.99) < 100.201


def test_facades_are_vertical_and_on_some_walls_only():
    points = match(Objects(solids=(HOUSE,)), replace(SMOOTH, edge_m=0.01, facade=0.5))
    x, y, z = points.xyz.T
    wall = (points.label == 6) & (z < 107.5)
    off = np.maximum(np.abs(x - 25) - 10, np.abs(y - 25) - 6)
    assert wall.sum() > 100
    assert np.abs(off[wall]).max() < 0.5
    assert z[wall].min() > 99.99
    sides = [np.sum(wall & side) for side in (x > 34.5, x < 15.5, y > 30.5, y < 19.5)]
    assert min(sides) < 0.5 * max(sides)


def test_low_plants_are_a_surface_above_the_ground():
    points = match(
        Objects(patches=(PlantPatch(25, 25, 0.0, 30, 20, height=0.8, cover=0.9, square=True),))
    )
    inside = (np.abs(points.xyz[:, 0] - 25) < 12) & (np.abs(points.xyz[:, 1] - 25) < 7)
    assert np.mean(points.label[inside] == 3) > 0.7
    above = points.xyz[points.label == 3, 2] - 100
    assert above.min() > 0.03
    assert above.max() < 0.65


def test_blunders_lie_below_the_ground_alone_and_in_clumps():
    sensor = replace(SMOOTH, density=60.0, blunders=0.01, high_blunders=0.001)
    points = match(Objects(), sensor)
    low = points.label == 7
    assert low.sum() / len(points) == pytest.approx(0.01, rel=0.35)
    assert (points.xyz[low, 2] - 100).min() > -9.5
    assert (points.xyz[low, 2] - 100).max() <= -0.39
    near = np.linalg.norm(points.xyz[low][:, None] - points.xyz[low][None], axis=2) < 1.5
    company = near.sum(axis=1)
    assert np.sum(company == 1) > 50
    assert np.sum(company >= 5) > 200
    assert points.xyz[points.label == 18, 2].min() > 102.9


def test_crowns_and_lawns_are_green_and_roofs_and_streets_are_not():
    site = Site(
        Terrain(100.0),
        100.0,
        5,
        street_m=5.0,
        green=1.0,
        landmarks=Objects(solids=(HOUSE,), crowns=(Crown(75, 75, 106, 6, 5),)),
    )
    points = survey(site, DimSensor(density=20.0))
    index = gli(points.rgb)
    x, y = points.xyz[:, 0], points.xyz[:, 1]
    street = (points.label == 2) & (np.abs(x - 50) < 4)
    lawn = (points.label == 2) & (np.abs(x - 25) < 18) & (np.abs(y - 75) < 18)
    roof = (points.label == 6) & (points.xyz[:, 2] > 107)
    assert np.median(index[points.label == 5]) > 0.1
    assert np.median(index[lawn]) > 0.08
    assert abs(np.median(index[street])) < 0.03
    assert np.median(index[roof]) < 0.03
    assert points.rgb.dtype == np.uint16
    assert points.rgb.max() > 2**15


def test_shadows_fall_to_the_north_east_and_are_dark():
    site = Site(Terrain(100.0), 50.0, 5, landmarks=Objects(solids=(HOUSE,)), green=0.0)
    skin = render_surface(site, (0.0, 0.0, 50.0, 50.0), 4.0, 0.3)
    dark = shadows(skin)
    x, y = skin.positions()
    # 8 m at 48 degrees give 7.2 m of shadow: 4 m to the north and 6 m to the east.
    assert dark[(np.abs(x - 26) < 6) & (y > 31.5) & (y < 33.5)].all()
    assert dark[(x > 35.5) & (x < 39.5) & (y > 23) & (y < 31)].all()
    assert not dark[(x < 14.5) | (y < 18.5) | (x > 42) | (y > 36)].any()
    points = match(Objects(solids=(HOUSE,)), green=0.0)
    shaded = (
        (np.abs(points.xyz[:, 0] - 26) < 6)
        & (points.xyz[:, 1] > 32)
        & (points.xyz[:, 1] < 33.5)
    )
    sunny = points.xyz[:, 1] < 15
    ratio = np.median(points.rgb[shaded], axis=0) / np.median(points.rgb[sunny], axis=0)
    assert ratio == pytest.approx(SHADE, abs=0.06)


def test_steep_ground_is_rock():
    site = Site(Terrain(100.0, (1.0, 0.0)), 50.0, 1)
    assert np.all(ground_materials(site, np.array([3.0, 30.0]), np.array([5.0, 20.0])) == ROCK)


def test_the_skin_of_a_place_does_not_depend_on_the_box_around_it():
    site = Site(
        Terrain(100.0),
        50.0,
        5,
        landmarks=Objects(solids=(HOUSE,), crowns=(Crown(12, 12, 106, 4, 4),)),
    )
    small = render_surface(site, (10.0, 10.0, 20.0, 20.0), 3.0, 0.3)
    large = render_surface(site, (0.0, 0.0, 50.0, 50.0), 3.0, 0.3)
    off = round((small.x0 - large.x0) / PIXEL_M)
    inner = np.s_[10:-10, 10:-10]
    for name in ("sharp", "smooth", "label"):
        one = getattr(small, name)[inner]
        rows, columns = getattr(small, name).shape
        other = getattr(large, name)[off : off + rows, off : off + columns][inner]
        assert np.array_equal(one, other), name
