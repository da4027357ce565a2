"""Scenes as files: streamed, reproducible, refused if settings or outputs are unfit."""

from __future__ import annotations

from dataclasses import replace

import laspy
import numpy as np
import pytest
import rasterio

from tiler.errors import ConfigError, ProcessingError
from tiler.simulate import (
    SCENES,
    AlsSensor,
    DimSensor,
    describe_scene,
    make_scene,
    make_site,
    survey,
    write_scene,
)
from tiler.simulate.points import patches, survey_patch

SMALL = {"side_m": 60.0, "density": 0.5}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "a.laz"
    return path, write_scene(path, describe_scene("suburb", seed=3, **SMALL), 0.5)


def test_the_cloud_holds_the_survey(written):
    path, facts = written
    cloud = laspy.read(path)
    points = survey(make_site("suburb", 3, 60.0), AlsSensor(density=0.5))
    assert np.array_equal(cloud.classification, points.label)
    assert np.array_equal(cloud.return_number, points.number)
    assert np.array_equal(cloud.number_of_returns, points.count)
    corner = (500_000_000, 5_400_000_000, 0)
    counts = (
        np.column_stack((cloud.X, cloud.Y, cloud.Z))
        + np.round(cloud.header.offsets * 1000)
        - corner
    )
    assert np.array_equal(counts, np.round(points.xyz * 1000))
    assert np.all(np.diff(cloud.gps_time) >= 0)
    assert cloud.header.parse_crs().to_epsg() == 32632
    assert facts.points == len(points) == sum(facts.classes.values())
    assert facts.classes["2 ground"] == np.sum(points.label == 2)


def test_a_scene_from_images_looks_like_one_also_without_colours(tmp_path):
    """Else its points would be taken for those of a laser scanner."""
    scene = replace(SCENES["dim_forest"], side_m=40.0)
    assert not scene.make_sensor().coloured
    write_scene(tmp_path / "a.laz", scene)
    assert not laspy.read(tmp_path / "a.laz").gps_time.any()


def test_the_terrain_is_the_formula(written):
    _, facts = written
    with rasterio.open(facts.dtm) as raster:
        assert raster.transform[:6] == (0.5, 0, 500_000, 0, -0.5, 5_400_060)
        heights = raster.read(1)
    truth = make_site("suburb", 3, 60.0).terrain
    x = np.arange(120) * 0.5 + 0.25
    assert np.abs(heights - truth.height_at(x[None, :], 60 - x[:, None])).max() < 1e-4


def test_the_same_settings_give_the_same_bytes_and_nothing_else_is_left(written, tmp_path):
    path, facts = written
    write_scene(tmp_path / "b.laz", describe_scene("suburb", seed=3, **SMALL), 0.5)
    assert (tmp_path / "b.laz").read_bytes() == path.read_bytes()
    assert (tmp_path / "b_dtm.tif").read_bytes() == (path.parent / "a_dtm.tif").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["b.laz", "b_dtm.tif"]
    other = write_scene(tmp_path / "c.laz", describe_scene("suburb", seed=4, **SMALL))
    assert other.points != facts.points


@pytest.mark.parametrize(
    ("kind", "sensor"),
    [
        ("suburb", AlsSensor(density=1.0)),
        ("suburb", AlsSensor(low_share=0.01, low_clumps_km2=2000.0, mirrors_km2=1000.0)),
        ("village", DimSensor(density=4.0)),
    ],
)
def test_patches_depend_neither_on_their_order_nor_on_one_another(kind, sensor):
    side = 60.0
    order = patches(sensor, side)
    site = make_site(kind, 7, side)
    forward = {index: survey_patch(site, sensor, *index) for index in order}
    for index in (order[-1], order[len(order) // 2], order[1]):
        alone = survey_patch(make_site(kind, 7, side), sensor, *index)
        for name in ("xyz", "label", "number", "count", "angle_deg", "rgb"):
            one, other = getattr(alone, name), getattr(forward[index], name)
            assert (one is None and other is None) or one.tobytes() == other.tobytes(), (
                index,
                name,
            )


def test_no_part_of_a_large_site_is_made_before_it_is_looked_at():
    site = make_site("city", 1, 20_000.0)
    points = survey_patch(site, AlsSensor(density=0.5), 100, 100)
    assert len(points) > 4000
    assert len(site._blocks) < 30
    truth = site.terrain.height_at(points.xyz[:, 0], points.xyz[:, 1])
    ground = points.label == 2
    assert np.abs(points.xyz[ground, 2] - truth[ground]).max() < 0.2


def test_a_matched_scene_has_colours(tmp_path):
    facts = write_scene(
        tmp_path / "d.las", describe_scene("park", "dim", side_m=50.0, density=5.0)
    )
    cloud = laspy.read(tmp_path / "d.las")
    assert cloud.header.point_format.id == 7
    assert cloud.red.max() > 2**14
    assert facts.points_per_m2 == pytest.approx(len(cloud) / 2500, abs=0.001)


def test_scenes_of_the_catalogue_and_what_differs():
    spec = describe_scene("als_forest")
    assert spec.make_sensor() == SCENES["als_forest"].make_sensor()
    assert (spec.seed, spec.side_m) == (121, 200.0)
    other = describe_scene("als_forest", seed=1, density=2.0, sigma_m=0.1, blunders=0.0)
    assert other.make_sensor() == AlsSensor(
        density=2.0, sigma_m=0.1, low_singles_km2=0.0, low_groups_km2=0.0, high_km2=0.0
    )
    dim = describe_scene("city", "dim", blunders=2.0).make_sensor()
    assert dim == DimSensor(blunders=0.001, high_blunders=6e-5)


def test_a_written_scene_of_the_catalogue_is_the_scene(tmp_path):
    scene = make_scene("als_sparse")
    write_scene(tmp_path / "a.laz", describe_scene("als_sparse"))
    cloud = laspy.read(tmp_path / "a.laz")
    assert np.array_equal(cloud.classification, scene.classification)
    assert np.array_equal(cloud.Z, np.round(scene.xyz[:, 2] * 1000))


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"scene": "moon"}, "unknown scene 'moon': choose one of city, "),
        (
            {"scene": "als_city", "kind": "dim"},
            "--kind dim: scene als_city is of kind als; use --scene city",
        ),
        ({"kind": "radar"}, "--kind radar: choose one of als, dim"),
        ({"density": 0.0}, "--density 0: must be between 0.05 and 100 points/m2"),
        (
            {"kind": "dim", "density": 1001.0},
            "--density 1001: must be between 1 and 1000 points/m2",
        ),
        ({"sigma_m": -0.1}, "--sigma -0.1: must be between 0 and 1 m"),
        ({"side_m": 1.0}, "--size 1: must be between 50 and 50000 m"),
        ({"blunders": float("nan")}, "--blunders nan: must be between 0 and 100 times"),
        ({"seed": -1}, "--seed -1: must not be negative"),
    ],
)
def test_refused(settings, text):
    with pytest.raises(ConfigError) as refused:
        describe_scene(**settings)
    assert str(refused.value).startswith(text)


def test_refused_outputs(tmp_path):
    spec = describe_scene("plane", **SMALL)
    with pytest.raises(ConfigError, match="a.txt: a simulated cloud is LAZ or LAS"):
        write_scene(tmp_path / "a.txt", spec)
    with pytest.raises(ConfigError, match="--resolution 0: must be between"):
        write_scene(tmp_path / "a.laz", spec, 0.0)
    (tmp_path / "file").touch()
    with pytest.raises(ProcessingError, match="cannot be written"):
        write_scene(tmp_path / "file" / "a.laz", spec)
