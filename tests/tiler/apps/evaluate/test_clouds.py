"""Clouds compared with references of the same points."""

from __future__ import annotations

import laspy
import numpy as np
import pytest

from tests.tiler.apps.evaluate.clouds import write_cloud
from tiler.apps.evaluate import evaluate_files, evaluate_labels
from tiler.errors import InputError


@pytest.fixture
def points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    xyz = rng.integers(0, 10_000, (500, 3)) / 100
    xyz[400:] = xyz[:100]  # two points at one place
    return (
        xyz,
        rng.choice([1, 2], 500).astype(np.uint8),
        rng.choice([2, 5, 7], 500).astype(np.uint8),
    )


def test_files_in_the_same_order(tmp_path, points):
    xyz, labels, truth = points
    cloud = write_cloud(tmp_path / "a.las", xyz, labels)
    result = evaluate_files(cloud, write_cloud(tmp_path / "b.laz", xyz, truth, 0.001))
    assert result["matched_by"] == "order"
    assert result.items() >= evaluate_labels(labels, truth).items()


def test_files_in_another_order_and_a_part(tmp_path, points):
    xyz, labels, truth = points
    unique = np.arange(100, 400)
    part = np.random.default_rng(1).permutation(unique)[:200]
    cloud = write_cloud(tmp_path / "a.laz", xyz, labels)
    result = evaluate_files(cloud, write_cloud(tmp_path / "b.laz", xyz[part], truth[part]))
    assert result.items() >= evaluate_labels(labels[part], truth[part]).items()
    assert (result["matched_by"], result["unmatched_reference"]) == ("coordinates", 0)
    assert result["unmatched_cloud"] == 300


def test_points_at_one_place_are_paired_one_to_one(tmp_path, points):
    xyz, labels, truth = points
    # keeps the order within each pair of equal points but for 50
    shifted = np.roll(np.arange(500), 450)
    cloud = write_cloud(tmp_path / "a.laz", xyz, labels)
    result = evaluate_files(
        cloud, write_cloud(tmp_path / "b.laz", xyz[shifted], truth[shifted])
    )
    assert (result["unmatched_reference"], result["unmatched_cloud"]) == (0, 0)
    assert result["points"] + result["ignored"] == 500


def test_a_reference_of_another_place_is_refused(tmp_path, points):
    xyz, labels, truth = points
    cloud, other = (
        write_cloud(tmp_path / f"{k}.laz", xyz + 500 * i, truth) for i, k in enumerate("ab")
    )
    with pytest.raises(InputError, match=r"none of its points is in .*a\.laz"):
        evaluate_files(cloud, other)


def test_points_that_the_reference_withholds_are_not_judged(tmp_path, points):
    xyz, labels, truth = points
    cloud, reference = (
        write_cloud(tmp_path / "a.laz", xyz, labels),
        write_cloud(tmp_path / "b.laz", xyz, truth),
    )
    withheld = laspy.read(reference)
    withheld.withheld = np.arange(500) < 60
    withheld.write(reference)
    result = evaluate_files(cloud, reference)
    assert result.items() >= evaluate_labels(labels[60:], truth[60:]).items()
    assert result["withheld"] == 60


def test_omitted_points_are_counted_by_class(tmp_path, points):
    xyz, labels, truth = points
    result = evaluate_files(
        write_cloud(tmp_path / "a.laz", xyz, labels),
        write_cloud(tmp_path / "b.laz", xyz, truth),
    )
    assert result["left_out"] == {"7": int((truth == 7).sum())}
    assert result["ignored"] == result["left_out"]["7"]


def test_the_isprs_sample_is_found_in_its_scene(shared_data):
    result = evaluate_files(
        shared_data / "isprs/CSite2_orig-utm.laz", shared_data / "isprs/samp22-utm.laz"
    )
    assert (result["points"], result["unmatched_reference"]) == (32_706, 0)
