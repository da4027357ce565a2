"""Days on which clouds were measured, or on which their files were made."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta

import numpy as np
import numpy.typing as npt

from ptd.arrays import Bool

Days = tuple[date, date]
"""First and last day."""

BY_GPS, BY_HEADER = "GPS time of the points", "creation date in the headers of the files"
"""Kinds of days."""
_GPS_EPOCH, _GPS_OFFSET_S = datetime(1980, 1, 6, tzinfo=UTC), 1_000_000_000
_EARLIEST = datetime(1990, 1, 1, tzinfo=UTC)
_WEEK_S = 604_800


def dates_of_header(created: tuple[int, int]) -> Days | None:
    """Return the day on which a file was made, as first and last day, or None if it is invalid.

    ``created`` is the year and the day of the year.
    """
    year, day = created
    if not (1900 <= year <= 9998 and 1 <= day <= 366):
        return None
    made_on = date(year, 1, 1) + timedelta(days=day - 1)
    return made_on, made_on


def are_gps_times(times: npt.ArrayLike) -> Bool:
    """Return whether adjusted standard GPS times can be those of measurements, bool, same shape.

    Times before 1990 or after tomorrow cannot. Times within the first week are seconds of an unknown week, in files
    that falsely say that their times are standard.
    """
    seconds = np.asarray(times, np.float64)
    tomorrow = datetime.now(UTC) + timedelta(days=1)
    first, last = (
        (day - _GPS_EPOCH).total_seconds() - _GPS_OFFSET_S for day in (_EARLIEST, tomorrow)
    )
    of_week = (seconds >= 0) & (seconds < _WEEK_S)
    return np.asarray((seconds >= first) & (seconds <= last) & ~of_week)


def dates_of_gps(times: Sequence[float] | None) -> Days | None:
    """Return the days of the first and last of adjusted standard GPS times, or None if they are missing or invalid."""
    if not times or not are_gps_times(times).all():
        return None
    first, last = (_GPS_EPOCH + timedelta(seconds=t + _GPS_OFFSET_S) for t in times)
    return first.date(), last.date()


def days_of(
    files: Sequence[tuple[Sequence[float] | None, tuple[int, int]]],
) -> tuple[list[Days | None], str]:
    """Return the days of each file, and their kind: by GPS times if all files have them, else by headers.

    Parameters
    ----------
    files : sequence of tuple
        First and last adjusted standard GPS time of a file, or None, and year and day of the year from its header.
    """
    measured = [dates_of_gps(times) for times, _ in files]
    if None not in measured:
        return measured, BY_GPS
    return [dates_of_header(created) for _, created in files], BY_HEADER


def span_of(days: Sequence[Days | None]) -> Days | None:
    """Return the first and last day of some files, or None if there are no files or a file has no day."""
    known = [of_file for of_file in days if of_file is not None]
    if not known or len(known) < len(days):
        return None
    return min(first for first, _ in known), max(last for _, last in known)


def days_text(days: tuple[date | str, date | str]) -> str:
    """Return two days (a date or ISO 8601 each) as text: ``2024-05-01``, or ``2024-05-01 to 2024-05-04``."""
    first, last = map(str, days)
    return first if first == last else f"{first} to {last}"
