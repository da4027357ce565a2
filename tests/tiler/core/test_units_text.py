"""Lengths are printed in the unit of the CRS."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT
from tiler.core.units_text import area_text, length_text, short_unit, written_unit


@pytest.mark.parametrize(
    ("metres", "unit", "text"),
    [
        (1, METRE, "1 m"),
        (0.25, METRE, "0.25 m"),
        (3 * FOOT, FOOT, "3 ft"),
        (2 * US_SURVEY_FOOT, US_SURVEY_FOOT, "2 ft"),
        (1500 * US_SURVEY_FOOT, US_SURVEY_FOOT, "1,500 ft"),
        (1, FOOT, "3.28 ft (1 m)"),
        (100, US_SURVEY_FOOT, "328 ft (100 m)"),
        (229, US_SURVEY_FOOT, "751 ft (229 m)"),
        (512, US_SURVEY_FOOT, "1,680 ft (512 m)"),
        (0, FOOT, "0 ft (0 m)"),
    ],
)
def test_feet_stand_alone_where_they_are_round(metres: Fraction, unit: Fraction, text: str) -> None:
    assert length_text(metres, unit) == text
    assert length_text(float(metres), float(unit)) == text


def test_areas_are_in_acres_or_square_miles() -> None:
    assert area_text(250_000, METRE) == "0.25 km2"
    assert area_text(float(43_560 * FOOT**2 * 12), FOOT) == "12 acres"
    assert area_text(float(43_560 * FOOT**2 * 1280), FOOT) == "2 sq mi"


def test_names_of_units() -> None:
    assert [short_unit(u) for u in (METRE, FOOT, US_SURVEY_FOOT)] == ["m", "ft", "ft"]
    assert [written_unit(u) for u in (METRE, FOOT, US_SURVEY_FOOT)] == ["m", "ft", "usft"]
