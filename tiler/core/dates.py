"""Days on which clouds were measured, or on which their files were made."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta

Days = tuple[date, date]
"""First and last day."""

_GPS_EPOCH, _GPS_OFFSET_S = datetime(1980, 1, 6, tzinfo=UTC), 1_000_000_000


def dates_of_header(created: tuple[int, int]) -> Days | None:
    """Return the day on which a file was made, as first and last day, or None if it is invalid.

    ``created`` is the year and the day of the year.
    """
    year, day = created
    if not (1900 <= year <= 9998 and 1 <= day <= 366):
        return None
    made_on = date(year, 1, 1) + timedelta(days=day - 1)
    return made_on, made_on


def dates_of_gps(times: Sequence[float] | None) -> Days | None:
    """Return the first and last day of adjusted standard GPS times, or None if they are missing or invalid."""
    if not times:
        return None
    try:
        first, last = (_GPS_EPOCH + timedelta(seconds=t + _GPS_OFFSET_S) for t in times)
    except (ValueError, OverflowError):
        return None
    return first.date(), last.date()


def days_text(days: Days) -> str:
    """Return the days as text: ``2024-05-01``, or ``2024-05-01 to 2024-05-04``."""
    first, last = (day.isoformat() for day in days)
    return first if first == last else f"{first} to {last}"
