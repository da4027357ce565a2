"""GeoTIFF keys of a LAS file as a CRS (OGC 19-008r4, the part that names EPSG codes)."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from tiler.core.units import FOOT, METRE, US_SURVEY_FOOT, exact_unit, unit_label

DIRECTORY = 34735

_GEODETIC, _PROJECTED, _LINEAR_UNIT, _VERTICAL, _VERTICAL_UNIT = 2048, 3072, 3076, 4096, 4099
_EPSG_CODES = range(1024, 32767)
_USER_DEFINED = 32767
_UNITS = {9001: METRE, 9002: FOOT, 9003: US_SURVEY_FOOT}


@dataclass(frozen=True)
class KeyedCrs:
    """What the keys say: a horizontal CRS, a vertical one, the unit of heights, and remarks."""

    horizontal: CRS | None
    vertical: CRS | None
    vertical_unit: Fraction | None
    notes: tuple[str, ...] = ()


def parse_keys(directory: bytes) -> dict[int, int]:
    """The keys that hold a number themselves; whatever is no directory of keys gives none."""
    usable = len(directory) // 8 * 8
    entries = np.frombuffer(directory[:usable], dtype="<u2").reshape(-1, 4)
    if len(entries) == 0:
        return {}
    keys = entries[1 : 1 + int(entries[0, 3])]
    return {int(key): int(value) for key, location, _, value in keys if location == 0}


def crs_of_keys(directory: bytes) -> KeyedCrs:
    """The CRS that a directory of GeoTIFF keys names by its EPSG codes."""
    keys = parse_keys(directory)
    notes: list[str] = []
    horizontal = _of_code(keys.get(_PROJECTED), notes)
    if horizontal is None and keys.get(_PROJECTED) is None:
        horizontal = _of_code(keys.get(_GEODETIC), notes)
    if keys.get(_PROJECTED) == _USER_DEFINED:
        notes.append("its GeoTIFF keys describe a CRS of their own, only EPSG codes are read")
    unit = _UNITS.get(keys.get(_LINEAR_UNIT, 0))
    if horizontal is not None and horizontal.is_projected and unit is not None:
        own = horizontal.axis_info[0].unit_conversion_factor
        if abs(own / float(unit) - 1) > 1e-9:
            notes.append(
                f"its GeoTIFF keys say {unit_label(unit)}, their EPSG:{keys[_PROJECTED]} is in "
                f"{unit_label(exact_unit(own))}, which counts; --units says otherwise"
            )
    vertical = _of_code(keys.get(_VERTICAL), [])
    if vertical is not None and not vertical.is_vertical:
        vertical = None
    return KeyedCrs(horizontal, vertical, _UNITS.get(keys.get(_VERTICAL_UNIT, 0)), tuple(notes))


def _of_code(code: int | None, notes: list[str]) -> CRS | None:
    if code is None or code not in _EPSG_CODES:
        return None
    try:
        return CRS.from_epsg(code)
    except CRSError:
        notes.append(f"its GeoTIFF keys name EPSG:{code}, which is not known")
        return None
