"""Statements on surveys with known objects are true."""

from __future__ import annotations

import numpy as np

from tests.benchmarks.statement import STOPS, artificial_surveys, objects_in, text_of


def test_statements_on_random_hills_are_true() -> None:
    surveys = list(artificial_surveys(20, 350))
    assert sum(survey.is_true for survey in surveys) >= 18
    for survey in surveys:
        assert len(survey.bounds) == len(STOPS)
        assert survey.bounds[1] <= survey.bounds[0] <= survey.rising
    # The bounds are no trivial ones.
    assert np.median([survey.bounds[1] / survey.rising for survey in surveys]) < 0.95
    assert f"of {len(surveys)} are true" in text_of(surveys)


def test_objects_wider_than_the_statement_regards_do_not_count() -> None:
    truth = np.zeros((100, 100))
    heights = truth.copy()
    heights[10:30, 10:90] = 1.0
    heights[40:90, 40:90] = 5.0
    found = objects_in(heights, truth, 1.0)
    assert found[10:30, 10:90].all()
    assert not found[40:].any()
