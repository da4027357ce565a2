"""The value of pixels without a height: the default, and which others a user may choose."""

from __future__ import annotations

import math
import struct
from typing import Any

from tiler.errors import ConfigError

NODATA = -9999.0
"""Nodata value of every float32 raster that has pixels without a value."""

LOWEST_LAND, HIGHEST_LAND = -2000.0, 100_000.0
"""Between them a value for nodata could be a height, in metres or feet."""


def parse_nodata(value: Any) -> float:
    """A value that float32 holds exactly and that no height takes; raises ConfigError."""
    try:
        number = float(value)
        exact = struct.unpack("<f", struct.pack("<f", number))[0] == number
    except (TypeError, ValueError):
        raise ConfigError(f"nodata {value!r}: must be a number, like -9999 or -999999") from None
    except OverflowError:
        exact = False
    if not exact or not math.isfinite(number):
        raise ConfigError(f"nodata {value}: a raster of float32 cannot hold it exactly; use -9999 or -999999")
    if LOWEST_LAND < number < HIGHEST_LAND:
        raise ConfigError(f"nodata {value}: could be a height; use -9999 or -999999")
    return number
