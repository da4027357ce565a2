"""Limits with units, and figures that were not measured."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

from tiler.apps.check import Requirement, judge, parse_requirements
from tiler.errors import ConfigError


def report(**nva: Any) -> dict[str, Any]:
    figures = {
        "rmse_v": 0.5,
        "bias": -0.2,
        "median": 0.1,
        "nmad": 0.1,
        "p95_abs": 1.0,
        "max_abs": 2.0,
    }
    accuracy = {
        "metres_per_unit": 0.3048,
        "nva": {**figures, "points": 30, "outliers": 2, **nva},
    }
    return {"accuracy": accuracy, "seams": {"metres_per_unit": 1.0, "excess": 0.001}}


def test_lengths_have_units() -> None:
    assert parse_requirements(["rmse=0.1", "mean=2cm", "max=1ft", "points=30"]) == [
        Requirement("rmse", Fraction(1, 10)),
        Requirement("mean", Fraction(1, 50)),
        Requirement("max", Fraction(3048, 10_000)),
        Requirement("points", Fraction(30)),
    ]


@pytest.mark.parametrize(
    ("text", "value", "met"),
    [
        ("rmse=0.5ft", 0.1524, True),
        ("rmse=0.15", 0.1524, False),
        ("mean=0.21ft", 0.06096, True),
        ("mean=0.06", 0.06096, False),
        ("max=0.6", 0.6096, False),
        ("points=30", 30, True),
        ("points=31", 30, False),
        ("outliers=1", 2, False),
        ("outliers=2", 2, True),
        ("seam=0.001", 0.001, True),
    ],
)
def test_figures_are_compared_with_limits(text: str, value: float, met: bool) -> None:
    (judged,) = judge(parse_requirements([text]), report())
    assert (judged["value"], judged["met"]) == (pytest.approx(value), met)


def test_a_requirement_without_a_figure_is_not_met() -> None:
    (judged,) = judge(parse_requirements(["rmse=1"]), report(rmse_v=None))
    assert (judged["value"], judged["met"]) == (None, False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rmse", "give NAME=VALUE"),
        ("vva=0.1", "give NAME=VALUE"),
        ("points=2.5", "not a number of points"),
        ("rmse=high", "not a length"),
    ],
)
def test_unknown_requirements_are_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_requirements([text])


def test_figures_of_omitted_checks_cannot_be_required() -> None:
    with pytest.raises(ConfigError, match="--require strips is not measured without --strips"):
        judge(parse_requirements(["strips=0.1"]), report())
