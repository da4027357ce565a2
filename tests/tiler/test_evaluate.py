"""Scores worked out by hand."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from tiler.errors import ConfigError, InputError
from tiler.evaluate import IGNORED, confusion, evaluate_dtm, evaluate_files, evaluate_labels, scores
from tiler.export.geotiff import RasterLook, plain_geotiff


def write(path: Path, xyz: np.ndarray, classes: np.ndarray, scale: float = 0.01) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, scale)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = xyz.T
    cloud.classification = classes
    cloud.write(path)
    return path


def test_counts_and_errors_of_a_small_table():
    truth = np.repeat(np.array([2, 2, 6, 5], np.uint8), [8, 2, 3, 7])
    labels = np.repeat(np.array([2, 1, 2, 1], np.uint8), [8, 2, 3, 7])
    result = evaluate_labels(labels, truth)
    assert [result[k] for k in ("ground_kept", "ground_lost", "object_taken", "object_kept")] == [8, 2, 3, 7]
    assert result["type_1"] == pytest.approx(2 / 10)
    assert result["type_2"] == pytest.approx(3 / 10)
    assert result["total"] == pytest.approx(5 / 20)
    # chance agreement: (10 * 11 + 10 * 9) / 400 = 0.5
    assert result["kappa"] == pytest.approx((0.75 - 0.5) / 0.5)
    assert result["f1"] == pytest.approx(16 / 21)


def test_ignored_classes_are_left_out_and_counted():
    truth = np.array([2, 1, *IGNORED], np.uint8)
    assert confusion(np.full(truth.size, 2, np.uint8), truth).tolist() == [1, 0, 1, 0, len(IGNORED)]
    assert confusion(np.full(truth.size, 2, np.uint8), truth, ()).tolist() == [1, 0, 1 + len(IGNORED), 0, 0]


def test_nothing_to_divide_by_is_none():
    result = scores(np.array([0, 0, 0, 4, 1]))
    assert (result["type_1"], result["type_2"], result["kappa"], result["f1"]) == (None, 0.0, None, None)
    assert scores(np.zeros(5, np.int64))["total"] is None


def test_labels_of_other_points_are_refused():
    with pytest.raises(InputError, match="3 labels against 2 true ones"):
        confusion(np.zeros(3, np.uint8), np.zeros(2, np.uint8))


@pytest.fixture
def points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    xyz = rng.integers(0, 10_000, (500, 3)) / 100
    xyz[400:] = xyz[:100]  # two points at one place
    return xyz, rng.choice([1, 2], 500).astype(np.uint8), rng.choice([2, 5, 7], 500).astype(np.uint8)


def test_files_in_the_same_order(tmp_path, points):
    xyz, labels, truth = points
    result = evaluate_files(
        write(tmp_path / "a.las", xyz, labels), write(tmp_path / "b.laz", xyz, truth, 0.001)
    )
    assert result["matched_by"] == "order"
    assert result.items() >= evaluate_labels(labels, truth).items()


def test_files_in_another_order_and_a_part(tmp_path, points):
    xyz, labels, truth = points
    unique = np.arange(100, 400)
    part = np.random.default_rng(1).permutation(unique)[:200]
    cloud = write(tmp_path / "a.laz", xyz, labels)
    result = evaluate_files(cloud, write(tmp_path / "b.laz", xyz[part], truth[part]))
    assert result.items() >= evaluate_labels(labels[part], truth[part]).items()
    assert (result["matched_by"], result["unmatched_reference"], result["unmatched_cloud"]) == (
        "coordinates",
        0,
        300,
    )


def test_points_at_one_place_are_paired_one_to_one(tmp_path, points):
    xyz, labels, truth = points
    shifted = np.roll(np.arange(500), 450)  # keeps the order within each pair of equal points but for 50
    cloud = write(tmp_path / "a.laz", xyz, labels)
    result = evaluate_files(cloud, write(tmp_path / "b.laz", xyz[shifted], truth[shifted]))
    assert (result["unmatched_reference"], result["unmatched_cloud"]) == (0, 0)
    assert result["points"] + result["ignored"] == 500


def test_a_reference_of_elsewhere_is_refused(tmp_path, points):
    xyz, labels, truth = points
    with pytest.raises(InputError, match=r"none of its points is in .*a\.laz"):
        evaluate_files(write(tmp_path / "a.laz", xyz, labels), write(tmp_path / "b.laz", xyz + 500, truth))


def raster(path: Path, heights: np.ndarray, west: float = 0.0, north: float = 0.0, size: float = 1.0) -> Path:
    with plain_geotiff(
        path, *heights.shape, (size, 0, west, 0, -size, north), RasterLook(None, "metre", "z", {})
    ) as out:
        out.write(heights.astype(np.float32), 0, 0)
    return path


def test_a_dtm_against_its_truth(tmp_path):
    truth = np.arange(12.0).reshape(3, 4)
    mine = truth + np.array([[1, -1, 1, -1], [3, 1, 1, 1], [1, 1, 1, 1]])
    mine[2, 3] = -9999
    truth[0, 0] = -9999
    result = evaluate_dtm(raster(tmp_path / "a.tif", mine, 10, 20), raster(tmp_path / "b.tif", truth, 10, 20))
    difference = np.array([-1, 1, -1, 3, 1, 1, 1, 1, 1, 1])
    assert (result["pixels"], result["only_dtm"], result["only_truth"]) == (10, 1, 1)
    assert result["bias"] == pytest.approx(0.8)
    assert result["rmse"] == pytest.approx(np.sqrt(np.mean(difference**2)))
    assert (result["median"], result["nmad"], result["max_abs"]) == (1.0, 0.0, 3.0)


def test_rasters_of_other_extents_are_compared_where_they_overlap(tmp_path):
    truth = np.arange(100.0).reshape(10, 10)
    result = evaluate_dtm(
        raster(tmp_path / "a.tif", truth[2:7, 3:9] + 0.5, 103, 198),
        raster(tmp_path / "b.tif", truth, 100, 200),
    )
    assert (result["pixels"], result["rmse"], result["nmad"]) == (30, 0.5, 0.0)
    wider = evaluate_dtm(
        raster(tmp_path / "c.tif", truth, 100, 200), raster(tmp_path / "d.tif", truth[2:7, 3:9], 103, 198)
    )
    assert (wider["pixels"], wider["rmse"]) == (30, 0.0)


@pytest.mark.parametrize(
    ("west", "size", "message"),
    [(0.5, 1.0, "one pixel lattice"), (0.0, 2.0, "one pixel lattice"), (50.0, 1.0, "do not overlap")],
)
def test_rasters_that_cannot_be_compared_are_refused(tmp_path, west, size, message):
    one = raster(tmp_path / "a.tif", np.ones((4, 4)), 0, 4)
    with pytest.raises(ConfigError, match=message):
        evaluate_dtm(one, raster(tmp_path / "b.tif", np.ones((4, 4)), west, 4, size))


def test_what_is_no_raster_is_refused(tmp_path):
    (tmp_path / "a.tif").write_text("no raster")
    with pytest.raises(InputError, match="name two readable rasters"):
        evaluate_dtm(tmp_path / "a.tif", tmp_path / "a.tif")


def test_the_isprs_sample_is_found_in_its_scene(shared_data):
    result = evaluate_files(shared_data / "isprs/CSite2_orig-utm.laz", shared_data / "isprs/samp22-utm.laz")
    assert (result["points"], result["unmatched_reference"]) == (32_706, 0)
