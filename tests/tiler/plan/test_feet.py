"""Lengths of clouds in feet: which foot, and a line for each length without a unit."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.config import RunConfig
from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, Units, parse_sides
from tiler.plan.make import bare_lengths, with_survey_feet

SURVEY_FEET = Units(US_SURVEY_FOOT, US_SURVEY_FOOT)


def test_a_bare_length_gets_a_line_and_one_with_a_unit_none() -> None:
    config = RunConfig.from_mapping(
        {
            "contour_interval": "5",
            "resolution": "3ft",
            "sheets": "1km",
            "max_edge": 2000,
            "erode": 0,
        }
    )
    assert bare_lengths(config, SURVEY_FEET) == [
        "--max-edge 2000 is 2000 m = 6,562 ft; give 2000ft for feet",
        "--contour-interval 5 is 5 m = 16.4 ft; give 5ft for feet",
    ]
    assert bare_lengths(config, Units()) == []
    assert [text.split()[0] for text in bare_lengths(config, Units(METRE, FOOT))] == [
        "--contour-interval"
    ]


@pytest.mark.parametrize(
    "preset", ["als", "city", "dim", "forest", "mountain", "swiss", "usgs"]
)
def test_defaults_and_presets_are_no_bare_lengths(preset: str) -> None:
    assert bare_lengths(RunConfig.from_mapping({"preset": preset}), SURVEY_FEET) == []


def test_feet_are_those_of_the_crs() -> None:
    config = RunConfig.from_mapping(
        {"resolution": "2ft", "sheets": "500ft", "max_edge": "30", "contour_interval": "5ft"}
    )
    of_survey = with_survey_feet(config, SURVEY_FEET)
    assert (of_survey.sheets, of_survey.resolution) == (
        (500 * US_SURVEY_FOOT, 500 * US_SURVEY_FOOT),
        2 * US_SURVEY_FOOT,
    )
    assert of_survey.contour_interval == 5 * US_SURVEY_FOOT
    assert of_survey.max_edge == 30
    assert with_survey_feet(config, Units(FOOT, FOOT)).sheets == (
        Fraction(1524, 10),
        Fraction(1524, 10),
    )
    assert with_survey_feet(config, Units()) == config
    oblong = with_survey_feet(config.updated(sheets=parse_sides("500x1000ft")), SURVEY_FEET)
    assert oblong.sheets == (500 * US_SURVEY_FOOT, 1000 * US_SURVEY_FOOT)
