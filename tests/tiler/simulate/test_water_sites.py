"""Places with water: extent, levels and banks by formula, returns from the water, structures in it."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio

from tiler.simulate import (
    AlsSensor,
    Site,
    Terrain,
    describe_scene,
    make_site,
    survey,
    write_scene,
)
from tiler.simulate.points import SimulatedPoints
from tiler.simulate.terrain import Masonry, WaterBody, Waters, constant

CLEAN = AlsSensor(overlap_m=0.0, sigma_m=0.0, low_singles_km2=0, low_groups_km2=0, high_km2=0)
LEVEL = 95.0


def pond(**changes: object) -> WaterBody:
    """A round pond of 20 m at (30, 30), whose returns have no waves."""
    settings = {"returned": constant(0.5), "waves_m": constant(0.0), **changes}
    return WaterBody(
        lambda x, y: np.hypot(x - 30, y - 30) - 20, constant(LEVEL), 0.5, **settings
    )


def scan(waters: Waters) -> SimulatedPoints:
    """Points of 60 x 60 m of flat land at 100 m."""
    return survey(Site(Terrain(100.0, waters=waters), 60.0, 9), CLEAN)


def inside_and_height(points: SimulatedPoints) -> tuple[np.ndarray, np.ndarray]:
    """Whether each point lies on the pond, and the heights."""
    x, y, z = points.xyz.T
    return np.hypot(x - 30, y - 30) < 20, z


def test_banks_rise_from_the_shore_until_they_meet_the_land():
    terrain = Terrain(100.0, waters=Waters((pond(),)))
    x = np.array([30.0, 49.0, 52.0, 56.0, 59.9, 70.0])
    assert terrain.height_at(x, 30.0) == pytest.approx([95.0, 95.0, 96.0, 98.0, 99.95, 100.0])
    assert terrain.wet_at(x, 30.0).tolist() == [True, True, False, False, False, False]


def test_water_returns_its_share_at_its_level_and_land_returns_nearly_all():
    points = scan(Waters((pond(),)))
    inside, z = inside_and_height(points)
    assert np.all((points.label == 9) == inside)
    assert np.all(z[inside] == LEVEL)
    assert inside.sum() == pytest.approx(4 * np.pi * 400 * 0.5, rel=0.05)
    assert (~inside).sum() == pytest.approx(4 * (3600 - np.pi * 400) * 0.99, rel=0.02)


def test_waves_tide_and_low_returns_move_heights_and_not_the_truth():
    body = pond(waves_m=constant(0.1), tide_m=constant(0.4), low=0.1)
    points = scan(Waters((body,)))
    z = points.xyz[:, 2]
    water = z[points.label == 9]
    assert water.mean() == pytest.approx(LEVEL + 0.4, abs=0.01)
    assert water.std() == pytest.approx(0.1, rel=0.1)
    low = points.label == 7
    assert low.sum() == pytest.approx(4 * np.pi * 400 * 0.1, rel=0.2)
    assert LEVEL - 3.0 < z[low].min() < z[low].max() < LEVEL - 0.1


def test_reed_stands_in_the_water():
    points = scan(Waters((pond(reeds=constant(0.9)),)))
    inside, z = inside_and_height(points)
    reed = np.isin(points.label, (3, 4))
    assert np.mean(inside[reed]) > 0.97, "some lean over the shore along their pulses"
    assert reed.sum() > 0.85 * 4 * np.pi * 400
    assert LEVEL + 0.299 < z[reed].min() < z[reed].max() < LEVEL + 2.001


def test_masonry_is_ground_in_and_above_the_water():
    waters = Waters((pond(),), (Masonry(28.0, 0.0, 32.0, 60.0, 97.0),))
    terrain = Terrain(100.0, waters=waters)
    x = np.array([30.0, 32.1, 33.0])
    assert terrain.height_at(x, 30.0) == pytest.approx([97.0, 96.2, 95.0])
    assert terrain.wet_at(x, 30.0).tolist() == [False, False, True]
    assert terrain.height_at(30.0, 5.0) == 97.5, "the bank stays where it is above the crest"
    points = scan(waters)
    x, y, z = points.xyz.T
    on_crest = (np.abs(x - 30) < 1.99) & (np.abs(y - 30) < 20)
    assert set(points.label[on_crest]) == {2}
    assert np.all(z[on_crest] == 97.0)


def test_wet_land_loses_pulses_and_is_no_water():
    points = scan(Waters(lost_on_land=lambda x, y: np.where(x < 30, 0.65, 0.0)))
    west = points.xyz[:, 0] < 30
    assert set(points.label) == {2}
    assert west.sum() == pytest.approx(4 * 1800 * 0.35, rel=0.05)
    assert (~west).sum() == pytest.approx(4 * 1800, rel=0.02)


@pytest.mark.parametrize("kind", ["weir", "meander", "lakes", "tide", "wet_meadow"])
def test_a_site_has_its_extent_and_truth(kind: str):
    site = make_site(kind, 5, 400.0)
    points = survey(site, AlsSensor(density=0.5))
    assert points.xyz[:, 0].max() > 399.0
    assert points.xyz[:, 1].max() == pytest.approx(site.north_m, abs=1.5)
    assert points.xyz[:, 1].max() < site.north_m < 400.0
    ground = points.label == 2
    x, y, z = points.xyz[ground].T
    # On the faces of masonry, which rise 8 m per metre, a millimetre of x or y is 8 mm of
    # height.
    assert np.abs(z - site.terrain.height_at(x, y)).max() < 0.2
    assert not site.terrain.wet_at(x, y).any()
    water = points.label == 9
    # Waves move returns along their slanted pulses, by a centimetre or two.
    assert np.sum(~site.terrain.wet_at(*points.xyz[water, :2].T)) <= 0.02 * water.sum()
    assert water.any() == (kind != "wet_meadow")


def test_the_terrain_raster_of_a_long_site_has_its_shape(tmp_path):
    facts = write_scene(
        tmp_path / "a.laz", describe_scene("als_meander", side_m=500.0, density=0.1)
    )
    with rasterio.open(facts.dtm) as raster:
        assert (raster.width, raster.height) == (500, 300)
        assert raster.transform[:6] == (1, 0, 500_000, 0, -1, 5_400_300)
    assert facts.points_per_m2 == pytest.approx(0.1, rel=0.1)
