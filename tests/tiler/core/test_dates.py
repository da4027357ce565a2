"""Days of files, from GPS times or headers."""

from __future__ import annotations

from datetime import date

import numpy as np
import pytest

from tiler.core.dates import BY_GPS, BY_HEADER, are_gps_times, dates_of_gps, days_of, span_of

MAY_2015 = (date(2015, 5, 1) - date(1980, 1, 6)).days * 86_400 - 1e9
"""Adjusted standard time of the first second of 2015-05-01."""
MADE = (2020, 32)


def test_all_files_have_the_same_kind_of_day() -> None:
    measured = date(2015, 5, 1), date(2015, 5, 2)
    made = date(2020, 2, 1), date(2020, 2, 1)
    file = (MAY_2015, MAY_2015 + 86_400), MADE
    assert days_of([file, file]) == ([measured, measured], BY_GPS)
    assert days_of([file, (None, MADE)]) == ([made, made], BY_HEADER)
    assert days_of([file, (None, (0, 0))]) == ([made, None], BY_HEADER)


def test_a_span_needs_the_days_of_all_files() -> None:
    first, last = date(2015, 5, 1), date(2016, 5, 1)
    assert span_of([(last, last), (first, first)]) == (first, last)
    assert span_of([(first, last), None]) is None
    assert span_of([]) is None


@pytest.mark.parametrize("wrong", [0.0, 604_799.0, -7e8, 1e10, 1e300, np.nan, -np.inf])
def test_wrong_times_are_no_days(wrong: float) -> None:
    assert are_gps_times([wrong, 604_800.0, MAY_2015]).tolist() == [False, True, True]
    assert dates_of_gps((wrong, MAY_2015)) is None
