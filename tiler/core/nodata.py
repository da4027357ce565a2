"""The value of pixels without a height: the default, and the values that a user may choose."""

from __future__ import annotations

import math
import struct
from typing import Any

from tiler.errors import ConfigError

NODATA = -9999.0
"""Nodata value of every float32 raster that has pixels without a value."""

LOWEST_HEIGHT = -2000.0
"""A value above could be a height, in metres or feet."""
HIGHEST_HEIGHT = 100_000.0
"""A value below could be a height, in metres or feet."""


def parse_nodata(value: Any) -> float:
    """The number, or NaN; raises ConfigError if float32 does not hold it exactly, or if it could be a height."""
    try:
        number = float(value)
        if math.isnan(number):
            return number
        exact = struct.unpack("<f", struct.pack("<f", number))[0] == number
    except (TypeError, ValueError):
        raise ConfigError(f"nodata {value!r}: must be a number, like -9999 or -999999, or nan") from None
    except OverflowError:
        exact = False
    if not exact or not math.isfinite(number):
        raise ConfigError(f"nodata {value}: a raster of float32 cannot hold it exactly; use -9999 or -999999")
    if LOWEST_HEIGHT < number < HIGHEST_HEIGHT:
        raise ConfigError(f"nodata {value}: could be a height; use -9999 or -999999")
    return number
