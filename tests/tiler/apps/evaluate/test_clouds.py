"""Scores worked out by hand, and points paired in any order."""

from __future__ import annotations

import laspy
import numpy as np
import pytest

from tests.tiler.apps.evaluate.clouds import write_cloud
from tiler.apps.evaluate import IGNORED, evaluate_files, evaluate_labels, scores
from tiler.apps.evaluate.clouds import (
    ERRORS,
    class_scores,
    class_table,
    counts_of,
    mean_scores,
)
from tiler.errors import InputError


def test_counts_and_errors_of_a_small_table():
    truth = np.repeat(np.array([2, 2, 6, 5], np.uint8), [8, 2, 3, 7])
    labels = np.repeat(np.array([2, 1, 2, 1], np.uint8), [8, 2, 3, 7])
    result = evaluate_labels(labels, truth)
    assert [
        result[k] for k in ("ground_kept", "ground_lost", "object_taken", "object_kept")
    ] == [8, 2, 3, 7]
    assert result["type_1"] == pytest.approx(2 / 10)
    assert result["type_2"] == pytest.approx(3 / 10)
    assert result["total"] == pytest.approx(5 / 20)
    # chance agreement: (10 * 11 + 10 * 9) / 400 = 0.5
    assert result["kappa"] == pytest.approx((0.75 - 0.5) / 0.5)
    assert result["f1"] == pytest.approx(16 / 21)
    assert result["iou"] == pytest.approx(8 / 13)
    correlation = np.corrcoef(truth == 2, labels == 2)[0, 1]
    assert result["mcc"] == pytest.approx(correlation)


def test_ignored_classes_are_left_out_and_counted():
    truth = np.array([2, 1, *IGNORED], np.uint8)
    assert counts_of(class_table(np.full(truth.size, 2, np.uint8), truth)).tolist() == [
        1,
        0,
        1,
        0,
        len(IGNORED),
    ]
    assert counts_of(class_table(np.full(truth.size, 2, np.uint8), truth), ()).tolist() == [
        1,
        0,
        1 + len(IGNORED),
        0,
        0,
    ]


def test_a_division_by_zero_gives_none():
    result = scores(np.array([0, 0, 0, 4, 1]))
    assert result["type_2"] == 0.0
    assert {result[name] for name in ("type_1", "kappa", "f1", "iou", "mcc")} == {None}
    assert scores(np.zeros(5, np.int64))["total"] is None


def test_labels_of_other_points_are_refused():
    with pytest.raises(InputError, match="3 labels against 2 true ones"):
        class_table(np.zeros(3, np.uint8), np.zeros(2, np.uint8))


def test_each_true_class_has_figures_of_its_own():
    truth = np.repeat(np.array([2, 6, 9], np.uint8), [10, 4, 3])
    labels = np.repeat(np.array([2, 1, 2, 1, 2], np.uint8), [7, 3, 1, 3, 3])
    assert class_scores(class_table(labels, truth)) == {
        "2": {"points": 10, "labelled_ground": 7, "wrong": 3, "error": 0.3},
        "6": {"points": 4, "labelled_ground": 1, "wrong": 1, "error": 0.25},
        "9": {"points": 3, "labelled_ground": 3, "wrong": None, "error": None},
    }


def test_scenes_have_the_same_weight_in_the_mean():
    one = evaluate_labels(np.array([2, 1], np.uint8), np.array([2, 2], np.uint8))
    other = evaluate_labels(np.array([2] * 8, np.uint8), np.array([2] * 6 + [1] * 2, np.uint8))
    found = mean_scores([one, other])
    assert found["type_1"] == pytest.approx((0.5 + 0) / 2)
    assert found["type_2"] == 1.0  # the first scene has no object
    assert found["total"] == pytest.approx((0.5 + 0.25) / 2)
    assert mean_scores([]) == dict.fromkeys(ERRORS)


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
