"""Lengths as users write them become exact fractions of a metre, or are refused."""

from __future__ import annotations

from fractions import Fraction

import pytest

from tiler.core.units import parse_length
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
