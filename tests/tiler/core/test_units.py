"""Lengths as users write them become exact fractions of a metre, or are refused, and are printed in the CRS's unit."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.core.units import (
    FOOT,
    METRE,
    US_SURVEY_FOOT,
    Units,
    area_text,
    in_unit_of_crs,
    length_text,
    parse_length,
    parse_sides,
    short_unit,
    written_unit,
)
from tiler.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("1", Fraction(1)),
        (".5", Fraction(1, 2)),
        ("1/3", Fraction(1, 3)),
        ("1/03 ft", Fraction(1016, 10_000)),
        (" 50cm ", Fraction(1, 2)),
        ("3937 usft", Fraction(1200)),
        (0.1, Fraction(1, 10)),
    ],
)
def test_lengths_are_exact(text: str | float, metres: Fraction) -> None:
    assert parse_length(text) == metres


@pytest.mark.parametrize(
    "text", ["", "-1", "1/0", "0/00", "1e3", "nan", "1 2", "1/2/3", "3 miles"]
)
def test_texts_that_are_no_length_are_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        parse_length(text)


@pytest.mark.parametrize(
    ("text", "sides"),
    [
        ("1000", (1000, 1000)),
        ("1000x1250", (1000, 1250)),
        ("1 X 1.25km", (1000, 1250)),
        ("1000ft x 1/2m", (1000 * FOOT, Fraction(1, 2))),
        ("5x10usft", (5 * US_SURVEY_FOOT, 10 * US_SURVEY_FOOT)),
        ("1.5usft x 1/2", (Fraction(3, 2) * US_SURVEY_FOOT, US_SURVEY_FOOT / 2)),
        ("1000ftx1250", (1000 * FOOT, 1250 * FOOT)),
    ],
)
def test_sides_are_one_length_or_two(text: str, sides: tuple[Fraction, Fraction]) -> None:
    assert parse_sides(text) == sides


@pytest.mark.parametrize("text", ["1000x", "x1000", "1x2x3", "1000x-2", "wide"])
def test_sides_that_are_no_lengths_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="is not a length"):
        parse_sides(text)


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
def test_feet_stand_alone_where_they_are_round(
    metres: Fraction, unit: Fraction, text: str
) -> None:
    assert length_text(metres, unit) == text
    assert length_text(float(metres), float(unit)) == text


def test_areas_are_in_acres_or_square_miles() -> None:
    assert area_text(250_000, METRE) == "0.25 km2"
    assert area_text(float(43_560 * FOOT**2 * 12), FOOT) == "12 acres"
    assert area_text(float(43_560 * FOOT**2 * 1280), FOOT) == "2 sq mi"


def test_names_of_units() -> None:
    assert [short_unit(u) for u in (METRE, FOOT, US_SURVEY_FOOT)] == ["m", "ft", "ft"]
    assert [written_unit(u) for u in (METRE, FOOT, US_SURVEY_FOOT)] == ["m", "ft", "usft"]


@pytest.mark.parametrize(
    ("text", "in_feet"),
    [
        ("noise 0.0255 m; 7.67 points/m2", "noise 0.0837 ft (0.0255 m); 7.67 points/m2"),
        ("up to 0.12 m + 0.5 m x slope", "up to 0.394 ft (0.12 m) + 1.64 ft (0.5 m) x slope"),
        ("cells of 0.61 to 1.2 m", "cells of 2 ft (0.61 m) to 3.94 ft (1.2 m)"),
        ("a gap of 2e-05 m", "a gap of 6.56e-05 ft (2e-05 m)"),
        (
            "--sheets 30 is 30 m = 98.4 ft, as 98.4 ft (30 m)",
            "--sheets 30 is 30 m = 98.4 ft, as 98.4 ft (30 m)",
        ),
        ("tiles 5 m.laz in dtm 1 m/: 2 m", "tiles 5 m.laz in dtm 1 m/: 6.56 ft (2 m)"),
        ("12 % of 3 meshes, v1.5 mm, 7 m2", "12 % of 3 meshes, v1.5 mm, 7 m2"),
    ],
)
def test_lengths_of_a_text_are_in_feet_if_the_crs_is(text: str, in_feet: str) -> None:
    assert in_unit_of_crs(text, Units(FOOT, FOOT)) == in_feet
    assert in_unit_of_crs(text, Units(METRE, METRE)) == text
    assert in_unit_of_crs(text, Units(FOOT, METRE)) == text
