"""Settings that select points: for the filter and the rasters by return, scan angle and so on, and for new classes.

This module does not need numpy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tiler.errors import ConfigError

FIRST, LAST = "first", "last"
"""Values of `--returns` that are not numbers."""
DROP_WITHHELD, KEEP_WITHHELD = "drop", "keep"
"""Values of `--withheld`."""
ONLY_GROUND, ALL = "ground", "all"
"""Values of `--reclass`, which `tiler.core.points.written_classes` describes."""

WITHHELD = "withheld"
"""Key of the number of points excluded by the flag "withheld". The other keys are those of
`Selection.options`."""

MAX_RETURNS = 15
"""Largest return number in LAS records."""
MAX_SOURCE_ID = 65_535
"""Largest point source id in LAS records."""
MAX_ANGLE_DEG = 180.0
"""Largest scan angle in LAS records, in degrees."""


def parse_numbers(value: Any, what: str, lowest: int, highest: int) -> tuple[int, ...]:
    """Parse whole numbers from ``7,18``, ``3-5``, 7 or a list of these, and return them sorted, each once.

    Parameters
    ----------
    value : str, int or sequence
    what : str
        Name of the numbers in messages, like ``classes``.
    lowest, highest : int
        Limits of the numbers.

    Raises
    ------
    ConfigError
        The text is not a list of numbers and ranges, or a number lies beyond the limits.
    """
    parts = value if isinstance(value, list | tuple) else str(value).split(",")
    numbers: set[int] = set()
    for part in filter(None, (str(part).strip() for part in parts)):
        first, dash, last = part.partition("-")
        try:
            start = int(first)
            stop = int(last) if dash else start
        except ValueError:
            raise ConfigError(
                f"{value!r} are not {what}; give numbers or ranges separated by commas, like 7,18 or 3-5"
            ) from None
        if stop < start:
            raise ConfigError(f"{value!r}: the range {part} runs backwards; use {stop}-{start}")
        if not lowest <= start <= stop <= highest:
            raise ConfigError(f"{value!r}: {what} out of range; give {lowest} to {highest}")
        numbers.update(range(start, stop + 1))
    return tuple(sorted(numbers))


def parse_returns(value: Any) -> str:
    """Return the value if it is ``first``, ``last``, or return numbers like ``2-4``, else raise ConfigError."""
    text = _text(value)
    if text in (FIRST, LAST):
        return text
    if not parse_numbers(value, "returns", 1, MAX_RETURNS):
        raise ConfigError(
            f"{value!r} are not returns; give first, last, or numbers like 1 or 2-4"
        )
    return text


def parse_sources(value: Any) -> str:
    """Return the value if it is a list of point source ids like ``12`` or ``12,20-31``, else raise ConfigError."""
    if not parse_numbers(value, "point source ids", 0, MAX_SOURCE_ID):
        raise ConfigError(f"{value!r} are not point source ids; give numbers like 12,20-31")
    return _text(value)


def _text(value: Any) -> str:
    """Return the value as it is written on the command line. A TOML list becomes numbers separated by commas."""
    if isinstance(value, list | tuple):
        return ",".join(str(part) for part in value)
    return str(value).strip()


def parse_angle(value: Any) -> float:
    """Return a scan angle in degrees, above 0 and at most 180, else raise ConfigError."""
    try:
        degrees = float(str(value).strip().removesuffix("deg"))
    except ValueError:
        raise ConfigError(f"{value!r} is not an angle; give degrees, like 20") from None
    if not 0 < degrees <= MAX_ANGLE_DEG:
        raise ConfigError(
            f"{value!r}: scan angle out of range; give above 0 and at most {MAX_ANGLE_DEG:g} degrees"
        )
    return degrees


@dataclass(frozen=True)
class Selection:
    """Selection of points for the filter and the rasters. None and an empty tuple select all points.

    Attributes
    ----------
    returns : str or None
        ``first``, ``last``, or return numbers (see `parse_returns`).
    scan_angle_deg : float or None
        Largest scan angle to either side, in degrees.
    source_ids : str or None
        Point source ids (see `parse_sources`), which are the flight lines in most clouds.
    drop_classes : tuple of int
        Classes that are not selected.
    withheld : bool
        Whether points with the flag "withheld" are selected.
    """

    returns: str | None = None
    scan_angle_deg: float | None = None
    source_ids: str | None = None
    drop_classes: tuple[int, ...] = ()
    withheld: bool = False

    @property
    def options(self) -> Mapping[str, str]:
        """Command-line options that exclude points, as the user writes them, by name of the setting."""
        options = {}
        if self.returns is not None:
            options["returns"] = f"--returns {self.returns}"
        if self.scan_angle_deg is not None:
            options["scan_angle"] = f"--scan-angle {self.scan_angle_deg:g}"
        if self.source_ids is not None:
            options["source_id"] = f"--source-id {self.source_ids}"
        if self.drop_classes:
            options["drop_classes"] = f"--drop-classes {','.join(map(str, self.drop_classes))}"
        return options


EVERY_POINT = Selection()
"""Selection without any setting: all points except withheld points."""
