"""Value of pixels without a height: the default, and the values that a user may choose."""

from __future__ import annotations

import math
import struct
from typing import Any

from tiler.errors import ConfigError

NODATA = -9999.0
"""Nodata value of rasters in the store, and the default of files."""

LOWEST_HEIGHT = -2000.0
"""Lowest value that could be a height, in metres or feet."""
MAX_HEIGHT = 100_000.0
"""Highest value that could be a height, in metres or feet."""


def parse_nodata(value: Any) -> float:
    """Return the nodata value, which may be NaN.

    Raise ConfigError if it is not a number, is not exact in float32, or could be a height.
    """
    try:
        number = float(value)
        if math.isnan(number):
            return number
        exact = struct.unpack("<f", struct.pack("<f", number))[0] == number
    except (TypeError, ValueError):
        raise ConfigError(
            f"nodata {value!r}: not a number; give a number like -9999 or -999999, or nan"
        ) from None
    except OverflowError:
        exact = False
    if not exact or not math.isfinite(number):
        raise ConfigError(
            f"nodata {value}: a float32 raster cannot hold it exactly; use -9999 or -999999"
        )
    if LOWEST_HEIGHT < number < MAX_HEIGHT:
        raise ConfigError(f"nodata {value}: could be a height; use -9999 or -999999")
    return number
