"""The files of the demo: four clouds, their truth row by row, the true terrain."""

from __future__ import annotations

import laspy
import numpy as np
import pytest
import rasterio

from tiler.simulate import AlsSensor, DemoScene, demo_city


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> DemoScene:
    return demo_city(
        tmp_path_factory.mktemp("demo"), seed=3, side_m=320.0, sensor=AlsSensor(density=1.0)
    )


def test_clouds_and_truth_have_the_same_rows(demo):
    total = 0
    for path, truth_path in zip(demo.paths, demo.truth_paths, strict=True):
        cloud, truth = laspy.read(path), laspy.read(truth_path)
        for name in (
            "X",
            "Y",
            "Z",
            "return_number",
            "number_of_returns",
            "gps_time",
            "scan_angle",
        ):
            assert np.array_equal(cloud[name], truth[name])
        assert set(np.unique(cloud.classification)) == {0, 1}
        assert (
            {1, 2, 3, 5, 6}
            <= set(np.unique(truth.classification))
            <= {1, 2, 3, 4, 5, 6, 7, 14, 15, 18}
        )
        assert np.all(np.diff(cloud.gps_time) >= 0)
        assert cloud.header.parse_crs().to_epsg() == 32632
        assert list(cloud.header.scales) == [0.001] * 3
        total += len(cloud)
    assert total == demo.points


def test_the_files_lie_side_by_side(demo):
    for part, path in enumerate(demo.paths):
        cloud = laspy.read(path)
        west, south = 500_000_000 + 160_000 * (part % 2), 5_400_000_000 + 160_000 * (part // 2)
        x, y = np.round(cloud.x * 1000), np.round(cloud.y * 1000)
        assert (x.min(), x.max()) == pytest.approx((west, west + 160_000), abs=1500)
        assert (y.min(), y.max()) == pytest.approx((south, south + 160_000), abs=1500)
        assert west <= x.min() < x.max() < west + 160_000
        assert south <= y.min() < y.max() < south + 160_000


def test_the_true_dtm_is_the_formula(demo):
    with rasterio.open(demo.dtm_path) as raster:
        heights = raster.read(1)
        assert raster.shape == (320, 320)
        assert raster.transform[:6] == (1, 0, 500_000, 0, -1, 5_400_320)
    assert heights[0, 7] == pytest.approx(float(demo.terrain.height_at(7.5, 319.5)), abs=1e-4)
    assert heights[200, 100] == pytest.approx(
        float(demo.terrain.height_at(100.5, 119.5)), abs=1e-4
    )


def test_the_same_seed_gives_the_same_bytes(demo, tmp_path):
    again = demo_city(tmp_path, seed=3, side_m=320.0, sensor=AlsSensor(density=1.0))
    for one, two in zip(
        (*demo.paths, *demo.truth_paths, demo.dtm_path),
        (*again.paths, *again.truth_paths, again.dtm_path),
        strict=True,
    ):
        assert one.read_bytes() == two.read_bytes()
