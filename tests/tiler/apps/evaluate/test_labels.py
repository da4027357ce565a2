"""Scores worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tiler.apps.evaluate import IGNORED, confusion, evaluate_labels, scores
from tiler.apps.evaluate.clouds import class_scores, class_table, mean_scores
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


def test_ignored_classes_are_left_out_and_counted():
    truth = np.array([2, 1, *IGNORED], np.uint8)
    assert confusion(np.full(truth.size, 2, np.uint8), truth).tolist() == [
        1,
        0,
        1,
        0,
        len(IGNORED),
    ]
    assert confusion(np.full(truth.size, 2, np.uint8), truth, ()).tolist() == [
        1,
        0,
        1 + len(IGNORED),
        0,
        0,
    ]


def test_a_division_by_zero_gives_none():
    result = scores(np.array([0, 0, 0, 4, 1]))
    assert (result["type_1"], result["type_2"], result["kappa"], result["f1"]) == (
        None,
        0.0,
        None,
        None,
    )
    assert scores(np.zeros(5, np.int64))["total"] is None


def test_labels_of_other_points_are_refused():
    with pytest.raises(InputError, match="3 labels against 2 true ones"):
        confusion(np.zeros(3, np.uint8), np.zeros(2, np.uint8))


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
    assert mean_scores([]) == dict.fromkeys(("type_1", "type_2", "total", "kappa", "f1"))
