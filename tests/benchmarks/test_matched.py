"""The script of matched clouds on one tiny scene, its scenes' truth, and the peers as far as they are installed."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import laspy
import numpy as np
import pytest
import rasterio
from affine import Affine
from packaging.version import Version

from tests.benchmarks import leave_one_out, matched, matched_runs, measuring, peers
from tests.benchmarks.scorecard_scenes import (
    SEMI_REAL,
    SEMI_REAL_SCENES,
    BenchScene,
    Cloud,
    bilinear,
    read_with_dtm,
    semi_real_scenes,
)
from tests.benchmarks.scorecard_text import markdown
from tiler.simulate.catalogue import SceneSpec
from tiler.simulate.points import survey

needs_current_laspy = pytest.mark.skipif(
    Version(laspy.__version__) < Version("2.6"),
    reason="a header changed later does not reach the points of older laspy",
)


def tiny() -> Cloud:
    """A matched park of 70 m with 30,000 points; plants are about half of it."""
    spec = SceneSpec("tiny", "dim", "a small park", "tiny", "park", 3, 70.0, {"density": 8.0})
    site = spec.make_site()
    points = survey(site, spec.make_sensor())
    return Cloud(
        points.xyz, points.label, points.rgb, None, site.terrain.height_at, spec.side_m
    )


def test_one_tiny_scene(capsys: pytest.CaptureFixture[str]) -> None:
    matched.main(["--methods", "auto,floor"], [BenchScene("tiny", SEMI_REAL, SEMI_REAL, tiny)])
    printed = capsys.readouterr().out
    row = next(line for line in printed.splitlines() if line.startswith("| tiny"))
    (total, rmse), (floor, best) = (
        map(float, cell.split("/")[2].replace("m", "").split(","))
        for cell in row.split("|")[2:4]
    )
    assert 0 < floor <= total < 20
    assert 0 < best <= rmse < 1
    assert "lasR PTD is left out: " in printed


def test_settings_are_in_force_for_one_run_alone() -> None:
    cloud, default = tiny(), leave_one_out.matched_default()
    usual = leave_one_out.matched_error(cloud, default)
    # nothing is ground
    assert leave_one_out.matched_error(cloud, default | {"GROUND_M": -1.0}) > usual
    assert leave_one_out.matched_error(cloud, {}) == usual
    assert default == leave_one_out.matched_default()
    assert all(
        default[name] == values[1] for name, values in leave_one_out.MATCHED_GRID.items()
    )


@needs_current_laspy
def test_a_true_terrain_is_read_between_the_centres_of_its_pixels(tmp_path: Path) -> None:
    west, south, side = 500_000.0, 4_000_000.0, 20
    centres = np.arange(0.25, side, 0.5)
    heights = 100 + 0.1 * centres[None, :] + 0.2 * centres[::-1, None]
    heights[:4] = -9999.0  # the north
    profile = {
        "driver": "GTiff",
        "dtype": "float32",
        "count": 1,
        "width": 40,
        "height": 40,
        "nodata": -9999.0,
        "transform": Affine(0.5, 0.0, west, 0.0, -0.5, south + side),
        "crs": "EPSG:32616",
    }
    with rasterio.open(tmp_path / "dtm.tif", "w", **profile) as raster:
        raster.write(heights.astype(np.float32), 1)
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.header.scales, las.header.offsets = (0.001,) * 3, (west, south, 0.0)
    x, y = side * np.random.default_rng(1).random((2, 2000))
    las.xyz = np.column_stack((west + x, south + y, 100.5 + 0.1 * x + 0.2 * y))
    las.classification = np.full(2000, 2, np.uint8)
    las.return_number = las.number_of_returns = np.ones(2000, np.uint8)
    las.write(tmp_path / "cloud.laz")

    cloud = read_with_dtm(tmp_path / "cloud.laz", tmp_path / "dtm.tif")
    assert cloud.side_m == side
    assert cloud.rgb is None
    assert cloud.truth is not None
    found = cloud.truth(np.array([3.0, 3.1, 10.0, -1.0]), np.array([7.0, 7.1, 19.0, 7.0]))
    np.testing.assert_allclose(found, [101.7, 101.73, np.nan, np.nan], atol=1e-4)
    everything = np.ones(len(cloud.xyz), bool)
    assert measuring.dtm_rmse_m(cloud, everything) == pytest.approx(0.5, abs=0.01)


def test_heights_beside_pixels_without_one_are_not_known() -> None:
    heights = np.array([[1.0, 2.0, 3.0], [3.0, 4.0, np.nan]])
    x, y = np.array([0.75, 1.0, 2.0]), np.array([1.0, 1.25, 1.25])
    np.testing.assert_array_equal(bilinear(heights, 1.0, x, y), [2.25, 2.0, np.nan])


def test_the_floor_is_the_best_height_where_the_terrain_is_known() -> None:
    z = np.array([0.0, 0.3, 0.31, 0.5, 9.0, 0.0])
    classes = np.array([2, 2, 2, 5, 2, 5], np.uint8)
    xyz = np.column_stack((np.arange(6.0), np.zeros(6), z))
    cloud = Cloud(xyz, classes, truth=lambda x, y: np.where(x < 4, 0.0, np.nan), side_m=6.0)
    assert measuring.nearest_to_truth(cloud).tolist() == [True, True, True, False, True, False]


def test_what_is_left_in_a_terrain_is_told_with_its_place_and_class() -> None:
    off = np.zeros((40, 60))
    off[4:10, 8:20] = 3.0  # 6 m x 3 m, its middle 7 m east and 16.5 m north
    off[30:32, 50:52] = 5.0  # 1 m2
    off[20, :] = np.nan
    roof = np.column_stack((np.linspace(5, 9, 30), np.full(30, 16.5), np.full(30, 103.0)))
    (left,) = matched_runs.objects_left(off, Cloud(roof, np.full(30, 6, np.uint8)))
    assert left == matched_runs.Left(7.0, 16.5, 18.0, 3.0, "building")
    assert str(left) == "building at 7, 16 (18 m2, up to 3.0 m)"


def test_semi_real_scenes(shared_data: Path) -> None:
    scenes = {scene.name: scene for scene in semi_real_scenes(shared_data)}
    if not scenes:
        pytest.skip("no semi-real clouds")
    assert tuple(scenes) == SEMI_REAL_SCENES
    cloud = scenes["garden"].load()
    assert cloud.rgb is not None
    assert cloud.returns is not None
    assert (cloud.returns == 1).all()
    assert cloud.truth is not None
    x, y, z = cloud.xyz[cloud.classification == 2].T
    difference = z - cloud.truth(x, y)
    assert np.nanstd(difference) == pytest.approx(0.042, abs=0.002)  # as its README says
    assert abs(np.nanmedian(difference)) < 0.001


def test_semi_real_scenes_are_not_averaged_with_real_ones() -> None:
    cells = [
        measuring.Cell("auto", name, group, group, 9, total=total)
        for name, group, total in (
            ("a", "other real clouds", 0.1),
            ("b", SEMI_REAL, 0.3),
            ("c", "simulated things", 0.5),
        )
    ]
    text = markdown(cells, "auto", 1)
    assert "| all real (1) | - / - / **10.00** / - |" in text
    assert "| semi-real image matching (1) | - / - / **30.00** / - |" in text
    assert "## Semi-real image matching\n" in text


def test_smrf_sees_no_outliers(monkeypatch: pytest.MonkeyPatch) -> None:
    class Pipeline:
        def __init__(self, stages: str, arrays: list[np.ndarray]) -> None:
            self.stages, self.arrays = json.loads(stages), arrays

        def execute(self) -> None:
            assert [s["type"] for s in self.stages] == [
                "filters.elm",
                "filters.outlier",
                "filters.smrf",
            ]
            assert self.stages[2]["ignore"] == "Classification[7:7]"
            self.arrays[0]["Classification"] = np.where(self.arrays[0]["Z"] < 1, 2, 1)

    monkeypatch.setitem(sys.modules, "pdal", SimpleNamespace(Pipeline=Pipeline))  # type: ignore[arg-type]
    xyz = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 3.0]])
    assert peers.pdal_ground(peers.SMRF_WITHOUT_OUTLIERS, xyz).tolist() == [True, False]


@needs_current_laspy
def test_ptd_of_lasr_is_read_back_in_the_order_of_the_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def run(command: list[str], **_: object) -> None:
        las = laspy.read(command[-2])
        las.classification = np.where(las.z < 1, 2, 1)
        las.points = las.points[::-1].copy()
        las.write(command[-1])

    monkeypatch.setattr(peers.subprocess, "run", run)
    xyz = np.random.default_rng(1).uniform(0, 2, (50, 3)) + (500_000, 4_000_000, 0)
    assert peers.lasr_ptd(xyz).tolist() == (np.round(xyz[:, 2], 3) < 1).tolist()


def test_peers_take_part_or_say_why_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "installed", lambda module: module == "CSF")
    monkeypatch.setattr(peers, "_has_lasr", lambda: False)
    assert list(peers.installed_peers()) == ["CSF (peer)", "CSF 1 m rigidness 2 (peer)"]
    assert len(peers.installed_peers(every_cloth=True)) == 4
    assert sorted(peers.missing_peers()) == ["PDAL SMRF, PMF", "lasR PTD"]
    monkeypatch.setattr(peers, "installed", lambda module: False)
    assert peers.installed_peers() == {}
    assert "pip install cloth-simulation-filter" in peers.missing_peers()["CSF"]


def test_a_cloth_finds_a_house_and_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("CSF")
    rng = np.random.default_rng(1)
    xyz = np.column_stack((rng.uniform(0, 40, (4000, 2)), rng.normal(0, 0.02, 4000)))
    house = np.all(np.abs(xyz[:, :2] - 20) < 5, axis=1)
    xyz[house, 2] += 6
    for cloth in (peers.CLOTH_DEFAULT, *peers.CLOTHS):
        assert np.mean(peers.csf(xyz, cloth) == ~house) > 0.98
    assert capfd.readouterr().out == ""
